// Light on two sides of a surface: clusters must not carry it through panes, housings, curtains. METHODS, stress
// scenes. `make stability` runs them at full length.
#include <fmt/format.h>
#include <gtest/gtest.h>

#include <cmath>

#include "stages/core/stats/chi_square.h"
#include "stages/core/stats/student.h"
#include "tests/statistical/path_graph_passes.h"

namespace loom {
namespace {

constexpr std::uint32_t size = 32, tile = 8, n_tiles = size / tile * (size / tile);

const std::string grey =
    R"(<bsdf type="twosided"><bsdf type="diffuse"><rgb name="reflectance" value="0.5"/></bsdf></bsdf>)";

std::string camera(const char* origin, const char* target, double fov) {
    return fmt::format(
        R"(type="perspective"><float name="fov" value="{}"/><transform name="to_world"><lookat origin="{}" target="{}" up="0, 1, 0"/></transform>)",
        fov, origin, target);
}
std::string box(double x, double y, double z, double half_x, double half_y, double half_z, const std::string& bsdf) {
    return fmt::format(
        R"(<shape type="cube"><transform name="to_world"><scale x="{3}" y="{4}" z="{5}"/><translate x="{0}" y="{1}" z="{2}"/></transform>{6}</shape>)",
        x, y, z, half_x, half_y, half_z, bsdf);
}
/// A rectangle of half side `half`; turn: rotations and translations of it, which faces +z.
std::string rectangle(double half, const std::string& turn, const std::string& bsdf) {
    return fmt::format(
        R"(<shape type="rectangle"><transform name="to_world"><scale value="{}"/>{}</transform>{}</shape>)", half, turn,
        bsdf);
}
std::string emitter(double Le) {
    return fmt::format(
        R"(<bsdf type="diffuse"><rgb name="reflectance" value="0"/></bsdf><emitter type="area"><rgb name="radiance" value="{}"/></emitter>)",
        Le);
}

/// A pane of rough glass, thinner than a cluster, before a wall that emits.
std::unique_ptr<Scene> thin_pane(double alpha) {
    const std::string glass = fmt::format(
        R"(<bsdf type="roughdielectric"><float name="alpha" value="{}"/><float name="int_ior" value="1.7"/></bsdf>)",
        alpha);
    return testing::load_inline(
        {camera("0, 0, 5", "0, 0, 0", 30),
         box(0, 0, 0, 2, 2, 0.02, glass) + rectangle(3, R"(<translate z="-1"/>)", R"(<bsdf type="diffuse">
<rgb name="reflectance" value="0.6"/></bsdf><emitter type="area"><rgb name="radiance" value="1"/></emitter>)"),
         size, size, 8});
}

/// A housing of thin walls, open below, around an emitter that faces down: its outside sees a dim sky and the light of
/// the floor.
std::unique_ptr<Scene> thin_housing(double half, int n) {
    const double wall = half / 30;
    std::string walls = box(0, half, 0, half, wall, half, grey);
    for (const double side : {-1.0, 1.0})
        walls += box(side * half, 0, 0, wall, half, half, grey) + box(0, 0, side * half, half, half, wall, grey);
    return testing::load_inline(
        {camera("0, 0.25, 3", "0, 0, 0", 40),
         walls +
             rectangle(half / 3, fmt::format(R"(<rotate x="1" angle="90"/><translate y="{}"/>)", 0.6 * half),
                       emitter(2 / (half * half))) +
             rectangle(3, R"(<rotate x="1" angle="-90"/><translate y="-1"/>)", grey) +
             rectangle(3, R"(<translate z="-1.5"/>)", grey) +
             R"(<emitter type="constant"><rgb name="radiance" value="0.05"/></emitter>)",
         n, n, 12});
}

/// A net curtain in steep folds, narrower than a cluster, lit from behind ten times as brightly as from before.
std::unique_ptr<Scene> curtain() {
    std::string folds;
    constexpr int n = 128;
    constexpr double width = 3.2, step = width / n, slope = 80;
    for (int i = 0; i < n; ++i)
        folds += fmt::format(
            R"(<shape type="rectangle"><transform name="to_world"><scale x="{}" y="1.6"/><rotate y="1" angle="{}"/><translate x="{}"/></transform>{}</shape>)",
            0.5 * step / std::cos(slope * pi_double / 180), i % 2 ? slope : -slope, -0.5 * width + (i + 0.5) * step,
            R"(<bsdf type="mask"><float name="opacity" value="0.7"/>)" + grey + "</bsdf>");
    return testing::load_inline({camera("0, 0, 4", "0, 0, 0", 40),
                                 folds + rectangle(1.5, R"(<translate z="-1.5"/>)", emitter(10)) +
                                     rectangle(1.5, R"(<rotate y="1" angle="180"/><translate z="4.5"/>)", emitter(1)),
                                 size, size, 4});
}

/// A house of thin rough panes, which trap light, around a box; it is lit from above and from one side.
std::unique_ptr<Scene> glass_house() {
    const std::string glass =
        R"(<bsdf type="roughdielectric"><string name="distribution" value="ggx"/><float name="alpha" value="0.1"/><float name="int_ior" value="1.5"/></bsdf>)";
    std::string panes = box(0, 1.52, 0, 1.05, 0.005, 1.05, glass);
    for (const double side : {-1.0, 1.0})
        panes += box(side, 0.75, 0, 0.005, 0.75, 1, glass) + box(0, 0.75, side, 1, 0.75, 0.005, glass);
    return testing::load_inline(
        {camera("0, 1, 3.2", "0, 0.7, 0", 50),
         panes + box(0, -0.05, 0, 4, 0.05, 4, grey) + box(0, 0.3, 0, 0.3, 0.3, 0.3, grey) +
             rectangle(1, R"(<rotate y="1" angle="-90"/><translate x="5" y="2"/>)", emitter(4)) +
             R"(<emitter type="constant"><rgb name="radiance" value="0.1"/></emitter>)",
         2 * size, 2 * size, -1});
}

std::array<double, n_tiles> tile_means(const Image& image, const char* channel = "G") {
    std::array<double, n_tiles> means;
    for (std::uint32_t i = 0; i < n_tiles; ++i) {
        const std::uint32_t x = i % (size / tile) * tile, y = i / (size / tile) * tile;
        means[i] = mean_of(image, channel, {x, y, x + tile, y + tile});
    }
    return means;
}

struct Result {
    // relative error of the tile that is off by most beyond three standard errors of one image; 0: none is
    double worst = 0;
    double noise = 0;  // median over tiles: standard error of one image
    double power = 0;  // median over tiles: relative error that the mean of the images would show with probability 0.99
};

/// Tiles of images of 16 samples in four passes, blended as make image does, against path tracing.
Result tiles_of(const Scene& scene, bool visibility) {
    app::Report report;
    report.set_quiet(true);
    trace::Counts counts;
    const Image reference = trace::render_image(scene, testing::path_options(scene, 77, SamplerKind::independent),
                                                {0, full_run() ? 16384u : 4096u, 0}, report, counts);
    const auto r = tile_means(reference), var = tile_means(reference, "VarMean.G");
    Recipe recipe;
    recipe.k = 32, recipe.spp = 4, recipe.visibility = visibility;
    std::array<std::vector<double>, n_tiles> values;
    recipe.gather.estimates = true;
    for (int i = 0; i < (full_run() ? 64 : 16); ++i) {
        std::vector<Image> parts;
        for (int pass = 0; pass < 4; ++pass)
            parts.push_back(make_pass(scene, 300 + 4 * std::uint64_t(i) + pass, recipe).image);
        const auto means = tile_means(merge::blend_images(parts.size(), [&](std::size_t part) { return parts[part]; }));
        for (std::uint32_t t = 0; t < n_tiles; ++t) values[t].push_back(means[t]);
    }
    Result result;
    std::vector<double> noises, powers;
    for (std::uint32_t t = 0; t < n_tiles; ++t) {
        const Estimate e = estimate_of(values[t]);
        const double se = std::hypot(e.se, std::sqrt(var[t] / (tile * tile))) / r[t],
                     of_one = e.se * std::sqrt(double(values[t].size())) / r[t];
        const double error = (e.mean - r[t]) / r[t];
        noises.push_back(of_one);
        powers.push_back(std::max(0.02, 3 * of_one) + 2.33 * se);
        if (std::abs(error) > std::max(0.02, 3 * of_one) && std::abs(error) > std::abs(result.worst))
            result.worst = error;
    }
    std::sort(noises.begin(), noises.end());
    std::sort(powers.begin(), powers.end());
    result.noise = noises[n_tiles / 2], result.power = powers[n_tiles / 2];
    return result;
}

void expect_right(const std::string& name, const Scene& scene) {
    const Result with = tiles_of(scene, true);
    std::printf("    %s: noise of one image %.1f %%, found for sure %.1f %%, worst tile beyond noise %+.1f %%\n",
                name.c_str(), 100 * with.noise, 100 * with.power, 100 * with.worst);
    EXPECT_EQ(with.worst, 0) << name;
}

// Criterion: the mean error of no tile of 8 x 8 pixels is above 2 % and above three standard errors of one image of 16
// samples.

// Detected mutation: neither media nor hidden members separated (-6.3 % at alpha 0.05); either of the two is enough
// here.
TEST(StabilitySides, ThinPane) {
    for (const double alpha : full_run() ? std::vector{0.05, 0.1, 0.3, 0.5} : std::vector{0.05, 0.3})
        expect_right(fmt::format("pane, alpha {}", alpha), *thin_pane(alpha));
}

/// Mean of the middle of the housing's front over images of 16 samples, and its reference.
struct Front {
    double mean, se, reference;
};
Front front_of(double half, bool visibility) {
    const std::uint32_t n = 96;
    const auto scene = thin_housing(half, n);
    app::Report report;
    report.set_quiet(true);
    trace::Counts counts;
    const auto pixels = std::uint32_t(std::max(1.0, half / (2 * 3 * std::tan(20 * pi_double / 180) / n) / 2));
    const Window window{n / 2 - pixels, n / 2 - pixels, n / 2 + pixels, n / 2 + pixels};
    Recipe recipe;
    recipe.k = 32, recipe.spp = 4, recipe.visibility = visibility, recipe.gather.estimates = true;
    std::vector<double> values;
    for (int i = 0; i < (full_run() ? 16 : 4); ++i) {
        std::vector<Image> parts;
        for (int pass = 0; pass < 4; ++pass)
            parts.push_back(make_pass(*scene, 300 + 4 * std::uint64_t(i) + pass, recipe).image);
        values.push_back(
            mean_of(merge::blend_images(parts.size(), [&](std::size_t part) { return parts[part]; }), "G", window));
    }
    const Estimate e = estimate_of(values);
    return {e.mean, e.se,
            mean_of(trace::render_image(*scene, testing::path_options(*scene, 77, SamplerKind::independent),
                                        {0, full_run() ? 4096u : 1024u, 0}, report, counts),
                    "G", window)};
}

// The glow of the outside is in a few pixels, so only these are tested. Detected mutation: hidden members not separated
// (0.034 +- 0.004 instead of 0.0226; four standard errors would accept it).
TEST(StabilitySides, ThinHousing) {
    for (const double half : full_run() ? std::vector{0.03, 0.06, 0.12} : std::vector{0.06}) {
        const Front with = front_of(half, true);
        std::printf("    housing of half side %.2f: front %.4f +- %.4f, reference %.4f\n", half, with.mean, with.se,
                    with.reference);
        EXPECT_NEAR(with.mean, with.reference, 0.15 * with.reference) << half;
    }
    const Front without = front_of(0.06, false);
    std::printf("    without the test of visibility: front %.4f +- %.4f, reference %.4f\n", without.mean, without.se,
                without.reference);
    EXPECT_GT(without.mean, 1.25 * without.reference);
}

// The light through the net is noisy, so the number of separated members is tested too. Detected mutation: hidden
// members not separated (none, where a tenth must be).
TEST(StabilitySides, Curtain) {
    const auto scene = curtain();
    expect_right("curtain", *scene);
    const PathGraph graph = testing::trace_graph(*scene, testing::path_options(*scene, 1), 4);
    EXPECT_GT(testing::clusters_of(graph, 32, 0, 0.03f, scene.get()).separation.occluded[0], graph.n_vertices() / 10);
}

// Trapped light returns many times, a path to a cluster that it has visited. Detected mutation: members of one path not
// separated (-2.6 +- 0.1 %; separated, -0.5 +- 0.1 % remain).
TEST(StabilitySides, GlassHouse) {
    const auto scene = glass_house();
    Recipe recipe;
    recipe.k = 32, recipe.spp = 4;
    std::vector<double> values;
    double mean = 0;
    const int passes = full_run() ? 64 : 16;
    for (int i = 0; i < passes; ++i) {
        const Pass pass = make_pass(*scene, 900 + std::uint64_t(i), recipe);
        values.push_back(mean_of(pass.image) - mean_of(pass.paths));
        mean += mean_of(pass.paths) / passes;
    }
    const Estimate e = estimate_of(values);
    std::printf("    house of panes: clusters above paths by %+.2f +- %.2f %%\n", 100 * e.mean / mean,
                100 * e.se / mean);
    EXPECT_NEAR(e.mean / mean, 0, 0.005 + 3 * e.se / mean);
}

}  // namespace
}  // namespace loom
