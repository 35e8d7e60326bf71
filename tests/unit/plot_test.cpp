// gnuplot ends with 0 when the disk is full; a picture that is not whole must not get its name.

#include <gtest/gtest.h>
#include <sys/resource.h>

#include <csignal>
#include <filesystem>
#include <string>

#include "formats/io/error.h"
#include "stages/core/plot/gnuplot.h"
#include "tests/unit/scene_folder.h"

namespace loom {
namespace {

class Plots : public SceneFolder {
  protected:
    void plot() const {
        plot::make_pictures(path(""), {{"a.gp", "set terminal svg; set output 'a.svg'; plot x; set terminal png; set output 'a.png'; plot x\n"}}, "a.gp", {"a.svg", "a.png"});
    }
    void plot_within(std::uintmax_t bytes) const {
        rlimit before{};
        getrlimit(RLIMIT_FSIZE, &before);
        const auto signal = std::signal(SIGXFSZ, SIG_IGN);
        const rlimit limit{bytes, before.rlim_max};
        setrlimit(RLIMIT_FSIZE, &limit);
        bool failed = false;
        try {
            plot();
        } catch (const std::runtime_error&) {
            failed = true;
        }
        setrlimit(RLIMIT_FSIZE, &before);
        std::signal(SIGXFSZ, signal);
        EXPECT_TRUE(failed) << bytes;
    }
};

TEST_F(Plots, AreWholeOrMissing) {
    try {
        plot();
    } catch (const InputError&) {
        GTEST_SKIP() << "no gnuplot";
    }
    std::uintmax_t sizes[] = {std::filesystem::file_size(path("a.png")), std::filesystem::file_size(path("a.svg"))};
    for (const char* name : {"a.gp", "a.png", "a.svg"}) std::filesystem::remove(path(name));
    for (const std::uintmax_t size : sizes) {
        plot_within(size - 4);  // an SVG ends in blank lines
        EXPECT_TRUE(std::filesystem::is_empty(path("")));
    }
}

}  // namespace
}  // namespace loom
