// Light samples that two skies have in common: a direct density, the same difference with and without a graph, and the choice
// between them and densities of their own.

#include "stages/residual/sky_pair.h"

#include <fmt/format.h>
#include <gtest/gtest.h>

#include <cmath>
#include <fstream>

#include "stages/core/sampling/sampler.h"
#include "stages/residual/estimators.h"
#include "stages/residual/stored/old_graph.h"
#include "tests/traced_graph.h"

namespace loom::residual {
namespace {

/// A floor, a glossy, a diffuse and a glass ball under a sky.
std::string scene_text(const std::string& sky) {
    return R"(<scene version="3.0.0"><integrator type="path"><integer name="max_depth" value="4"/></integrator>
<sensor type="perspective"><float name="fov" value="45"/><transform name="to_world"><lookat origin="0, 1.6, 6" target="0, 0.6, 0" up="0, 1, 0"/></transform>
<film type="hdrfilm"><integer name="width" value="24"/><integer name="height" value="18"/><rfilter type="box"/></film></sensor>
<shape type="rectangle"><transform name="to_world"><scale value="3"/><rotate x="1" angle="-90"/></transform><bsdf type="twosided"><bsdf type="diffuse"/></bsdf></shape>
<shape type="sphere"><point name="center" x="-0.8" y="0.7" z="0"/><float name="radius" value="0.7"/><bsdf type="roughconductor"><float name="alpha" value="0.2"/></bsdf></shape>
<shape type="sphere" id="ball"><point name="center" x="0.6" y="0.5" z="0.4"/><float name="radius" value="0.5"/><bsdf type="diffuse"/></shape>
<shape type="sphere"><point name="center" x="-0.2" y="0.3" z="1.6"/><float name="radius" value="0.3"/><bsdf type="dielectric"/></shape>
)" + sky + "</scene>";
}
std::string sun(double turbidity, double east, const std::string& more = "") {
    return fmt::format(
        "<emitter type=\"sunsky\"><float name=\"turbidity\" "
        "value=\"{}\"/><vector name=\"sun_direction\" x=\"{}\" y=\"0.7\" z=\"0.5\"/>{}</emitter>",
        turbidity, east, more);
}
std::string map(double angle) {
    return fmt::format(
        "<emitter type=\"envmap\"><string name=\"filename\" value=\"{}/scenes/textures/sky.png\"/><transform "
        "name=\"to_world\"><rotate y=\"1\" angle=\"{}\"/></transform></emitter>",
        LOOM_SOURCE_DIR, angle);
}
const std::string even = "<emitter type=\"constant\"><rgb name=\"radiance\" value=\"0.4, 0.5, 0.7\"/></emitter>";

struct Skies {
    std::shared_ptr<const Scene> old_scene, new_scene;
    Edit edit;

    Skies(const std::string& before, const std::string& after) {
        SceneDescription a = described(scene_text(before)), b = described(scene_text(after));
        edit = find_edit(a, b);
        old_scene = build_scene(std::move(a)), new_scene = build_scene(std::move(b));
        for (const auto& file : files_) std::filesystem::remove(file);
    }

