// Edits after edits: the variances in the ledger add up to that of the sum, and a long chain ends at the mean of a new
// image.

#include "stages/residual/chain_of_edits.h"

#include <fmt/format.h>
#include <gtest/gtest.h>
#include <tbb/parallel_for.h>
#include <unistd.h>

#include <cmath>
#include <filesystem>

#include "stages/core/sampling/streams.h"
#include "stages/core/stats/chi_square.h"
#include "stages/core/stats/moments.h"
#include "tests/statistical/support.h"

namespace loom::residual {
namespace {

constexpr int replicates = 32;
const char* const rgb[] = {"R", "G", "B"};
using Values = std::vector<std::string>;  // NAME=VALUE of scenes/edits.xml

std::string scene_file() {
    return (source_dir() / "scenes/edits.xml").string();
}

Values with_size(Values values, int size) {
    for (const char* side : {"resx", "resy"}) values.push_back(fmt::format("{}={}", side, size));
    return values;
}
std::unique_ptr<Scene> scene_of(const Values& values) {
    return build_scene(read_scene(scene_file(), parse_defines(values)));
}

/// A first image without noise, so that all variance is from edits.
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

// 32 chains with their own seeds, of independent samples (stratified ones have less variance than their spread shows).
// Residual.VariancesAddUp tests that the first image's variance adds to that of an edit. Mutation tested here: one seed
// for both edits, after which a box moved and moved back leaves no noise.
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
                path.seed = own_seeds ? streams::edit(std::uint64_t(1000 + i), k) : std::uint64_t(1000 + i);
                sum = add_residual(sum, render_residual({*scenes[k - 1], *scenes[k]}, GetParam().method, path,
                                                        {0, spp, 1}, report, counts));
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
                for (std::size_t k = 0; k < size * size; ++k)
                    moments[std::size_t(c) * size * size + k].add(sum.find(rgb[c])[k]);
        }
        for (const Moments& m : moments) spread += m.var_sample() / double(moments.size());
        // Variance of a new image, from the new scene's paths of the last edit.
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
    fmt::print("{}: variance over that of the ledger: {:.3f}; with one seed for both edits {:.3f}\n", GetParam().name,
               own, same);
    EXPECT_NEAR(own, 1, 0.1);
    EXPECT_LE(same, GetParam().telescoped_at_most);
    EXPECT_GE(same, GetParam().telescoped_at_least);
}

INSTANTIATE_TEST_SUITE_P(
    Chains, TwoEdits,
    testing::Values(
        ChainCase{"there_and_back", {{}, {"x=-0.1", "z=0.4"}, {}}, Method::correlated, 0, 1e-9},
        ChainCase{"twice_brighter", {{}, {"light=28,23,16"}, {"light=42,34.5,24"}}, Method::correlated, 1.8, 2.2},
        ChainCase{"painted_and_turned", {{}, {"floor=blue"}, {"floor=blue", "turn=30"}}, Method::correlated, 0, 10},
        ChainCase{"independent", {{}, {"x=-0.1", "z=0.4"}, {}}, Method::independent, 1.5, 2.2}),
    [](const auto& info) { return std::string(info.param.name); });

/// The scenes of a chain: each differs from the previous one in one value of a box, an emitter, a wall or a material.
std::vector<Values> long_chain(std::size_t n_edits) {
    struct Parameter {
        const char* name;
        std::vector<const char*> values;
    };
    const std::vector<Parameter> parameters = {{"x", {"0.36", "0.1", "-0.15", "0.3"}},
                                               {"light", {"14,11.5,8", "10,11,12", "18,9,6"}},
                                               {"turn", {"-16", "30", "75"}},
                                               {"short", {"white", "blue", "brushed"}},
                                               {"floor", {"white", "blue"}},
                                               {"z", {"0.3", "0.45"}},
                                               {"tall", {"white", "blue"}},
                                               {"size", {"0.28", "0.2"}}};
    const std::size_t order[] = {0, 1, 2, 3, 0, 4, 5, 6, 1, 2, 7};
    std::vector<std::size_t> at(parameters.size());
    std::vector<Values> chain;
    for (std::size_t k = 0; k <= n_edits; ++k) {
        Values values = {"alpha=0.3", "target=0,-0.6,0"};  // the emitter out of view: its edge would dominate the noise
        for (std::size_t p = 0; p < parameters.size(); ++p)
            values.push_back(fmt::format("{}={}", parameters[p].name, parameters[p].values[at[p]]));
        chain.push_back(values);
        const std::size_t next = order[k % std::size(order)];
        at[next] = (at[next] + 1) % parameters[next].values.size();
    }
    return chain;
}

class Folder {
  public:
    Folder() : path_(std::filesystem::temp_directory_path() / fmt::format("loom-chain-{}", getpid())) {
        std::filesystem::create_directories(path_);
    }
    ~Folder() { std::filesystem::remove_all(path_); }
    std::string operator/(const std::string& name) const { return (path_ / name).string(); }

  private:
    std::filesystem::path path_;
};

