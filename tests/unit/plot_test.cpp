// gnuplot ends with 0 when the disk is full; an image that is not whole must not get its name.

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
    void plot(const std::string& format) const {
        plot::make_pictures(path(""),
                            {{"a.gp", "set terminal " + format + "; set output 'a." + format + "'; plot x\n"}}, "a.gp",
                            {"a." + format});
    }
    void plot_within(std::uintmax_t bytes, const std::string& format) const {
        rlimit before{};
        getrlimit(RLIMIT_FSIZE, &before);
        const auto signal = std::signal(SIGXFSZ, SIG_IGN);
        const rlimit limit{bytes, before.rlim_max};
        setrlimit(RLIMIT_FSIZE, &limit);
        bool failed = false;
        try {
            plot(format);
        } catch (const std::runtime_error&) {
            failed = true;
        }
        setrlimit(RLIMIT_FSIZE, &before);
        std::signal(SIGXFSZ, signal);
        EXPECT_TRUE(failed) << format;
    }
};

// Detected mutations: the end of a PNG or of an SVG not checked; the commands kept although the image failed.
TEST_F(Plots, AreWholeOrMissing) {
    for (const std::string format : {"png", "svg"}) {
        try {
            plot(format);
        } catch (const InputError&) {
            GTEST_SKIP() << "no gnuplot";
        }
        const std::uintmax_t size = std::filesystem::file_size(path("a." + format));
        std::filesystem::remove(path("a.gp"));
        std::filesystem::remove(path("a." + format));
        plot_within(size - 4, format);  // an SVG ends in blank lines
        EXPECT_TRUE(std::filesystem::is_empty(path(""))) << format;
    }
}

}  // namespace
}  // namespace loom