  private:
    SceneDescription described(const std::string& text) {
        files_.push_back(testing::scratch_file(".xml"));
        std::ofstream(files_.back()) << text;
        return read_scene(files_.back().string(), {});
    }
    std::vector<std::filesystem::path> files_;
};

app::Report& quiet() {
    static app::Report report;
    report.set_quiet(true);
    return report;
}

// The density integrates to 1 over the sphere and is what samples have: the mean of g / pdf over samples is the integral of g.
TEST(SkyPair, ProposalsHaveTheDensityOfTheirSamples) {
    for (const auto& [before, after] :
         {std::pair{sun(2, 0.3), sun(6, 0.3)}, {even, map(30)}, {map(10), even}, {sun(5, 0.3), sun(4, 0.3)}}) {
        const Skies skies(before, after);
        const SkyPair pair = find_sky_pair(*skies.old_scene, *skies.new_scene);
        ASSERT_TRUE(pair.shared) << before << after;
        const auto scene = with_proposals(*skies.new_scene, pair.shared);
        constexpr int n = 400;
        double integral = 0, of_g = 0;
        const auto g = [](const Vector3f& d) { return sqr(1 + d.x + 0.5f * d.y * d.z); };
        for (int i = 0; i < n; ++i)
            for (int j = 0; j < 2 * n; ++j) {
                const double z = 2 * (i + 0.5) / n - 1, r = std::sqrt(1 - z * z), phi = pi_double * (j + 0.5) / n;
                const Vector3f d{float(r * std::cos(phi)), float(r * std::sin(phi)), float(z)};
                const double area = 4 * pi_double / (2.0 * n * n);
                integral += double(pdf_environment_w(*scene, d)) * area;
                of_g += double(g(d)) * area;
            }
        EXPECT_NEAR(integral, 1, 0.03);  // the sun is as small as the grid
        double mean = 0;
        std::uint64_t n_beside = 0;  // in the next cell, by rounding
        constexpr std::uint64_t n_samples = 1 << 17;
        for (std::uint64_t i = 0; i < n_samples; ++i) {
            LightQuery query;
            query.u = Sampler(SamplerKind::sobol, 1, 0, i).pair(0);
            look_up_light(*scene, query);
            const Vector3f d(query.point.y);
            n_beside += std::abs(pdf_environment_w(*scene, d) - query.point.pdf_w) > 0.001f * query.point.pdf_w;
            const Spectrum there = environment(*scene, d);
            for (int c = 0; c < 3; ++c) ASSERT_NEAR(query.point.Li[c], there[c], 1e-3 * (1 + double(there[c])));
            mean += double(g(d)) / double(query.point.pdf_w) / n_samples;
        }
        EXPECT_LT(n_beside, n_samples / 200);
        EXPECT_NEAR(mean, of_g, 0.01 * of_g);
    }
}

// A sky that is turned has pairs at the same texel, and so has a sun that moves; one of another look has directions in common.
TEST(SkyPair, IsChosenByTheSkiesAlone) {
    const auto pair_of = [](const std::string& before, const std::string& after) {
        const Skies skies(before, after);
        return find_sky_pair(*skies.old_scene, *skies.new_scene);
    };
    const SkyPair turned = pair_of(map(0), map(5)), far = pair_of(map(0), map(120)),
                  clears = pair_of(sun(4, 0.3), sun(3, 0.3)), moved = pair_of(sun(3, 0.3), sun(3, -0.1)),
                  same = pair_of(even, even);
    EXPECT_FALSE(moved.shared);
    EXPECT_GT(moved.shared_variance, moved.own_variance);
    EXPECT_FALSE(turned.shared);
    EXPECT_FALSE(far.shared);
    EXPECT_LT(turned.own_variance, 0.1 * far.own_variance);
    EXPECT_TRUE(clears.shared);
    EXPECT_LT(clears.shared_variance, 0.5 * clears.own_variance);
    EXPECT_FALSE(same.shared);
    EXPECT_TRUE(same.describe().empty());
    fmt::print("    clears: {}\n", clears.describe());
}

// With common directions, too, the difference of the graph's paths is that of newly traced ones, to the last bit. (Where
// something moves as well, paths keep the old density from their first change on: see CoverageOfEdits.) Detected mutations:
// what is stored of the old sky added; the old sky with the old density, or left out, where a ray escapes.
TEST(SkyPair, DifferenceOfAGraphIsTheFullOneBitForBit) {
    for (const auto& [before, after] :
         {std::pair{sun(2, 0.3), sun(6, 0.3)}, {even, map(30)}, {sun(5, 0.3), sun(4, 0.3)}}) {
        SCOPED_TRACE(after);
        const Skies skies(before, after);
        const SkyPair pair = find_sky_pair(*skies.old_scene, *skies.new_scene);
        ASSERT_TRUE(pair.shared);
        const auto old_scene = with_proposals(*skies.old_scene, pair.shared),
                   new_scene = with_proposals(*skies.new_scene, pair.shared);
        const EditReach reach(*skies.old_scene, *new_scene, skies.edit);
        EXPECT_TRUE(reach.everything.empty());
        for (const SamplerKind sampler : {SamplerKind::sobol, SamplerKind::independent}) {
            PathOptions path = testing::path_options(*skies.old_scene, 5, sampler);
            Counts counts;
            const Image full =
                render_residual({*old_scene, *new_scene}, Method::correlated, path, {0, 4, 1}, quiet(), counts);
            path.seed = seeds_of(Method::correlated, path.seed).old_scene;
            for (const bool misses : {false, true}) {
                OldGraph graph;
                graph.passes.push_back(testing::trace_graph(*skies.old_scene, path, 4, 0, {.misses = misses}));
                graph.files = {"a.h5"};
                graph.path = path;
                graph.spp = 4;
                const GraphResidual ours =
                    render_residual({*skies.old_scene, *new_scene}, reach, graph, 1, nullptr, quiet());
                for (const char* channel : {"R", "G", "B", "VarMean.R", "VarMean.G"}) {
                    const auto x = full.find(channel), y = ours.image.find(channel);
                    for (std::size_t i = 0; i < x.size(); ++i) ASSERT_EQ(x[i], y[i]) << channel << " " << i;
                }
            }
        }
    }
}

}  // namespace
}  // namespace loom::residual
