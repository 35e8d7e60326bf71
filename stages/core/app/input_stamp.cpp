#include "stages/core/app/input_stamp.h"

#include <fmt/format.h>
#include <sys/stat.h>

#include <cerrno>
#include <chrono>
#include <cstring>
#include <fstream>
#include <optional>
#include <sstream>
#include <unordered_map>
#include <vector>

#include "formats/io/content_hash.h"
#include "formats/io/error.h"
#include "formats/io/output_file.h"

namespace loom::app {
namespace {

constexpr std::string_view heading = "loom-stamp 1";
// A file that changed this shortly before it was hashed may have changed again within one tick of the file system's
// clock.
constexpr std::int64_t settling_ns = 2'000'000'000;

struct Entry {
    std::string hash;
    std::string identity;         // size, device, inode, modification and change time
    std::int64_t changed_ns = 0;  // change time, since 1970
    std::int64_t hashed_ns = 0;   // when the file was read
    std::string name;             // on one line: \n and \\ stand for a newline and a backslash

    bool settled() const { return changed_ns + settling_ns < hashed_ns; }
};

std::string on_one_line(const std::string& name) {
    std::string line;
    for (char c : name) line += c == '\n' ? "\\n" : c == '\\' ? "\\\\" : std::string(1, c);
    return line;
}

std::int64_t nanoseconds(const timespec& time) {
    return std::int64_t(time.tv_sec) * 1'000'000'000 + time.tv_nsec;
}

std::vector<Entry> read_stamp(const std::filesystem::path& stamp) {
    std::ifstream in(stamp, std::ios::binary);
    std::string line;
    if (!std::getline(in, line) || line != heading) return {};
    std::vector<Entry> entries;
    while (std::getline(in, line)) {
        std::istringstream words(line);
        Entry entry;
        words >> entry.hash >> entry.identity >> entry.changed_ns >> entry.hashed_ns;
        if (!words || words.get() != ' ') return {};
        std::getline(words, entry.name);
        entries.push_back(std::move(entry));
    }
    return entries;
}

/// Returns the current entries of `files`; those that stat() finds unchanged since `before` are not read.
std::vector<Entry> examine(std::span<const std::string> files, const std::vector<Entry>& before) {
    std::unordered_map<std::string_view, const Entry*> known;
    for (const Entry& entry : before) known.emplace(entry.name, &entry);
    std::vector<Entry> entries;
    for (const std::string& file : files) {
        struct stat status;
        if (::stat(file.c_str(), &status) != 0) throw InputError(fmt::format("{}: {}", file, std::strerror(errno)));
        Entry entry;
        entry.name = on_one_line(file);
        entry.identity = fmt::format("{}:{}:{}:{}:{}", status.st_size, status.st_dev, status.st_ino,
                                     nanoseconds(status.st_mtim), nanoseconds(status.st_ctim));
        entry.changed_ns = nanoseconds(status.st_ctim);
        const auto found = known.find(entry.name);
        if (found != known.end() && found->second->identity == entry.identity && found->second->settled()) {
            entry.hash = found->second->hash;
            entry.hashed_ns = found->second->hashed_ns;
        } else {
            // Taken before the file is read, so that a change while it is read leaves the entry unsettled.
            entry.hashed_ns = std::chrono::duration_cast<std::chrono::nanoseconds>(
                                  std::chrono::system_clock::now().time_since_epoch())
                                  .count();
            entry.hash = file_content_hash(file);
        }
        entries.push_back(std::move(entry));
    }
    return entries;
}

template <class Same>
bool equal(const std::vector<Entry>& a, const std::vector<Entry>& b, Same same) {
    return std::equal(a.begin(), a.end(), b.begin(), b.end(), same);
}
bool same_contents(const std::vector<Entry>& a, const std::vector<Entry>& b) {
    return equal(a, b, [](const Entry& x, const Entry& y) { return x.hash == y.hash; });
}
bool same_notes(const std::vector<Entry>& a, const std::vector<Entry>& b) {
    return equal(a, b, [](const Entry& x, const Entry& y) {
        return x.name == y.name && x.identity == y.identity && x.settled() == y.settled();
    });
}

void write_stamp(const std::filesystem::path& stamp, const std::vector<Entry>& entries,
                 std::optional<std::filesystem::file_time_type> modified) {
    std::string text = std::string(heading) + "\n";
    for (const Entry& e : entries)
        text += fmt::format("{} {} {} {} {}\n", e.hash, e.identity, e.changed_ns, e.hashed_ns, e.name);
    write_text_file(stamp, text, modified);
}

/// Compares, and renews the recorded times where nothing else differs.
bool matches(const std::filesystem::path& stamp, const std::vector<Entry>& before, const std::vector<Entry>& now) {
    if (before.empty() || !same_contents(before, now)) return false;
    if (same_notes(before, now)) return true;
    try {
        write_stamp(stamp, now, std::filesystem::last_write_time(stamp));
    } catch (const std::exception&) {
        // The folder is not writable: the files are read again the next time.
    }
    return true;
}

}  // namespace

bool stamp_matches(const std::filesystem::path& stamp, std::span<const std::string> files) {
    const std::vector<Entry> before = read_stamp(stamp);
    return matches(stamp, before, examine(files, before));
}

void update_stamp(const std::filesystem::path& stamp, std::span<const std::string> files) {
    const std::vector<Entry> before = read_stamp(stamp), now = examine(files, before);
    if (!matches(stamp, before, now)) write_stamp(stamp, now, std::nullopt);
}

}  // namespace loom::app
