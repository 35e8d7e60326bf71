#include "formats/io/mapped_file.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>

#include "formats/io/error.h"

namespace loom {
namespace {

/// Opens a readable regular file; the caller closes it.
int open_regular(const std::filesystem::path& path, std::size_t& n_bytes) {
    const int fd = ::open(path.c_str(), O_RDONLY | O_CLOEXEC | O_NONBLOCK);
    if (fd < 0) {
        throw InputError(errno == ENOENT ? fmt::format("{}: no such file", path.native())
                                         : fmt::format("{}: cannot open: {}", path.native(), std::strerror(errno)));
    }
    struct stat status {};
    const bool known = ::fstat(fd, &status) == 0;
    if (!known || !S_ISREG(status.st_mode)) {
        ::close(fd);
        throw InputError(
            fmt::format("{}: {}", path.native(),
                        known && S_ISDIR(status.st_mode) ? "is a directory, not a file" : "is not a regular file"));
    }
    n_bytes = static_cast<std::size_t>(status.st_size);
    return fd;
}

}  // namespace

MappedFile::MappedFile(const std::filesystem::path& path) {
    std::size_t n_bytes = 0;
    const int fd = open_regular(path, n_bytes);
    if (n_bytes == 0) {  // mmap refuses an empty range
        ::close(fd);
        return;
    }
    void* data = ::mmap(nullptr, n_bytes, PROT_READ, MAP_PRIVATE, fd, 0);
    const int error = errno;
    ::close(fd);
    if (data == MAP_FAILED) {
        throw InputError(fmt::format("{}: cannot map: {}", path.native(), std::strerror(error)));
    }
    bytes_ = {static_cast<const std::byte*>(data), n_bytes};
}

MappedFile::~MappedFile() {
    if (!bytes_.empty()) ::munmap(const_cast<std::byte*>(bytes_.data()), bytes_.size());
}

void require_readable(const std::filesystem::path& path) {
    std::size_t n_bytes = 0;
    ::close(open_regular(path, n_bytes));
    if (n_bytes == 0) throw InputError(fmt::format("{}: the file is empty", path.native()));
}

}  // namespace loom
