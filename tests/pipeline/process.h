#pragma once
// Runs the stages and make as a user does, in a temporary folder of the test.

#include <gtest/gtest.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <regex>
#include <stdexcept>
#include <string>
#include <vector>

namespace loom::pipeline {

namespace fs = std::filesystem;

struct Outcome {
    int code;         // exit status; 128 + signal when killed
    std::string out;  // stdout
    std::string err;  // stderr
};

inline std::string bytes_of(const fs::path& path) {
    std::ifstream in(path, std::ios::binary);
    return {std::istreambuf_iterator<char>(in), {}};
}

/// Returns a text as one word of a shell.
inline std::string shell_word(const std::string& text) {
    return "'" + std::regex_replace(text, std::regex("'"), "'\\''") + "'";
}

/// A temporary folder, and a shell that starts in the root of the repository.
class PipelineTest : public testing::Test {
  protected:
    void SetUp() override {
        std::string name = (fs::temp_directory_path() / "loom-XXXXXX").string();
        ASSERT_NE(mkdtemp(name.data()), nullptr);
        folder = name;
    }
    void TearDown() override { fs::remove_all(folder); }

    /// Returns the path of a program of this build.
    static std::string stage(const std::string& name) { return (fs::path(LOOM_BIN_DIR) / ("loom-" + name)).string(); }

    Outcome sh(const std::string& command) const {
        const fs::path err = folder / ".stderr";
        // The make that runs the tests must not affect the makes inside the tests.
        const std::string whole = "cd '" LOOM_SOURCE_DIR "' && unset MAKEFLAGS MFLAGS MAKELEVEL && { " + command +
                                  "; } 2>'" + err.string() + "'";
        FILE* pipe = popen(whole.c_str(), "r");
        if (!pipe) throw std::runtime_error("cannot start a shell");
        Outcome outcome;
        char buffer[4096];
        for (std::size_t n; (n = fread(buffer, 1, sizeof buffer, pipe)) > 0;) outcome.out.append(buffer, n);
        const int status = pclose(pipe);
        outcome.code = WIFEXITED(status) ? WEXITSTATUS(status) : 128 + WTERMSIG(status);
        outcome.err = bytes_of(err);
        fs::remove(err);
        return outcome;
    }

    /// Returns the command that runs pipelines/still.mk on one scene with the stages of this build; results in `out`, a
    /// path in `folder`.
    std::string still(const std::string& out, const std::string& variables) const {
        return "make -s -f pipelines/still.mk BUILD='" + fs::path(LOOM_BIN_DIR).parent_path().string() +
               "' OUT=" + (folder / out).string() + " " + variables;
    }

    /// Returns the names of the files in `folder`, sorted.
    std::vector<std::string> files() const {
        std::vector<std::string> names;
        for (const auto& entry : fs::recursive_directory_iterator(folder))
            if (entry.is_regular_file()) names.push_back(fs::relative(entry.path(), folder).string());
        std::sort(names.begin(), names.end());
        return names;
    }

    fs::path folder;
};

}  // namespace loom::pipeline
