#include "formats/io/output_file.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <limits.h>
#include <signal.h>
#include <unistd.h>

#include <cerrno>
#include <charconv>
#include <cstring>
#include <system_error>
#include <utility>

#include "formats/io/error.h"

namespace loom {
namespace {

std::filesystem::path folder_of(const std::filesystem::path& path) {
    return path.has_parent_path() ? path.parent_path() : std::filesystem::path(".");
}

std::string host_name() {
    char name[HOST_NAME_MAX + 1] = {};
    return ::gethostname(name, HOST_NAME_MAX) == 0 ? name : "host";
}

/// Removes partial files that killed writers of `path` left. Files of another machine, which may share the folder, are
/// kept: whether their writers run is unknown here.
void remove_leftovers(const std::filesystem::path& path) {
    const std::string start = path.filename().native() + "." + host_name() + "-", end = ".partial";
    std::error_code ignored;
    for (const auto& entry : std::filesystem::directory_iterator(folder_of(path), ignored)) {
        const std::string name = entry.path().filename();
        if (!name.starts_with(start) || !name.ends_with(end) || name.size() <= start.size() + end.size()) continue;
        pid_t writer = 0;
        const char *first = name.data() + start.size(), *last = name.data() + name.size() - end.size();
        const auto parsed = std::from_chars(first, last, writer);
        if (parsed.ec != std::errc() || parsed.ptr != last || writer <= 0) continue;
        if (::kill(writer, 0) != 0 && errno == ESRCH) std::filesystem::remove(entry.path(), ignored);
    }
}

void sync_path(const std::filesystem::path& path, int flags) {
    const int fd = ::open(path.c_str(), flags | O_CLOEXEC);
    const bool synced = fd >= 0 && ::fsync(fd) == 0;
    const int error = errno;
    if (fd >= 0) ::close(fd);
    if (!synced) {
        throw std::runtime_error(fmt::format("{}: cannot sync: {}", path.native(), std::strerror(error)));
    }
}

}  // namespace

void check_output_path(const std::filesystem::path& path) {
    std::error_code ignored;
    if (path.filename().empty() || std::filesystem::is_directory(path, ignored)) {
        throw InputError(fmt::format("{}: is a directory; an output must be a file", path.native()));
    }
    const auto folder = folder_of(path);
    if (!std::filesystem::is_directory(folder, ignored)) {
        throw InputError(fmt::format("{}: there is no folder {}", path.native(), folder.native()));
    }
    if (::access(folder.c_str(), W_OK) != 0) {
        throw InputError(
            fmt::format("{}: cannot write in {}: {}", path.native(), folder.native(), std::strerror(errno)));
    }
}

OutputFile::OutputFile(std::filesystem::path path) : path_(std::move(path)), partial_(path_) {
    check_output_path(path_);
    partial_ += fmt::format(".{}-{}.partial", host_name(), ::getpid());
    remove_leftovers(path_);
}

OutputFile::~OutputFile() {
    std::error_code ignored;
    if (!committed_) std::filesystem::remove(partial_, ignored);
}

std::filesystem::path not_finite_name(const std::filesystem::path& output) {
    std::filesystem::path name = output.stem();
    name += ".not-finite";
    name += output.extension();
    return output.parent_path() / name;
}

void OutputFile::commit(Sync sync, std::string_view nonfinite) {
    const std::filesystem::path kept = not_finite_name(path_);
    if (sync == Sync::yes) sync_path(partial_, O_RDONLY);
    std::filesystem::rename(partial_, nonfinite.empty() ? path_ : kept);
    committed_ = true;
    if (nonfinite.empty()) std::filesystem::remove(kept);
    if (sync == Sync::yes) sync_path(folder_of(path_), O_RDONLY | O_DIRECTORY);
    if (!nonfinite.empty())
        throw NonfiniteError(
            fmt::format("{}: values are NaN or infinite ({}); kept as {}", path_.native(), nonfinite, kept.native()));
}

OutputStream::OutputStream(const OutputFile& output)
    : path_(output.path()), file_(std::fopen(output.partial().c_str(), "wbe")) {
    if (file_ == nullptr) error_ = errno, fail();
}

OutputStream::~OutputStream() {
    if (file_ != nullptr) std::fclose(file_);
}

void OutputStream::fail() const {
    throw std::runtime_error(fmt::format("{}: cannot write: {}", path_.native(), std::strerror(error_)));
}

void OutputStream::write(const void* bytes, std::size_t n) {
    if (std::fwrite(bytes, 1, n, file_) == n) return;
    if (error_ == 0) error_ = errno;
    fail();
}

void OutputStream::close() {
    if (std::ferror(file_) != 0 && error_ == 0) error_ = EIO;
    if (std::fclose(std::exchange(file_, nullptr)) != 0 && error_ == 0) error_ = errno;
    if (error_ != 0) fail();
}

void write_text_file(const std::filesystem::path& path, std::string_view text,
                     std::optional<std::filesystem::file_time_type> modified) {
    OutputFile output(path);
    OutputStream stream(output);
    stream.write(text.data(), text.size());
    stream.close();
    if (modified) std::filesystem::last_write_time(output.partial(), *modified);
    output.commit();
}

}  // namespace loom
