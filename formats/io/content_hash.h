#pragma once
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <span>
#include <string>

namespace loom {

/// The 64-bit hash XXH64 (seed 0): the identity of a file's content, not a seal against forgery.
std::uint64_t content_hash(std::span<const std::byte> bytes);

/// The same as 16 hexadecimal digits, as `xxh64sum` prints it.
std::string content_hash_text(std::uint64_t hash);

/// Hash of a whole file.
/// throws:  InputError when it cannot be read
std::string file_content_hash(const std::filesystem::path& path);

}  // namespace loom
