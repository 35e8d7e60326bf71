#pragma once
#include <filesystem>
#include <span>
#include <string>

namespace loom::app {

/// A stamp is a text file for make to depend on: the content hash of each file that something was made from, so that
/// contents decide what is made again, and not times. Beside each hash stands what stat() says of the file; while that
/// stays the same, its change time included, the file is not read again. Names of files never pass through make.

/// Whether `files` have the contents, in this order, that the stamp lists. A stamp that is missing or unreadable
/// lists nothing. Where contents are the same but times are not, the stamp's notes of times are renewed, its own
/// modification time is kept.
/// throws:  InputError when a file cannot be read
bool stamp_matches(const std::filesystem::path& stamp, std::span<const std::string> files);

/// Writes the stamp, unless it matches.
/// throws:  InputError when a file cannot be read or the stamp's folder is missing
void update_stamp(const std::filesystem::path& stamp, std::span<const std::string> files);

}  // namespace loom::app
