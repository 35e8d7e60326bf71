// Edits that are hard on residuals: METHODS, stress scenes of [RP]. Dynamic paths and what the pilot chooses have the
// mean of correlated paths; how much noise each has beside them is printed. `make stability` runs them at full length.

#include <fmt/format.h>
#include <gtest/gtest.h>
#include <tbb/parallel_for.h>

#include "stages/core/stats/chi_square.h"
#include "stages/residual/effort/effort.h"
#include "tests/statistical/edit_cases.h"

namespace loom::residual {
namespace {

constexpr int regions = 1 + n_tiles * n_tiles;

std::string place(double x, double y, double z) {
    return fmt::format("<translate x=\"{}\" y=\"{}\" z=\"{}\"/>", x, y, z);
}
const std::string short_place = place(0.36, -0.72, 0.3), short_moved = place(-0.1, -0.72, 0.4),
                  short_size = "<scale x=\"0.28\" y=\"0.28\" z=\"0.28\"/>", end = "</scene>";

std::string size(double s) {
    return fmt::format("<scale x=\"{0}\" y=\"{0}\" z=\"{0}\"/>", s);
}
std::string sphere(const char* id, const std::string& centre, double radius, const char* bsdf) {
    return fmt::format(
        R"(<shape type="sphere" id="{}"><point name="center" value="{}"/><float name="radius" value="{}"/>{}</shape>)",
        id, centre, radius, bsdf);
}
constexpr const char* white = R"(<ref id="white"/>)";
constexpr const char* pane = R"(<bsdf type="thindielectric"/>)";

std::string sixty_four(double shift) {
    std::string all;
    for (int i = 0; i < 64; ++i)
        all += sphere(
            fmt::format("s{}", i).c_str(),
            fmt::format("{}, {}, {}", -0.75 + 0.5 * (i % 4) + shift, -0.8 + 0.4 * (i / 4 % 4), -0.7 + 0.45 * (i / 16)),
            0.07, white);
    return all + end;
}
std::string shell(double x) {  // around the box, the camera and all
    return R"(<shape type="cube" id="shell"><boolean name="flip_normals" value="true"/><transform name="to_world"><scale value="6"/>)" +
           place(x, 0, 0) + R"(</transform><ref id="white"/></shape></scene>)";
}

const std::vector<EditCase>& edits() {
    const std::string bulb =
        R"(<emitter type="point"><point name="position" x="0.5" y="0.5" z="0.5"/><rgb name="intensity" value="2"/></emitter>)";
    const std::string mirror = R"(</transform><bsdf type="conductor"><string name="material" value="Ag"/></bsdf>)";
    const std::string end_of_tall = place(-0.33, -0.42, -0.35) + "\n        </transform>\n        <ref id=\"white\"/>";
    const std::string ball_low = sphere("ball", "0.2, -0.6, 0.7", 0.012, white),
                      ball_moved = sphere("ball", "0.2, -0.4, 0.7", 0.012, white);
    const std::string shade = sphere("shade", "0, 0.75, 0", 0.6, pane),
                      shade_moved = sphere("shade", "0.06, 0.75, 0", 0.6, pane);
    static const std::vector<EditCase> all = {
        {"fills_the_view", {{place(0, 0, 3), place(0.1, 0, 3)}}, {{short_place, place(0, 0, 3)}}},
        {"unseen_but_shadowing",
         {{place(0, 0.82, 0.3), place(0.2, 0.82, 0.3)}},
         {{"value=\"34\"", "value=\"18\""}, {short_size, size(0.12)}, {short_place, place(0, 0.82, 0.3)}}},
        {"ghost_inside_a_box",
         {{place(-0.33, -0.42, -0.35), short_place}},
         {{short_size, size(0.12)}, {short_place, place(-0.33, -0.42, -0.35)}}},
        {"coplanar",
         {{place(0.72, -0.72, 0.3), place(0.72, -0.72, 0.2)}},
         {{"angle=\"-16\"", "angle=\"0\""}, {short_place, place(0.72, -0.72, 0.3)}}},
        {"sixty_four_movers", {{sixty_four(0), sixty_four(0.05)}}, {{end, sixty_four(0)}}},
        {"tiny", {{ball_low, ball_moved}}, {{end, ball_low + end}}},
        {"around_the_camera", {{shell(0), shell(2.5)}}, {{end, shell(0)}}},
        {"around_the_light", {{shade, shade_moved}}, {{end, shade + end}}},
        {"beside_a_mirror", {{short_place, short_moved}}, {{end_of_tall, place(-0.33, -0.42, -0.35) + mirror}}},
        {"by_a_point_light", {{short_place, place(0.5, -0.2, 0.5)}}, {{"14, 11.5, 8", "0.2"}, {end, bulb + end}}},
        {"light_removed_and_box_moved", {{bulb, ""}, {short_place, short_moved}}, {{end, bulb + end}}},
        {"many_bounces",
         {{short_place, short_moved}},
         {{"0.72, 0.70, 0.66", "0.95"}, {"name=\"max_depth\" value=\"17\"", "name=\"max_depth\" value=\"200\""}}},
    };
    return all;
}

struct Residuals {
    std::vector<RegionMeans> means;  // by replicate
    double var_mean = 0;             // mean over channels, pixels and replicates, of the spread between replicates
    double spread_of(int c, int region, Estimate& mean) const {
        std::vector<double> values;
        for (const RegionMeans& m : means) values.push_back(m[std::size_t(c)][std::size_t(region)]);
        mean = estimate_of(values);
        return mean.se;
    }
};

template <class Render>
Residuals replicated(int replicates, const Render& render) {
    std::vector<Image> images(static_cast<std::size_t>(replicates));
    tbb::parallel_for(0, replicates, [&](int i) { images[std::size_t(i)] = render(std::uint64_t(i)); });
    Residuals out;
    for (const Image& image : images) {
        out.means.push_back(region_means(image));
        out.var_mean += mean_var_mean(image) / replicates;
    }
    return out;
}

constexpr double rounding = 1e-6;  // of radiances of about 1 that are subtracted

/// Describes the regions whose means differ.
std::vector<std::string> differing(const Residuals& ours, const Residuals& theirs, double alpha, double scale = 1) {
    std::vector<std::string> out;
    for (int c = 0; c < 3; ++c)
        for (int region = 0; region < regions; ++region) {
            Estimate mean, expected;
            ours.spread_of(c, region, mean);
            theirs.spread_of(c, region, expected);
            mean.mean *= scale;
            mean.se *= scale;
            if (const double p = welch_p_value(mean, expected);
                p < alpha && std::abs(mean.mean - expected.mean) > rounding)
                out.push_back(
                    fmt::format("\n  channel {} region {}: {:.5g} +- {:.2g}, correlated {:.5g} +- {:.2g}, p = {:.1g}",
                                c, region, mean.mean, mean.se, expected.mean, expected.se, p));
        }
    return out;
}

/// In short runs those of which each is hard in its own way.
std::vector<EditCase> asked() {
    std::vector<EditCase> some;
    for (const EditCase& edit : edits())
        if (full_run() || edit.name == "ghost_inside_a_box" || edit.name == "coplanar" ||
            edit.name == "around_the_light" || edit.name == "many_bounces")
            some.push_back(edit);
    return some;
}

Residuals correlated_of(const EditedScenes& scenes, int replicates, std::uint64_t spp) {
    return replicated(replicates, [&](std::uint64_t i) {
        app::Report report;
        report.set_quiet(true);
        PathOptions path = options_of(*scenes.new_scene);
        path.seed = 1000 + i;
        Counts counts;
        return render_residual({*scenes.old_scene, *scenes.new_scene}, Method::correlated, path, {0, spp, 1}, report,
                               counts);
    });
}

class EditStress : public testing::TestWithParam<EditCase> {};

// Detected mutation: the density of ghost two ends doubled (ghost_inside_a_box).
TEST_P(EditStress, HasTheMeanOfCorrelatedPaths) {
    const EditedScenes scenes = edited(GetParam());
    const int replicates = full_run() ? 32 : 20;
    const std::uint64_t spp = full_run() ? 64 : least_spp, dynamic_spp = full_run() ? 32 : 4;
    const Residuals correlated = correlated_of(scenes, replicates, spp);
    DynamicOptions options;
    options.pairs.limits.d_min = 0.01f * scenes.new_scene->radius;
    const double alpha = sidak_alpha(int(edits().size()) * 3 * 3 * regions);
    bool swapped_sign_seen = false;
    const auto check = [&](const char* what, std::uint64_t at_spp) {
        const Residuals ours =
            replicated(replicates, [&](std::uint64_t i) { return scenes.dynamic(options, 7000 + i, at_spp); });
        const auto failures = differing(ours, correlated, alpha);
        EXPECT_TRUE(failures.empty()) << what << fmt::format("{}", fmt::join(failures, ""));
        swapped_sign_seen |= !differing(ours, correlated, alpha, -1).empty();
        fmt::print("{} {}: variance of correlated paths over its own, at equal --spp: {:.3g}\n", GetParam().name, what,
                   correlated.var_mean * double(spp) / (ours.var_mean * double(at_spp)));
    };
    check("dynamic", dynamic_spp);
    options.pilot = true;
    check("auto", spp);
    options.must_gain = 0;  // families beside camera paths, whether they pay or not
    if (full_run()) check("auto, mixed", spp);
    EXPECT_TRUE(swapped_sign_seen);
}

INSTANTIATE_TEST_SUITE_P(Stability, EditStress, testing::ValuesIn(asked()),
                         [](const auto& info) { return info.param.name; });

// Limits where methods switch: just below and at the samples that a pilot needs; and shapes that hardly move, whose old
// and new places overlap.
TEST(StabilityEdit, SwitchesOverWithoutASeam) {
    const int replicates = full_run() ? 32 : 20;
    const double alpha = sidak_alpha(6 * 3 * regions);
    const auto compare = [&](const EditCase& edit, bool pilot, std::uint64_t spp) {
        const EditedScenes scenes = edited(edit);
        DynamicOptions options;
        options.pairs.limits.d_min = 0.01f * scenes.new_scene->radius;
        options.pilot = pilot;
        const Residuals ours =
            replicated(replicates, [&](std::uint64_t i) { return scenes.dynamic(options, 7000 + i, spp); });
        const Residuals correlated = correlated_of(scenes, replicates, full_run() ? 64 : 4);
        const auto failures = differing(ours, correlated, alpha);
        EXPECT_TRUE(failures.empty()) << edit.name << " " << spp << fmt::format("{}", fmt::join(failures, ""));
        Estimate mean;
        ours.spread_of(1, 0, mean);
        fmt::print("{}, {} at --spp {}: image mean {:.3g} +- {:.1g}\n", edit.name, pilot ? "auto" : "dynamic", spp,
                   mean.mean, mean.se);
    };
    const EditCase moved{"moved", {{short_place, short_moved}}};
    compare(moved, true, least_spp - 1);
    compare(moved, true, least_spp);
    for (const double shift : {1e-6, 1e-4}) {
        const EditCase hardly{fmt::format("moved_by_{}", shift), {{short_place, place(0.36 + shift, -0.72, 0.3)}}};
        compare(hardly, false, full_run() ? 64 : 2);
        compare(hardly, true, full_run() ? 64 : least_spp);
    }
}

}  // namespace
}  // namespace loom::residual
