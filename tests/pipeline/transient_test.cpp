// `make transient` from scene to cube and images, and the stages around a cube.

#include <algorithm>
#include <cmath>

#include "formats/image.h"
#include "formats/transient_cube.h"
#include "tests/pipeline/process.h"

namespace loom::pipeline {
namespace {

const std::string small = "SCENE=scenes/flash.xml DEFINES='resx=24 resy=16' SPP=2 PASSES=3 ";

class MakeTransient : public PipelineTest {
  protected:
    std::string make(const std::string& out, const std::string& variables) const {
        return "make -s -f pipelines/transient.mk BUILD='" + fs::path(LOOM_BIN_DIR).parent_path().string() +
               "' OUT=" + (folder / out).string() + " " + variables;
    }
    /// Runs a make that must succeed, its one line on stdout the path of the cube.
    fs::path cube(const std::string& out, const std::string& variables) {
        const Outcome outcome = sh(make(out, variables) + " transient");
        EXPECT_EQ(outcome.code, 0) << outcome.err;
        EXPECT_EQ(outcome.out, (folder / out / "cube.h5").string() + "\n");
        last_err = outcome.err;
        return folder / out / "cube.h5";
    }
    bool up_to_date(const std::string& out, const std::string& variables) {
        return sh(make(out, variables) + " -q " + (folder / out / "strip.png").string()).code == 0;
    }
    /// Sums over pixels and bins of one channel's before, bins, after, never and steady.
    struct Sums {
        double before = 0, bins = 0, after = 0, never = 0, steady = 0;
    };
    static Sums sums(const TransientCube& cube) {
        Sums s;
        for (std::size_t i = 1; i < cube.radiance.size(); i += 3) s.bins += cube.radiance[i];
        for (std::size_t i = 1; i < cube.steady.size(); i += 3)
            s.before += cube.before[i], s.after += cube.after[i], s.never += cube.never[i], s.steady += cube.steady[i];
        return s;
    }
    std::string last_err;
};

TEST_F(MakeTransient, front_door_prints_only_the_path) {
    const Outcome outcome = sh("make -s transient BUILD='" + fs::path(LOOM_BIN_DIR).parent_path().string() + "' " +
                               small + "OUT=" + (folder / "x").string());
    EXPECT_EQ(outcome.code, 0) << outcome.err;
    EXPECT_EQ(outcome.out, (folder / "x/cube.h5").string() + "\n");
}

// The output of `make` alone. Detected mutation: OUT= passed on empty, which no makefile can then set.
TEST_F(MakeTransient, demo_has_the_cube_in_its_folder) {
    for (const auto& [out, cube] : {std::pair<std::string, std::string>{"", "out/demo/transient/cube.h5"},
                                    {" OUT=some/where", "some/where/transient/cube.h5"}}) {
        const Outcome outcome = sh("make -n demo BUILD='" + fs::path(LOOM_BIN_DIR).parent_path().string() + "'" + out);
        EXPECT_EQ(outcome.code, 0) << outcome.err;
        EXPECT_NE(outcome.out.find(cube), std::string::npos)
            << outcome.out.substr(outcome.out.size() > 500 ? outcome.out.size() - 500 : 0);
    }
}

TEST_F(MakeTransient, cube_has_the_film_of_the_scene_and_all_of_its_light) {
    const TransientCube c = read_transient_cube(cube("x", small));
    EXPECT_EQ(c.film.width, 24u);
    EXPECT_EQ(c.film.height, 16u);
    EXPECT_EQ(c.film.samples_per_pixel, 6u);
    EXPECT_EQ(c.time.n_bins, 300u);
    EXPECT_EQ(c.time.start_opl, 4.3);
    const Sums s = sums(c);
    EXPECT_NEAR(s.before + s.bins + s.after + s.never, s.steady, 1e-5 * s.steady);
    EXPECT_GT(s.bins, 0.98 * s.steady);
    // The same samples, path traced.
    const fs::path exr = folder / "pt.exr";
    ASSERT_EQ(sh(stage("trace") + " scenes/flash.xml -D resx=24 -D resy=16 --spp 6 --quiet -o " + exr.string()).code,
              0);
    const Image image = read_image(exr);
    const auto g = image.find("G");
    for (std::size_t i = 0; i < g.size(); ++i)
        EXPECT_NEAR(c.steady[3 * i + 1], g[i], 1e-4 * std::max(g[i], 0.01f)) << i;
    for (const char* picture : {"strip.png", "streak-x.png", "streak-y.png", "peak.png", "curves.svg", "curves.png",
                                "curves.tsv", "frames/frame-0299.png"})
        EXPECT_TRUE(fs::exists(folder / "x" / picture)) << picture;
    EXPECT_TRUE(up_to_date("x", small));
}

TEST_F(MakeTransient, another_pulse_bins_the_same_paths_without_tracing) {
    const fs::path file = cube("x", small);
    const std::string before = bytes_of(file);
    const auto traced = fs::last_write_time(folder / "x/transient/pass-0.h5");
    const std::string changed = small + "PULSE=gaussian LENGTH=0.2 UNIT=ns START=12 WIDTH=0.2 BINS=200 ";
    EXPECT_FALSE(up_to_date("x", changed));
    cube("x", changed);
    EXPECT_EQ(last_err.find("loom-trace"), std::string::npos) << last_err;
    EXPECT_EQ(fs::last_write_time(folder / "x/transient/pass-0.h5"), traced);
    const TransientCube c = read_transient_cube(file);
    EXPECT_EQ(c.time.n_bins, 200u);
    EXPECT_EQ(c.time.unit, "ns");
    EXPECT_NEAR(c.time.bin_width_opl, 0.2 * speed_of_light, 1e-12);
    EXPECT_EQ(c.response.pulse, "gaussian");
    EXPECT_FALSE(fs::exists(folder / "x/frames/frame-0200.png"));  // frames of the longer cube are gone
    // More passes keep those that are there; the old parameters make the old bytes.
    cube("x", small);
    EXPECT_TRUE(before == bytes_of(file));
    cube("x", small + "PASSES=4");
    EXPECT_EQ(fs::last_write_time(folder / "x/transient/pass-0.h5"), traced);
}

TEST_F(MakeTransient, graphs_that_go_leave_the_same_cube_merged) {
    const TransientCube together = read_transient_cube(cube("x", small)),
                        merged = read_transient_cube(cube("y", small + "KEEP=0"));
    EXPECT_FALSE(fs::exists(folder / "y/transient/pass-0.h5"));
    EXPECT_EQ(merged.film.samples_per_pixel, 6u);
    ASSERT_EQ(merged.radiance.size(), together.radiance.size());
    for (std::size_t i = 0; i < merged.radiance.size(); ++i) {
        EXPECT_NEAR(merged.radiance[i], together.radiance[i], 1e-6f * together.radiance[i]);
        EXPECT_NEAR(merged.var_mean[i], together.var_mean[i], 1e-5f * together.var_mean[i]);
    }
    EXPECT_TRUE(up_to_date("y", small + "KEEP=0"));
    cube("y", small + "KEEP=0 PASSES=4");
    EXPECT_EQ(last_err.find("pass-0.h5"), std::string::npos) << last_err;
}

TEST_F(MakeTransient, clusters_share_the_light_of_the_same_graphs) {
    const TransientCube alone = read_transient_cube(cube("x", small));
    const auto traced = fs::last_write_time(folder / "x/transient/pass-0.h5");
    const TransientCube shared = read_transient_cube(cube("x", small + "K=16"));
    EXPECT_EQ(fs::last_write_time(folder / "x/transient/pass-0.h5"), traced);
    EXPECT_TRUE(fs::exists(folder / "x/transient/pass-2.clusters.h5"));
    EXPECT_TRUE(up_to_date("x", small + "K=16"));
    EXPECT_FALSE(up_to_date("x", small + "K=8"));
    // The same light, spread over more bins.
    EXPECT_NEAR(sums(shared).steady, sums(alone).steady, 0.05 * sums(alone).steady);
    const auto lit = [](const TransientCube& c) {
        return std::count_if(c.radiance.begin(), c.radiance.end(), [](float x) { return x > 0; });
    };
    EXPECT_GT(lit(shared), 2 * lit(alone));
}

TEST_F(MakeTransient, wrong_variables_are_refused) {
    for (const char* wrong :
         {"SPP=0", "PASSES=x", "BINS=0", "WIDTH=-1", "UNIT=feet", "PULSE=none", "PULSE=box", "OUT='two words'",
          "SAMPLER=none", "K=0", "K=8 KEEP=0", "SCENE=missing.xml", "DRAW='--row 16'", "DRAW='--pixel 24:0'"}) {
        const Outcome outcome = sh(make("x", small + std::string(wrong)) + " transient");
        EXPECT_EQ(outcome.code, 2) << wrong << "\n" << outcome.err;
        EXPECT_EQ(outcome.out, "") << wrong;
    }
}

TEST_F(MakeTransient, cubes_are_compared_and_judged) {
    const std::string a = cube("a", small + "SAMPLER=independent SEED=1"),
                      b = cube("b", small + "SAMPLER=independent SEED=2");
    const std::string late = cube("late", small + "SAMPLER=independent SEED=3 DEFINES='resx=24 resy=16 start=4.6'");
    const std::string judged = " --fail-below p_bins=1e-6 --fail-below p_pixels=1e-6";
    const Outcome alike = sh(stage("compare") + " " + a + " " + b + judged);
    EXPECT_EQ(alike.code, 0) << alike.err << alike.out;
    EXPECT_NE(alike.out.find("24 x 16, 300 bins"), std::string::npos) << alike.out;
    // Bins are compared only with equal windows; a cube is not compared with an image.
    const Outcome other = sh(stage("compare") + " " + a + " " + late);
    EXPECT_EQ(other.code, 2);
    EXPECT_NE(other.err.find("has bins of 0.03"), std::string::npos) << other.err;
    ASSERT_EQ(
        sh(stage("trace") + " scenes/flash.xml -D resx=24 -D resy=16 --quiet -o " + (folder / "pt.exr").string()).code,
        0);
    EXPECT_EQ(sh(stage("compare") + " " + a + " " + (folder / "pt.exr").string()).code, 2);
    EXPECT_EQ(sh(stage("compare") + " " + (folder / "pt.exr").string() + " " + a).code, 2);
    // Light that is 1 % slower, three bins late.
    const std::string ten = small + "SAMPLER=independent SPP=64 ";
    const std::string right = cube("right", ten + "SEED=4 START=4.3 WIDTH=0.03"),
                      shifted = cube("shifted", ten + "SEED=5 START=4.3 WIDTH=0.03 TRANSIENT='--group-index 1=1.01'");
    const Outcome seen = sh(stage("compare") + " " + shifted + " " + right + judged);
    EXPECT_EQ(seen.code, 1) << seen.err << seen.out;
    const Outcome tsv = sh(stage("compare") + " x=" + a + " x=" + b + " -r " + right + " --cost --tsv");
    EXPECT_EQ(tsv.code, 0) << tsv.err;
    EXPECT_EQ(std::count(tsv.out.begin(), tsv.out.end(), '\n'), 3);
}

TEST_F(MakeTransient, charts_of_error_over_samples_and_cost) {
    const std::string run = "make -s -f pipelines/chart-transient.mk BUILD='" +
                            fs::path(LOOM_BIN_DIR).parent_path().string() + "' OUT=" + (folder / "c").string() +
                            " DEFINES='resx=8 resy=8' SPPS='1 4 16' REPLICATES=2 REFERENCE_SPP=256 ";
    const Outcome outcome = sh(run);
    EXPECT_EQ(outcome.code, 0) << outcome.err;
    EXPECT_NE(outcome.out.find("flash: independent: rmse falls as samples^"), std::string::npos) << outcome.out;
    for (const char* file : {"error-samples.svg", "error-samples.png", "error-samples.tsv", "error-cost.svg",
                             "error-cost.png", "errors.tsv"})
        EXPECT_TRUE(fs::exists(folder / "c" / file)) << file;
    EXPECT_NE(outcome.out.find((folder / "c/error-cost.png").string() + "\n"), std::string::npos);
    // Nothing is traced again, and one more point traces its cubes alone.
    EXPECT_EQ(sh(run).err.find("loom-trace"), std::string::npos);
    const Outcome more = sh(run + "SPPS='1 4 16 32' SAMPLERS=sobol");
    EXPECT_EQ(more.code, 0) << more.err;
    EXPECT_EQ(more.err.find("sobol-16-0/transient/pass"), std::string::npos) << more.err;
    EXPECT_NE(more.err.find("sobol-32-0/transient/pass"), std::string::npos) << more.err;
    EXPECT_EQ(sh(run + "SAMPLERS=halton").code, 2);
    EXPECT_EQ(sh(run + "SPPS=1025").code, 2);
}

TEST_F(MakeTransient, pictures_are_the_same_bytes_twice_and_a_movie_needs_ffmpeg) {
    const std::string file = cube("x", small);
    fs::create_directories(folder / "again");
    fs::create_directories(folder / "bin");
    const std::string gnuplot = sh("command -v gnuplot").out;
    fs::create_symlink(gnuplot.substr(0, gnuplot.find('\n')), folder / "bin/gnuplot");
    const Outcome none =
        sh("PATH=" + (folder / "bin").string() + " " + stage("frames") + " " + file + " -o " +
           (folder / "again/strip.png").string() + " --movie " + (folder / "again/movie.mp4").string());
    EXPECT_EQ(none.code, 0) << none.err;
    EXPECT_NE(none.err.find("no movie: ffmpeg is not installed (Debian: apt install ffmpeg)"), std::string::npos)
        << none.err;
    EXPECT_FALSE(fs::exists(folder / "again/movie.mp4"));
    EXPECT_FALSE(fs::exists(folder / "again/frames"));
    for (const char* picture :
         {"strip.png", "streak-x.png", "streak-y.png", "peak.png", "curves.svg", "curves.png", "curves.tsv"})
        EXPECT_TRUE(bytes_of(folder / "x" / picture) == bytes_of(folder / "again" / picture)) << picture;
    // A failing ffmpeg leaves no movie; a working one gets the frames and the requested rate.
    std::ofstream(folder / "bin/ffmpeg") << "#!/bin/sh\necho \"$@\" >" << (folder / "asked").string()
                                         << "\nfor last in \"$@\"; do :; done\n[ -e " << (folder / "broken").string()
                                         << " ] && exit 1\necho movie >\"$last\"\n";
    fs::permissions(folder / "bin/ffmpeg", fs::perms::owner_all);
    const std::string run = "PATH=" + (folder / "bin").string() + " " + stage("frames") + " " + file +
                            " --fps 12.5 -o " + (folder / "again/strip.png").string() + " --movie " +
                            (folder / "again/movie.mp4").string();
    EXPECT_EQ(sh(run).code, 0);
    EXPECT_EQ(bytes_of(folder / "again/movie.mp4"), "movie\n");
    EXPECT_NE(bytes_of(folder / "asked").find("-framerate 12.5 -i frame-%04d.png"), std::string::npos)
        << bytes_of(folder / "asked");
    std::ofstream(folder / "broken") << "";
    const Outcome broken = sh(run);
    EXPECT_EQ(broken.code, 3);
    EXPECT_NE(broken.err.find("ffmpeg"), std::string::npos) << broken.err;
    EXPECT_FALSE(fs::exists(folder / "again/movie.mp4"));
}

}  // namespace
}  // namespace loom::pipeline
