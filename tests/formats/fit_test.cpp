// Fits: written and read again; every way in which a file can be wrong is refused with the name of the dataset.
#include "formats/fit.h"

#include <gtest/gtest.h>

#include "formats/io/error.h"
#include "tests/formats/tiny_graph.h"

namespace loom {
namespace {

using testing::input_error_of;
using testing::ScratchFolder;
using Numbers = std::vector<double>;

Fit tiny_fit() {
    Fit f;
    f.measured = "0123456789abcdef";
    f.settings.merged_bins = {4, 1};
    auto& p = f.parameters;
    p.name = {"x", "y"}, p.unit = {"1", "1"};
    p.value = {0.5, -1}, p.start = {0, 0};
    p.lower = {-1, -1e308}, p.upper = {1, 1e308};
    p.scale = {0, 2}, p.prior_mean = {0, 1}, p.prior_sigma = {0, 3};
    p.covariance = Numbers(4, 5), p.sigma_error = {0.1, 0.2};
    for (Fit::Point* point : {&f.best, &f.minimum}) {
        point->loss = 5;
        point->value = {0.4, -2}, point->gradient = {6, 7};
        point->normal = Numbers(4, 8), point->curvature = Numbers(4, 9);
        point->normal_variance = {1, 2}, point->measured_noise = Numbers(4, 9), point->noise = Numbers(4, 10),
        point->scatter = Numbers(4, 11);
    }
    f.state.level = 1, f.state.lambda = 1e-3;
    f.state.adam_mean = {0, 0}, f.state.adam_square = {0, 0};
    auto& h = f.history;
    h.value = {0, 0, 0.4, -2, 0.5, -1};
    h.loss = {3, 2, 1}, h.loss_sigma = {0.1, 0.1, 0.1}, h.lambda = {0, 0, 1e-3};
    h.merged_bins = {4, 4, 1}, h.paths = {64, 64, 64}, h.accepted = {1, 1, 0};
    f.provenance.stage = "loom-test";
    return f;
}

TEST(FitFile, ReadsWhatWasWritten) {
    const ScratchFolder folder;
    Fit f = tiny_fit();
    f.minimum = {};
    write_fit(f, folder / "f.h5", Sync::no);
    EXPECT_TRUE(read_fit(folder / "f.h5").minimum.value.empty());
    f = tiny_fit();
    write_fit(f, folder / "f.h5", Sync::no);
    const Fit read = read_fit(folder / "f.h5");
    EXPECT_EQ(read.minimum.loss, 5);
    EXPECT_EQ(read.minimum.scatter[3], 11);
    EXPECT_EQ(read.measured, f.measured);
    EXPECT_EQ(read.parameters.name, f.parameters.name);
    EXPECT_EQ(read.n_evaluations(), 3u);
    EXPECT_EQ(read.state.level, 1u);
    EXPECT_EQ(read.state.lambda, 1e-3);
    for (const auto member : {&Fit::Parameters::value, &Fit::Parameters::upper, &Fit::Parameters::covariance})
        EXPECT_TRUE(std::equal((f.parameters.*member).begin(), (f.parameters.*member).end(),
                               (read.parameters.*member).begin(), (read.parameters.*member).end()));
    EXPECT_TRUE(std::equal(f.history.value.begin(), f.history.value.end(), read.history.value.begin(),
                           read.history.value.end()));
}

TEST(FitFile, RefusesWhatIsWrong) {
    const ScratchFolder folder;
    struct Wrong {
        void (*change)(Fit&);
        const char* says;
    };
    for (const auto& [change, says] : std::vector<Wrong>{
             {[](Fit& f) { f.settings.method = "guess"; }, "settings/method: is guess, expected lm, adam or gradient"},
             {[](Fit& f) { f.settings.loss = "none"; },
              "settings/loss: is none, expected squares, pyramid or time-cdf"},
             {[](Fit& f) { f.state.status = "lost"; }, "state/status: is lost, expected running, converged or stopped"},
             {[](Fit& f) {
                  f.settings.merged_bins = {4, 0};
              },
              "settings/merged_bins: a row is 0"},
             {[](Fit& f) { f.settings.merged_bins = {}; }, "settings/merged_bins: is empty"},
             {[](Fit& f) { f.state.level = 2; }, "state/level: is 2, but settings/merged_bins has 2 rows"},
             {[](Fit& f) {
                  f.parameters.value = {2, 0};
              },
              "parameters/value: x is 2, not in -1 to 1"},
             {[](Fit& f) {
                  f.parameters.scale = {0, -1};
              },
              "parameters/scale: of y is negative"},
             {[](Fit& f) {
                  f.parameters.prior_sigma = {-2, 1};
              },
              "parameters/prior_sigma: of x is negative"}}) {
        Fit f = tiny_fit();
        change(f);
        write_fit(f, folder / "f.h5", Sync::no);
        const std::string said = input_error_of([&] { read_fit(folder / "f.h5"); });
        EXPECT_NE(said.find(says), std::string::npos) << said;
    }
}

TEST(FitFile, DamagedBytesDoNoHarm) {
    const ScratchFolder folder;
    write_fit(tiny_fit(), folder / "x.h5", Sync::no);
    testing::read_damaged(folder / "x.h5", [](const auto& path) { (void)read_fit(path); });
}

}  // namespace
}  // namespace loom
