#pragma once
#include <filesystem>
#include <span>
#include <string>

namespace loom::app {

/// A stamp is a text file that make depends on. It lists the content hash of each source file, so that contents decide
/// what is remade, not times. Beside each hash is the file's stat() record. While that record is unchanged, change time
/// included, the file is not read again. File names never pass through make.

/// Whether `files`, in this order, have the contents that the stamp lists. A missing or unreadable stamp lists nothing.
/// Where contents are equal but times differ, the recorded times are renewed; the stamp's own modification time is
/// kept.
/// throws:  InputError when a file cannot be read
bool stamp_matches(const std::filesystem::path& stamp, std::span<const std::string> files);

/// Writes the stamp unless it matches.
/// throws:  InputError when a file cannot be read or the stamp's folder is missing
void update_stamp(const std::filesystem::path& stamp, std::span<const std::string> files);

}  // namespace loom::app
