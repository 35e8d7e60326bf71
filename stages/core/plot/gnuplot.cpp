#include "stages/core/plot/gnuplot.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <spawn.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cerrno>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <iterator>
#include <stdexcept>

#include "formats/io/error.h"
#include "formats/io/output_file.h"

namespace loom::plot {
namespace {

namespace fs = std::filesystem;

/// A temporary folder, removed by the destructor.
class Scratch {
  public:
    explicit Scratch(const fs::path& parent) {
        std::string name = (parent / ".loom-plot-XXXXXX").native();
        if (mkdtemp(name.data()) == nullptr)
            throw std::runtime_error(fmt::format("{}: cannot make a folder: {}", name, std::strerror(errno)));
        path = name;
    }
    ~Scratch() {
        std::error_code ignored;
        fs::remove_all(path, ignored);
    }
    fs::path path;
};

std::string text_of(const fs::path& file) {
    std::ifstream in(file, std::ios::binary);
    return {std::istreambuf_iterator<char>(in), {}};
}

/// Whether gnuplot wrote the file completely; it exits with 0 even on a full disk.
bool is_whole(const std::string& name, const std::string& bytes) {
    using namespace std::string_view_literals;
    if (name.ends_with(".png")) return bytes.ends_with("IEND\xae\x42\x60\x82"sv);
    return bytes.ends_with("</svg>\n"sv) || bytes.ends_with("</svg>\n\n"sv);
}

}  // namespace

std::optional<int> run_program(const fs::path& folder, std::vector<std::string> words, const fs::path& log) {
    posix_spawn_file_actions_t actions;
    posix_spawn_file_actions_init(&actions);
    posix_spawn_file_actions_addchdir_np(&actions, folder.c_str());
    posix_spawn_file_actions_addopen(&actions, STDIN_FILENO, "/dev/null", O_RDONLY, 0);
    // A relative log path is relative to the folder that the process has entered.
    posix_spawn_file_actions_addopen(&actions, STDOUT_FILENO, log.c_str(), O_WRONLY | O_CREAT | O_TRUNC, 0600);
    posix_spawn_file_actions_adddup2(&actions, STDOUT_FILENO, STDERR_FILENO);
    std::vector<std::string> kept{"LC_ALL=C.UTF-8"};
    for (const char* name : {"PATH", "HOME", "TMPDIR", "XDG_CACHE_HOME", "FONTCONFIG_PATH", "FONTCONFIG_FILE"})
        if (const char* value = std::getenv(name)) kept.push_back(fmt::format("{}={}", name, value));
    std::vector<char*> env, argv;
    for (std::string& variable : kept) env.push_back(variable.data());
    for (std::string& word : words) argv.push_back(word.data());
    env.push_back(nullptr), argv.push_back(nullptr);
    pid_t pid = 0;
    const int failure = posix_spawnp(&pid, argv[0], &actions, nullptr, argv.data(), env.data());
    posix_spawn_file_actions_destroy(&actions);
    if (failure == ENOENT) return std::nullopt;
    if (failure != 0) throw std::runtime_error(fmt::format("{}: {}", words[0], std::strerror(failure)));
    int status = 0;
    while (waitpid(pid, &status, 0) < 0 && errno == EINTR) {
    }
    return WIFEXITED(status) ? WEXITSTATUS(status) : -1;
}

std::string in_quotes(const std::string& text) {
    std::string out = "'";
    for (char c : text) {
        if (c == '\'') out += '\'';
        out += static_cast<unsigned char>(c) < 0x20 ? ' ' : c;  // a newline would end the text, and start a command
    }
    return out + "'";
}

void make_pictures(const fs::path& folder, const std::map<std::string, std::string>& files, const std::string& commands,
                   const std::vector<std::string>& pictures, const std::map<std::string, std::string>& passing) {
    const fs::path place = folder.empty() ? "." : folder;
    const Scratch scratch(place);
    for (const auto* texts : {&files, &passing})
        for (const auto& [name, text] : *texts) write_text_file(scratch.path / name, text);
    // -d ignores the user's start-up file.
    const std::optional<int> status = run_program(scratch.path, {"gnuplot", "-d", commands}, "log");
    if (!status) throw InputError("gnuplot is not installed (Debian: apt install gnuplot-nox)");
    if (*status != 0) throw std::runtime_error(fmt::format("gnuplot failed:\n{}", text_of(scratch.path / "log")));
    std::map<std::string, std::string> bytes_of;
    for (const std::string& picture : pictures) {
        const std::string& bytes = bytes_of[picture] = text_of(scratch.path / picture);
        if (!is_whole(picture, bytes))
            throw std::runtime_error(
                fmt::format("{}: gnuplot did not write all of it (disk full?)", (place / picture).native()));
    }
    for (const auto& [name, text] : files) fs::rename(scratch.path / name, place / name);
    for (const auto& [picture, bytes] : bytes_of) write_text_file(place / picture, bytes);
}

}  // namespace loom::plot
