#include "formats/io/content_hash.h"

#include <fmt/format.h>
#include <xxhash.h>

#include "formats/io/mapped_file.h"

namespace loom {

std::uint64_t content_hash(std::span<const std::byte> bytes) {
    return XXH64(bytes.data(), bytes.size(), 0);
}

std::string content_hash_text(std::uint64_t hash) {
    return fmt::format("{:016x}", hash);
}

std::string file_content_hash(const std::filesystem::path& path) {
    const MappedFile file(path);
    return content_hash_text(content_hash(file.bytes()));
}

}  // namespace loom
