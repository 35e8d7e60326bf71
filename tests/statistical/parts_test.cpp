// A static image plus the parts of the paths that what is added touches against a fresh image: image means and 8 x 8 tiles by
// Welch's test, for objects and lights that are hard on the partition; and the parts against brute force on many paths.

#include <fmt/format.h>
#include <gtest/gtest.h>
#include <tbb/parallel_for.h>

#include "stages/core/edit/edit_reach.h"
#include "stages/core/stats/chi_square.h"
#include "stages/residual/estimators.h"
#include "stages/residual/stored/path_parts.h"
#include "tests/parts_by_force.h"
#include "tests/statistical/edit_cases.h"

namespace loom::residual {
namespace {

constexpr int replicates = 32;
constexpr const char* rgb[] = {"R", "G", "B"};

const std::string end = "</scene>";
std::string ball(const std::string& centre, double radius, const std::string& bsdf) {
    return fmt::format(
        R"(<shape type="sphere"><point name="center" value="{}"/><float name="radius" value="{}"/>{}</shape>)", centre,
        radius, bsdf);
}
std::string cube(const std::string& size, const std::string& place) {
    return fmt::format(
        R"(<shape type="cube"><transform name="to_world"><scale {}/><translate {}/></transform><ref id="red"/></shape>)",
        size, place);
}

/// What is dynamic is absent from the old scene, as from the static scene of an animation.
const std::vector<EditCase>& additions() {
    static const std::string
        diffuse = R"(<bsdf type="diffuse"><rgb name="reflectance" value="0.7, 0.5, 0.2"/></bsdf>)",
        metal =
            R"(<bsdf type="roughconductor"><string name="material" value="Au"/><float name="alpha" value="0.1"/></bsdf>)",
        glass = R"(<bsdf type="dielectric"/>)",
        glow =
            R"(<bsdf type="diffuse"><rgb name="reflectance" value="0"/></bsdf><emitter type="area"><rgb name="radiance" value="6, 8, 9"/></emitter>)",
        lamp = "<translate y=\"0.99\"/>", lamp_moved = "<translate x=\"-0.5\" y=\"0.99\" z=\"0.3\"/>";
    static const std::vector<EditCase> all = {
        {"diffuse", {{end, ball("0.3, -0.1, 0.4", 0.25, diffuse) + end}}},
        {"metal", {{end, ball("0.3, -0.1, 0.4", 0.25, metal) + end}}},
        {"glass", {{end, ball("0.3, -0.1, 0.4", 0.25, glass) + end}}},
        {"unseen", {{end, ball("0, 0.4, 2", 0.4, diffuse) + end}}},
        {"over_the_camera", {{end, ball("0, 0, 4.4", 0.5, glass) + end}}},
        {"through_a_wall", {{end, ball("0.95, 0.2, 0", 0.4, diffuse) + end}}},
        {"on_the_floor", {{end, cube(R"(value="0.2")", R"(x="-0.2" y="-0.8" z="0.6")") + end}}},
        {"upon_a_wall",
         {{end,
           R"(<shape type="rectangle"><transform name="to_world"><translate z="-1"/></transform><ref id="green"/></shape>)" +
               end}}},
        {"two_movers", {{end, ball("-0.4, 0.5, 0.2", 0.2, diffuse) + ball("0.5, 0.3, 0.3", 0.2, metal) + end}}},
        {"lamp", {{lamp, lamp_moved}}},
        {"glow", {{end, ball("0.3, 0.2, 0.4", 0.15, glow) + end}}},
        {"sky", {{"name=\"radiance\" value=\"0.2\"", "name=\"radiance\" value=\"0.5, 0.7, 0.9\""}}},
        {"lamp_and_ball", {{lamp, lamp_moved}, {end, ball("0.3, -0.1, 0.4", 0.25, diffuse) + end}}},
    };
    return all;
}

class PartsOfAdditions : public ::testing::TestWithParam<EditCase> {
  protected:
    EditedScenes scenes_ = edited(GetParam());
    EditReach reach_{*scenes_.old_scene, *scenes_.new_scene, scenes_.edit};
    ScenePair pair() const { return {*scenes_.old_scene, *scenes_.new_scene}; }

