#pragma once
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <span>
#include <string>

namespace loom {

/// Computes XXH64 (seed 0), which identifies a file's content; no protection against forgery.
std::uint64_t content_hash(std::span<const std::byte> bytes);

/// Formats a hash as 16 hexadecimal digits, like `xxh64sum`.
std::string content_hash_text(std::uint64_t hash);

/// Computes the hash of a whole file.
/// throws:  InputError when the file cannot be read
std::string file_content_hash(const std::filesystem::path& path);

}  // namespace loom
