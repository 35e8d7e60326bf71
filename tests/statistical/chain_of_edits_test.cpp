// Edits after edits: the variances in the ledger add up to that of the sum, and a long chain ends at a fresh picture.

#include "stages/residual/chain_of_edits.h"

#include <fmt/format.h>
#include <gtest/gtest.h>
#include <tbb/parallel_for.h>
#include <unistd.h>

#include <cmath>

#include "stages/core/stats/chi_square.h"
#include "stages/core/stats/moments.h"
#include "tests/statistical/support.h"

namespace loom::residual {
namespace {

constexpr int replicates = 32;
const char* const rgb[] = {"R", "G", "B"};
using Values = std::vector<std::string>;  // NAME=VALUE of scenes/edits.xml

std::string scene_file() { return (source_dir() / "scenes/edits.xml").string(); }

Values with_size(Values values, int size) {
    for (const char* side : {"resx", "resy"}) values.push_back(fmt::format("{}={}", side, size));
    return values;
}
std::unique_ptr<Scene> scene_of(const Values& values) { return build_scene(read_scene(scene_file(), parse_defines(values))); }

/// A first picture without noise, so that all variance is that of edits.
Image black(int size) {
    Image image;
    image.width = image.height = std::uint32_t(size);
    image.samples = 2;
    for (const char* c : rgb) {
        image.add(c);
        image.add(std::string("VarMean.") + c);
    }
    return image;
}

struct ChainCase {
    const char* name;
    std::vector<Values> scenes;
    Method method;
    double telescoped_at_least, telescoped_at_most;  // variance over that of the ledger with one seed for both edits
};

class TwoEdits : public testing::TestWithParam<ChainCase> {};

// By 32 chains with their own seeds, of samples that are independent (stratified ones have less variance than their spread
// says); that the first picture's variance adds up with an edit's is Residual.VariancesAddUp. Break made here on purpose and
// seen: one seed for both edits, after which nothing is left of a box moved and moved back.
TEST_P(TwoEdits, HaveTheVarianceThatTheLedgerSays) {
    constexpr int size = 24;
    constexpr std::uint64_t spp = 8;
    std::vector<std::unique_ptr<Scene>> scenes;
    for (const Values& values : GetParam().scenes) scenes.push_back(scene_of(with_size(values, size)));
    const auto ratio_of = [&](bool own_seeds) {
        std::vector<Image> sums(replicates);
        tbb::parallel_for(0, replicates, [&](int i) {
            app::Report report;
            report.set_quiet(true);
            PathOptions path = options_of(*scenes[0]);
            path.sampler = SamplerKind::independent;
            Counts counts;
            Image sum = black(size);
            for (std::size_t k = 1; k < scenes.size(); ++k) {
                path.seed = own_seeds ? seed_of_edit(std::uint64_t(1000 + i), k) : std::uint64_t(1000 + i);
                sum = add_residual(sum, render_residual({*scenes[k - 1], *scenes[k]}, GetParam().method, path, {0, spp, 1}, report, counts));
            }
            sums[std::size_t(i)] = std::move(sum);
        });
        double spread = 0, claimed = 0, var_sample = 0;
        std::vector<Moments> moments(3 * size * size);
        for (const Image& sum : sums) {
            EXPECT_EQ(sum.ledger.size(), scenes.size());
            const double claims = accumulated_var_mean(sum.ledger, sum.ledger.size());
            EXPECT_NEAR(claims, mean_var_mean(sum), 1e-5 * claims);
            claimed += claims / replicates;
            var_sample += sum.ledger.back().var_sample / replicates;
            for (int c = 0; c < 3; ++c)
                for (std::size_t k = 0; k < size * size; ++k) moments[std::size_t(c) * size * size + k].add(sum.find(rgb[c])[k]);
        }
        for (const Moments& m : moments) spread += m.var_sample() / double(moments.size());
        // What a fresh picture's variance would be, from the new scene's paths of the last edit.
        if (own_seeds) {
            PathOptions path = options_of(*scenes.back());
            path.sampler = SamplerKind::independent;
            path.seed = 77;
            app::Report report;
            report.set_quiet(true);
            Counts counts;
            const Image fresh = trace::render_image(*scenes.back(), path, {0, 32 * spp, 0}, report, counts);
            EXPECT_NEAR(var_sample / (mean_var_mean(fresh) * 32 * spp), 1, 0.1);
        }
        return spread / claimed;
    };
    const double own = ratio_of(true), same = ratio_of(false);
    fmt::print("{}: variance over that of the ledger: {:.3f}; with one seed for both edits {:.3f}\n", GetParam().name, own, same);
    EXPECT_NEAR(own, 1, 0.1);
    EXPECT_LE(same, GetParam().telescoped_at_most);
    EXPECT_GE(same, GetParam().telescoped_at_least);
}

INSTANTIATE_TEST_SUITE_P(Chains, TwoEdits,
                         testing::Values(ChainCase{"there_and_back", {{}, {"x=-0.1", "z=0.4"}, {}}, Method::correlated, 0, 1e-9},
                                         ChainCase{"twice_brighter", {{}, {"light=28,23,16"}, {"light=42,34.5,24"}}, Method::correlated, 1.8, 2.2},
                                         ChainCase{"painted_and_turned", {{}, {"floor=blue"}, {"floor=blue", "turn=30"}}, Method::correlated, 0, 10},
                                         ChainCase{"independent", {{}, {"x=-0.1", "z=0.4"}, {}}, Method::independent, 1.5, 2.2}),
                         [](const auto& info) { return std::string(info.param.name); });

}  // namespace
}  // namespace loom::residual
