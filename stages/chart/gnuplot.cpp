#include "stages/chart/gnuplot.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <spawn.h>
#include <sys/wait.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <cstring>
#include <fstream>
#include <iterator>
#include <stdexcept>

#include "formats/io/error.h"
#include "formats/io/output_file.h"

namespace loom::chart {
namespace {

namespace fs = std::filesystem;

/// A folder that goes with this object.
class Scratch {
  public:
    explicit Scratch(const fs::path& parent) {
        std::string name = (parent / ".loom-chart-XXXXXX").native();
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

/// Runs gnuplot in a folder, without the user's start-up file and language: equal inputs give equal bytes.
void run_gnuplot(const fs::path& folder, const std::string& commands) {
    posix_spawn_file_actions_t actions;
    posix_spawn_file_actions_init(&actions);
    posix_spawn_file_actions_addchdir_np(&actions, folder.c_str());
    // Relative to the folder that the process has just gone to.
    posix_spawn_file_actions_addopen(&actions, STDOUT_FILENO, "log", O_WRONLY | O_CREAT | O_TRUNC, 0600);
    posix_spawn_file_actions_adddup2(&actions, STDOUT_FILENO, STDERR_FILENO);
    std::string environment = "LC_ALL=C.UTF-8";
    std::vector<std::string> kept{environment};
    // HOME and the like for the cache of fonts; none of gnuplot's own variables.
    for (const char* name : {"PATH", "HOME", "TMPDIR", "XDG_CACHE_HOME", "FONTCONFIG_PATH", "FONTCONFIG_FILE"})
        if (const char* value = std::getenv(name)) kept.push_back(fmt::format("{}={}", name, value));
    std::vector<char*> env;
    for (std::string& variable : kept) env.push_back(variable.data());
    env.push_back(nullptr);
    std::array<std::string, 3> words{"gnuplot", "-d", commands};
    std::array<char*, 4> argv{words[0].data(), words[1].data(), words[2].data(), nullptr};
    pid_t pid = 0;
    const int failure = posix_spawnp(&pid, "gnuplot", &actions, nullptr, argv.data(), env.data());
    posix_spawn_file_actions_destroy(&actions);
    if (failure == ENOENT) throw InputError("gnuplot is not installed (Debian: apt install gnuplot-nox)");
    if (failure != 0) throw std::runtime_error(fmt::format("gnuplot: {}", std::strerror(failure)));
    int status = 0;
    while (waitpid(pid, &status, 0) < 0 && errno == EINTR) {
    }
    if (!WIFEXITED(status) || WEXITSTATUS(status) != 0)
        throw std::runtime_error(fmt::format("gnuplot failed:\n{}", text_of(folder / "log")));
}

}  // namespace

void plot(const fs::path& folder, const std::map<std::string, std::string>& files, const std::string& commands,
          const std::vector<std::string>& pictures) {
    const fs::path place = folder.empty() ? "." : folder;
    const Scratch scratch(place);
    for (const auto& [name, text] : files) write_text_file(scratch.path / name, text);
    run_gnuplot(scratch.path, commands);
    for (const std::string& picture : pictures)
        if (!fs::exists(scratch.path / picture)) throw std::runtime_error(fmt::format("gnuplot made no {}", picture));
    for (const auto& [name, text] : files) fs::rename(scratch.path / name, place / name);
    for (const std::string& picture : pictures) fs::rename(scratch.path / picture, place / picture);
}

}  // namespace loom::chart
