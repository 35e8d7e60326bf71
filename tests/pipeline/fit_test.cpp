// `make fit` from a measured cube to values with error bars: what it finds, that a killed fit goes on, what it refuses.

#include "formats/fit.h"

#include <fmt/format.h>

#include <cmath>

#include "tests/pipeline/process.h"

namespace loom::pipeline {
namespace {

class MakeFit : public PipelineTest {
  protected:
    /// A panel around a corner at x = .1, y = 0, z = 1.1, as measured.
    void SetUp() override {
        PipelineTest::SetUp();
        EXPECT_EQ(sh(stage("trace") +
                     " scenes/hidden.xml -D res=6 -D x=0.1 -D z=1.1 --sampler independent --seed 5 --spp 512 -o " +
                     in("graph.h5") + " && " + stage("transient") + " " + in("graph.h5") + " -o " + in("measured.h5"))
                      .code,
                  0);
    }
    std::string in(const std::string& name) const { return (folder / name).string(); }
    std::string make(const std::string& out, const std::string& variables = "") const {
        return fmt::format(
            "make -s -f pipelines/fit.mk BUILD={} OUT={} MEASURED={} WRT='x z' DEFINES='res=6 x=0 z=1' SPP=128 {}",
            fs::path(LOOM_BIN_DIR).parent_path().string(), in(out), in("measured.h5"), variables);
    }
};

TEST_F(MakeFit, finds_a_hidden_panel_and_goes_on_when_killed) {
    const Outcome outcome = sh(make("x", "TRUTH='x=.1 z=1.1' LOWER='z=.5' UPPER='z=2'"));
    ASSERT_EQ(outcome.code, 0) << outcome.err;
    EXPECT_EQ(outcome.out, in("x/fit.h5") + "\n");
    const Fit fit = read_fit(folder / "x/fit.h5");
    EXPECT_EQ(fit.state.status, "converged");
    EXPECT_LE(fit.n_evaluations(), 40u);
    for (const auto& [i, truth] : {std::pair{0, 0.1}, {1, 1.1}}) {
        const double sigma = std::sqrt(fit.parameters.covariance[std::size_t(3 * i)]);
        EXPECT_NEAR(fit.parameters.value[std::size_t(i)], truth, 4 * sigma) << i;
        EXPECT_LT(sigma, 0.02) << i;
        EXPECT_GT(sigma, 1e-5) << i;
    }
    EXPECT_EQ(fit.parameters.lower[1], 0.5);
    EXPECT_EQ(fit.parameters.upper[1], 2);
    for (const char* file : {"x/loss.svg", "x/parameters.svg", "x/fit.tsv", "x/fits/fit-1.h5", "x/fits/fit-1.values",
                             "x/start/streak-x.png", "x/fitted/strip.png", "x/measured/strip.png"})
        EXPECT_TRUE(fs::exists(folder / file)) << file;
    EXPECT_FALSE(fs::exists(folder / "x/fits/graph-0.h5"));
    EXPECT_NE(outcome.err.find("error bars"), std::string::npos);

    // Nothing is left to do; a killed fit ends with the same bytes.
    const Outcome again = sh(make("x", "TRUTH='x=.1 z=1.1' LOWER='z=.5' UPPER='z=2'"));
    EXPECT_EQ(again.err.find("loom-trace"), std::string::npos) << again.err;
    for (const char* seconds : {"0.3", "0.7", "1.1"})
        sh("setsid " + make("y", "LOWER='z=.5' UPPER='z=2'") + " & sleep " + seconds + "; kill -9 -$!; wait; true");
    const Outcome rest = sh(make("y", "LOWER='z=.5' UPPER='z=2'"));
    EXPECT_EQ(rest.code, 0) << rest.err;
    EXPECT_TRUE(bytes_of(folder / "x/fit.h5") == bytes_of(folder / "y/fit.h5"));
}

// Bins and pulse are those of the measurement, whatever the film says.
TEST_F(MakeFit, takes_the_bins_of_the_measurement) {
    EXPECT_EQ(sh(stage("transient") + " " + in("graph.h5") +
                 " --start 1.2 --width 0.03 --bins 70 --pulse gaussian --pulse-length 0.05 -o " + in("measured.h5"))
                  .code,
              0);
    const Outcome outcome = sh(make("x", "MAX_EVALUATIONS=1"));
    EXPECT_EQ(outcome.code, 0) << outcome.err;
    EXPECT_EQ(read_fit(folder / "x/fit.h5").n_evaluations(), 1u);
}

TEST_F(MakeFit, goes_on_with_more_evaluations) {
    EXPECT_EQ(sh(make("x", "MAX_EVALUATIONS=2 METHOD=adam SCALE='x=.1 z=.1'")).code, 0);
    EXPECT_EQ(read_fit(folder / "x/fit.h5").state.status, "stopped");
    EXPECT_EQ(sh(make("x", "MAX_EVALUATIONS=4 METHOD=adam SCALE='x=.1 z=.1'")).code, 0);
    EXPECT_EQ(read_fit(folder / "x/fit.h5").n_evaluations(), 4u);
}

TEST_F(MakeFit, refuses_what_does_not_belong_together) {
    struct Refusal {
        std::string variables, says;
    };
    for (const auto& [variables, says] : std::vector<Refusal>{
             {"BINS=64", "unlike"},
             {"DEFINES='res=4'", "is 4 x 4 pixels, but"},
             {"WRT=shape:panel/pose", "has no value that a scene could be given; fit a $parameter of the scene"},
             {"UPPER='z=0.5'", "z is 1, outside of its bounds"},
             {"SCALE='q=1'", "the cubes have derivatives by x, z alone"},
             {"FIT='--merge 4,x'", "must be numbers of bins"},
             {"METHOD=guess", "'guess' is not one of lm|adam|gradient"},
             {"LOWER='z=a;id'", "must not have ; in it"},
             {"MEASURED=none.h5", "no such file"},
             {"DEFINES='res=6 z=40'", "no bin depends on"}}) {
        const Outcome outcome = sh(make("x", variables));
        EXPECT_EQ(outcome.code, 2) << variables;
        EXPECT_NE(outcome.err.find(says), std::string::npos) << variables << "\n" << outcome.err;
        EXPECT_FALSE(fs::exists(folder / "x/fit.h5")) << variables;
    }
}

}  // namespace
}  // namespace loom::pipeline
