#pragma once
#include <cstddef>
#include <filesystem>
#include <span>

namespace loom {

/// The bytes of a file, mapped for reading; unmapped by the destructor.
class MappedFile {
  public:
    /// throws:  InputError when the path is missing, a directory or not readable
    explicit MappedFile(const std::filesystem::path& path);
    ~MappedFile();
    MappedFile(const MappedFile&) = delete;
    MappedFile& operator=(const MappedFile&) = delete;

    std::span<const std::byte> bytes() const { return bytes_; }

  private:
    std::span<const std::byte> bytes_;
};

/// Refuses a path that is missing, not a regular file, not readable, or empty.
/// throws:  InputError
void require_readable(const std::filesystem::path& path);

}  // namespace loom
