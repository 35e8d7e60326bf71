#include "formats/io/output_file.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <limits.h>
#include <signal.h>
#include <unistd.h>

#include <cerrno>
#include <charconv>
#include <cstring>
#include <fstream>
#include <system_error>

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

/// Removes what killed writers of `path` left. Those of another machine, which may share the folder, are left
/// alone: whether they live cannot be asked here.
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

void OutputFile::commit(Sync sync) {
    if (sync == Sync::yes) sync_path(partial_, O_RDONLY);
    std::filesystem::rename(partial_, path_);
    committed_ = true;
    if (sync == Sync::yes) sync_path(folder_of(path_), O_RDONLY | O_DIRECTORY);
}

void write_text_file(const std::filesystem::path& path, std::string_view text,
                     std::optional<std::filesystem::file_time_type> modified) {
    OutputFile output(path);
    {
        std::ofstream stream(output.partial(), std::ios::binary);
        stream << text;
        stream.close();
        if (!stream) {
            throw std::runtime_error(
                fmt::format("{}: cannot write: {}", path.native(), std::strerror(errno)));
        }
    }
    if (modified) std::filesystem::last_write_time(output.partial(), *modified);
    output.commit();
}

}  // namespace loom