// Edit after edit by the program's own function, from image file to image file, by correlated and by dynamic paths. The
// end is the last scene rendered anew (Welch), and the ledger's variance is that of the squared error. Stratified
// samples have less variance than their spread shows, so the ledger errs on the safe side: measured 0.63, and 0.65
// after fifty edits. Power: a bias of the image mean of 6 % is detected in nine of ten runs, in full runs of 2.7 %.
// Detected mutations: one seed for all edits (0.42 of the ledger); the third residual left out.
TEST(StabilityChainOfEdits, EndsAtAFreshPicture) {
    const int size = full_run() ? 32 : 16;
    const std::uint64_t base_spp = 32, spp = full_run() ? 8 : 4;
    std::vector<Values> chain = long_chain(full_run() ? 50 : 9);
    for (Values& values : chain) values = with_size(values, size);
    const Folder folder;
    std::vector<Image> sums(replicates);
    {
        const auto scene = scene_of(chain[0]);
        tbb::parallel_for(0, replicates, [&](int i) {
            app::Report report;
            report.set_quiet(true);
            PathOptions path = options_of(*scene);
            path.seed = std::uint64_t(100 + i);
            Counts counts;
            write_image(trace::render_image(*scene, path, {0, base_spp, 1}, report, counts),
                        folder / fmt::format("{}-0.exr", i));
        });
    }
    ::testing::internal::CaptureStderr();
    tbb::parallel_for(0, replicates, [&](int i) {
        for (std::size_t k = 1; k < chain.size(); ++k) {
            app::Report report;
            report.set_quiet(true);
            Options options;
            options.old_scene = scene_file();
            options.old_defines = chain[k - 1];
            options.new_defines = chain[k];
            options.old_picture = folder / fmt::format("{}-{}.exr", i, k - 1);
            options.new_picture = folder / fmt::format("{}-{}.exr", i, k);
            options.method = k % 5 == 3 ? Method::dynamic : Method::correlated;
            options.spp = spp;
            options.seed = std::uint64_t(100 + i);
            options.threads = 1;
            run(options, report);
        }
        sums[std::size_t(i)] = read_image(folder / fmt::format("{}-{}.exr", i, chain.size() - 1));
    });
    const std::string said = ::testing::internal::GetCapturedStderr();
    std::size_t proposals = 0;
    for (std::size_t at = 0; (at = said.find("re-base: loom-trace", at)) != std::string::npos; ++at) ++proposals;

    const auto scene = scene_of(chain.back());
    const Replicates fresh = trace_replicates(*scene, options_of(*scene), full_run() ? 512 : 64, replicates, 5000);
    const double alpha = sidak_alpha(3 * (1 + n_tiles * n_tiles));
    std::vector<RegionMeans> regions;
    for (const Image& sum : sums) regions.push_back(region_means(sum));
    double seen = 0;
    for (int c = 0; c < 3; ++c)
        for (int region = 0; region < 1 + n_tiles * n_tiles; ++region) {
            std::vector<double> means;
            for (const RegionMeans& of : regions) means.push_back(of[std::size_t(c)][std::size_t(region)]);
            const Estimate ours = estimate_of(means), reference = fresh.estimate(c, region);
            EXPECT_GT(welch_p_value(ours, reference), alpha)
                << fmt::format("channel {} region {}: chain {:.6g} +- {:.2g}, fresh {:.6g} +- {:.2g}", c, region,
                               ours.mean, ours.se, reference.mean, reference.se);
            if (region == 0)
                seen = std::max(seen, (student_critical(alpha, 2 * replicates - 2) + 1.28) *
                                          std::hypot(ours.se, reference.se) / reference.mean);
        }

    // Squared error against the reference, whose own variance is taken off.
    double squared = 0, claimed = 0, own = 0;
    for (int c = 0; c < 3; ++c) {
        const auto reference = fresh.mean.find(rgb[c]), noise = fresh.mean.find(std::string("VarMean.") + rgb[c]);
        for (std::size_t k = 0; k < reference.size(); ++k) {
            own += double(noise[k]) / (3.0 * double(reference.size()));
            for (const Image& sum : sums)
                squared += std::pow(double(sum.find(rgb[c])[k]) - double(reference[k]), 2) /
                           (3.0 * double(reference.size()) * replicates);
        }
    }
    for (const Image& sum : sums) {
        ASSERT_EQ(sum.ledger.size(), chain.size());
        claimed += accumulated_var_mean(sum.ledger, sum.ledger.size()) / replicates;
        EXPECT_EQ(sum.scene.hash, sums[0].scene.hash);
    }
    const Standing standing = standing_of(sums[0].ledger);
    const double ratio = (squared - own) / claimed;
    fmt::print(
        "{} edits: squared error {:.4g} (reference {:.2g}), the ledger says {:.4g}: {:.3f}; by edits {:.1f} %, worth "
        "{:.3g} of {} samples, {:.1f} proposals a chain; "
        "bias of the image mean that is seen: {:.2f} %\n",
        chain.size() - 1, squared - own, own, claimed, ratio, 100 * standing.var_mean_of_edits / standing.var_mean,
        standing.worth, standing.base_samples, double(proposals) / replicates, 100 * seen);
    EXPECT_GT(ratio, 0.5);
    EXPECT_LT(ratio, 1);
    EXPECT_GE(proposals, std::size_t(replicates));  // at the end of each chain if not before
}

}  // namespace
}  // namespace loom::residual
