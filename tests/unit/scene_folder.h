#pragma once
#include <gtest/gtest.h>
#include <unistd.h>

#include <filesystem>
#include <fstream>
#include <string>
#include <string_view>

#include "formats/io/error.h"
#include "stages/core/description/description.h"

namespace loom {

/// A temporary folder of scene files of the test.
class SceneFolder : public ::testing::Test {
  protected:
    void SetUp() override {
        std::string name = (std::filesystem::temp_directory_path() / "loom-scene-XXXXXX").string();
        ASSERT_NE(mkdtemp(name.data()), nullptr);
        folder_ = name;
    }
    void TearDown() override { std::filesystem::remove_all(folder_); }

    std::filesystem::path path(const std::string& name) const { return folder_ / name; }
    std::filesystem::path write(const std::string& name, std::string_view bytes) const {
        std::filesystem::create_directories(path(name).parent_path());
        std::ofstream(path(name), std::ios::binary) << bytes;
        return path(name);
    }
    /// Reads a scene with a sensor and `body`, whose first line is line 2 of the file.
    SceneDescription read(const std::string& body, const Defines& defines = {}, const char* version = "3.0.0",
                          const std::string& sensor = {}) const {
        return read_scene(write("scene.xml", text(body, version)), defines, sensor);
    }
    static std::string text(const std::string& body, const char* version = "3.0.0") {
        return std::string("<scene version=\"") + version + "\"><sensor type=\"perspective\"/>\n" + body +
               "\n</scene>\n";
    }
    /// Returns the message of the InputError that reading throws, without the folder's name.
    template <class Body>
    std::string error_of(const Body& body) const {
        try {
            body();
        } catch (const InputError& error) {
            std::string message = error.what();
            const std::string prefix = folder_.string() + "/";
            for (std::size_t at = 0; (at = message.find(prefix)) != std::string::npos;)
                message.erase(at, prefix.size());
            return message;
        }
        return "no error";
    }

  private:
    std::filesystem::path folder_;
};

}  // namespace loom