    Image residual(const PathOptions& path, std::uint64_t spp) const {
        app::Report report;
        report.set_quiet(true);
        Counts counts;
        PartSums parts(pair(), reach_, scenes_.edit);
        return render_residual(pair(), Method::correlated, path, {0, spp, 1}, report, counts, &parts);
    }
};

// [HY] Eq. (1) to (3). Detected mutations, at 8 samples: shadow rays that cross what is added not counted in Minus (9 cases);
// vertices upon a wall taken for the wall's (upon_a_wall).
TEST_P(PartsOfAdditions, AddUpToAFreshImage) {
    const std::uint64_t spp = full_run() ? 256 : 8;
    const PathOptions fresh_path = options_of(*scenes_.new_scene);
    const Replicates fresh = trace_replicates(*scenes_.new_scene, fresh_path, spp, replicates),
                     still =
                         trace_replicates(*scenes_.old_scene, options_of(*scenes_.old_scene), spp, replicates, 5000);
    std::vector<RegionMeans> sums(replicates);
    tbb::parallel_for(0, replicates, [&](int i) {
        PathOptions path = fresh_path;
        path.seed = std::uint64_t(7000 + i);
        const Image image = residual(path, spp);
        const RegionMeans plus = region_means(image, "Plus"), minus = region_means(image, "Minus");
        RegionMeans& sum = sums[std::size_t(i)] = still.regions[std::size_t(i)];
        for (std::size_t c = 0; c < 3; ++c)
            for (std::size_t region = 0; region < sum[c].size(); ++region)
                sum[c][region] += plus[c][region] - minus[c][region];
    });
    const double alpha = sidak_alpha(int(additions().size()) * 3 * (1 + n_tiles * n_tiles));
    for (int c = 0; c < 3; ++c)
        for (int region = 0; region < 1 + n_tiles * n_tiles; ++region) {
            std::vector<double> values;
            for (const RegionMeans& sum : sums) values.push_back(sum[std::size_t(c)][std::size_t(region)]);
            const Estimate ours = estimate_of(values), theirs = fresh.estimate(c, region);
            EXPECT_GT(welch_p_value(ours, theirs), alpha)
                << fmt::format("{} channel {} region {}: {:.5g} +- {:.2g}, fresh {:.5g} +- {:.2g}", GetParam().name, c,
                               region, ours.mean, ours.se, theirs.mean, theirs.se);
        }
}

// Path by path: 13 x 32 x 32 x 2 paths a sample; 10^6 in the full run. Detected
// mutations: shadow rays across what is added not counted in Minus (9 cases); such a crossing makes a path touched (10);
// roulette of the old paths by their throughput (11).
TEST_P(PartsOfAdditions, AreThoseOfBruteForce) {
    if (!reach_.everything.empty()) return;        // other light samples at all vertices
    if (GetParam().name == "upon_a_wall") return;  // whether a ray that ends there crosses it is not defined
    const std::uint64_t spp = full_run() ? 48 : 4;
    PathOptions path = options_of(*scenes_.new_scene);
    path.seed = 3;
    const Image ours = residual(path, spp);
    path.seed = seeds_of(Method::correlated, path.seed).new_scene;
    for (const bool is_old : {false, true}) {
        const auto side =
            loom::testing::edited_side(*scenes_.old_scene, *scenes_.new_scene, scenes_.edit, reach_, is_old);
        std::vector<std::uint8_t> differ(ours.n_pixels());
        tbb::parallel_for(std::uint64_t(0), ours.n_pixels(), [&](std::uint64_t pixel) {
            double sum[3]{};
            for (std::uint64_t sample = 0; sample < spp; ++sample) {
                const Spectrum part = loom::testing::touched_part(*side, path, {pixel, sample});
                for (int c = 0; c < 3; ++c) sum[c] += double(part[c]);
            }
            for (int c = 0; c < 3; ++c)
                differ[pixel] |=
                    ours.find(std::string(is_old ? "Minus." : "Plus.") + rgb[c])[pixel] != float(sum[c] / double(spp));
        });
        EXPECT_EQ(std::count(differ.begin(), differ.end(), 1), 0) << (is_old ? "Minus" : "Plus");
    }
}

INSTANTIATE_TEST_SUITE_P(Additions, PartsOfAdditions, ::testing::ValuesIn(additions()),
                         [](const auto& info) { return info.param.name; });

}  // namespace
}  // namespace loom::residual
