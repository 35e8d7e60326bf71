#pragma once
// A folder with a scene and a table of frames for loom-residual, and what it writes there.

#include <fmt/format.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <filesystem>
#include <fstream>
#include <string>

#include "formats/io/error.h"
#include "stages/core/app/report.h"
#include "stages/residual/residual.h"

namespace loom::testing {

class FramesFolder : public ::testing::Test {
  protected:
    const std::filesystem::path folder =
        std::filesystem::temp_directory_path() / fmt::format("loom-frames-{}", getpid());
    app::Report report{"loom-residual"};

    /// in:      scene    text of s.xml
    ///          command  of loom-residual
    FramesFolder(const char* scene, const char* command) {
        std::filesystem::create_directories(folder);
        report.set_quiet(true);
        report.set_command(command);
        write("s.xml", scene);
    }
    ~FramesFolder() override { std::filesystem::remove_all(folder); }

    void write(const std::string& name, const std::string& text) const { std::ofstream(folder / name) << text; }
    std::string at(const std::string& name) const { return (folder / name).string(); }
    std::string bytes(const std::string& name) const {
        std::ifstream in(folder / name, std::ios::binary);
        return {std::istreambuf_iterator<char>(in), {}};
    }
    /// Runs loom-residual. Returns its error; empty: none.
    std::string error(const residual::Options& options) {
        try {
            residual::run(options, report);
        } catch (const InputError& e) {
            return e.what();
        }
        return "";
    }
};

}  // namespace loom::testing
