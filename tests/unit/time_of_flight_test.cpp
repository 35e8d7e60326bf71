// When light arrives: worked out by hand, and what must not move it. METHODS 4.4 lists the hazards.
#include "stages/core/graph/time_of_flight.h"

#include <fmt/format.h>
#include <gtest/gtest.h>

#include <cmath>
#include <random>

#include "stages/core/clusters/shared_arrivals.h"
#include "stages/gather/gather.h"
#include "stages/transient/transient.h"
#include "tests/traced_graph.h"

namespace loom {
namespace {

/// A cube in memory.
struct Cube {
    std::uint32_t n_bins = 0;
    std::vector<float> radiance, var_mean, before, after, never, steady;

    double bin(std::size_t pixel, std::uint32_t k, int c = 1) const { return radiance[(pixel * n_bins + k) * 3 + c]; }
    /// Returns the sum over all pixels.
    std::vector<double> histogram(int c = 1) const {
        std::vector<double> sum(n_bins, 0.0);
        for (std::size_t i = 0; i < radiance.size() / 3; ++i) sum[i % n_bins] += radiance[3 * i + c];
        return sum;
    }
    /// The only bin that has light; n_bins when there are none or several.
    std::uint32_t only_bin() const {
        std::uint32_t found = n_bins;
        const auto h = histogram();
        for (std::uint32_t k = 0; k < n_bins; ++k)
            if (h[k] > 0) {
                if (found < n_bins) return n_bins;
                found = k;
            }
        return found;
    }
};

struct BinOptions {
    Timing timing{};
    std::uint64_t max_bytes = 1 << 30;
    int threads = 0;
    const Clusters* clusters = nullptr;
};

Cube cube_of(const PathGraph& graph, const TimeResponse& response, const BinOptions& options = {}) {
    app::Report report;
    report.set_quiet(true);
    app::Progress progress(report, "binning", graph.n_pixels());
    Cube cube;
    cube.n_bins = response.n_bins;
    std::vector<SharedArrivals> shared;
    if (options.clusters) shared.emplace_back(graph, *options.clusters, options.timing, options.threads);
    transient::bin_graphs({&graph, 1}, shared, {}, response, options.timing, options.max_bytes, options.threads,
                          progress, [&](std::uint32_t, const TransientRows& rows) {
                              const auto join = [](std::vector<float>& to, std::span<const float> from) {
                                  to.insert(to.end(), from.begin(), from.end());
                              };
                              join(cube.radiance, rows.radiance);
                              join(cube.var_mean, rows.var_mean);
                              join(cube.before, rows.before);
                              join(cube.after, rows.after);
                              join(cube.never, rows.never);
                              join(cube.steady, rows.steady);
                          });
    return cube;
}

TimeResponse bins(std::uint32_t n, double start, double width) {
    return {n, start, width, width, Pulse::delta(), {}, 1};
}

/// A camera that looks along -z from (x, 0, z) with parallel rays over a width of 2 `half`.
std::string looking_down(double z, double half, double near_clip = 0.01) {
    return fmt::format(
        R"(type="orthographic"><float name="near_clip" value="{2}"/><transform name="to_world"><scale x="{1}" y="{1}"/><lookat origin="0, 0, {0}" target="0, 0, -1" up="0, 1, 0"/></transform>)",
        z, half, near_clip);
}

std::string plate(double z, const char* bsdf, double half = 4) {
    return fmt::format(
        R"(<shape type="rectangle"><transform name="to_world"><scale x="{1}" y="{1}"/><translate z="{0}"/></transform>{2}</shape>)",
        z, half, bsdf);
}

constexpr const char* white =
    R"(<bsdf type="twosided"><bsdf type="diffuse"><rgb name="reflectance" value="0.8"/></bsdf></bsdf>)";
constexpr const char* shining =
    R"(<bsdf type="diffuse"><rgb name="reflectance" value="0"/></bsdf><emitter type="area"><rgb name="radiance" value="2"/></emitter>)";

/// Emits downwards.
std::string lamp_above(double z, double half, double x = 0) {
    return fmt::format(
        R"(<shape type="rectangle"><transform name="to_world"><scale x="{1}" y="{1}"/><rotate x="1" angle="180"/><translate x="{2}" z="{0}"/></transform>{3}</shape>)",
        z, half, x, shining);
}

std::string glass_box(double z, double half_height, double int_ior, double ext_ior = 1, double half = 8) {
    return fmt::format(
        R"(<shape type="cube"><transform name="to_world"><scale x="{0}" y="{0}" z="{1}"/><translate z="{2}"/></transform>
<bsdf type="dielectric"><float name="int_ior" value="{3}"/><float name="ext_ior" value="{4}"/></bsdf></shape>)",
        half, half_height, z, int_ior, ext_ior);
}

PathGraph graph_of(const std::string& sensor, const std::string& body, int size = 4, int max_depth = -1,
                   std::uint64_t spp = 16) {
    const auto scene = testing::load_inline({sensor, body, size, size, max_depth});
    return testing::trace_graph(*scene, testing::path_options(*scene, 3), spp);
}

// One bounce: camera 3 m over a plate, an emitter at its side, 4 m over the plate; the pixel is very narrow.
TEST(TimeOfFlight, OneBounceIsInTheBinWorkedOutByHand) {
    const PathGraph graph =
        graph_of(looking_down(3, 1e-4),
                 plate(0, white) + R"(<emitter type="point"><point name="position" x="3" y="0" z="4"/></emitter>)");
    const Cube cube = cube_of(graph, bins(100, -0.05, 0.1));
    EXPECT_EQ(cube.only_bin(), 80u);  // 3 + 5
    const Cube unwarped = cube_of(graph, bins(100, -0.05, 0.1), {{false}});
    EXPECT_EQ(unwarped.only_bin(), 50u);
    // intensity 1, cos = 4 / 5, 25 m^2, albedo 0.8
    EXPECT_NEAR(cube.bin(0, 80), 0.8 / pi_double * 0.8 / 25, 1e-6);
}

/// Camera at the origin, looking down.
constexpr const char* pinhole =
    R"(type="perspective"><float name="fov" value="0.2"/><transform name="to_world"><lookat origin="0,0,0" target="0,0,-1" up="0,1,0"/></transform>)";

std::string glass_ball(double int_ior, double ext_ior = 1) {
    return fmt::format(
        R"(<shape type="sphere"><bsdf type="dielectric"><float name="int_ior" value="{}"/><float name="ext_ior" value="{}"/></bsdf></shape>)",
        int_ior, ext_ior);
}

// Detected mutations: paths that start in vacuum; one stack for all origins of an orthographic sensor.
TEST(TimeOfFlight, ACameraInsideOfGlassCountsItsFirstSegmentByTheGlass) {
    const std::string body = glass_ball(1.5) + plate(-3, shining);
    EXPECT_EQ(cube_of(graph_of(pinhole, body, 4, 2), bins(100, -0.05, 0.1)).only_bin(), 35u);  // 1.5 * 1 + 2
    // An orthographic sensor of which only a part is inside.
    const PathGraph graph = graph_of(looking_down(0, 2), body, 8, 2, 64);
    ASSERT_FALSE(graph.vertices.eta.empty());
    std::size_t inside = 0;
    for (std::size_t path = 0; path + 1 < graph.paths.first_vertex.size(); ++path) {
        const float* o = graph.paths.origin.data() + 3 * path;
        const bool in_ball = o[0] * o[0] + o[1] * o[1] < 1;
        inside += in_ball;
        EXPECT_EQ(graph.vertices.eta[graph.paths.first_vertex[path]], in_ball ? 1.5f : 1.0f) << o[0] << " " << o[1];
    }
    EXPECT_GT(inside, 100u);
}

// Detected mutations: paths that start in vacuum; nested media in the wrong order; vacuum outside of all shapes.
TEST(TimeOfFlight, CameraAndLightUnderWater) {
    // 4 m to the floor and 5 m to the bulb, under an open surface of water.
    const std::string floor = plate(-4, white),
                      bulb = R"(<emitter type="point"><point name="position" x="3" y="0" z="0"/></emitter>)";
    const std::string water =
        R"(<shape type="rectangle"><transform name="to_world"><scale value="50"/><translate z="0.5"/></transform>
<bsdf type="dielectric"><float name="int_ior" value="1.25"/></bsdf></shape>)";
    EXPECT_EQ(cube_of(graph_of(pinhole, floor + bulb + water, 4, 2), bins(200, 0, 0.1)).only_bin(),
              112u);  // 1.25 * (4 + 5)
    // In a ball of glass in a box of water.
    const std::string immersed = glass_ball(1.5, 1.25) + glass_box(0, 6, 1.25) + plate(-4, shining);
    EXPECT_EQ(cube_of(graph_of(pinhole, immersed, 4, 2), bins(200, 0, 0.1)).only_bin(), 52u);  // 1.5 * 1 + 1.25 * 3
    // A scene in water without a surface.
    EXPECT_EQ(
        cube_of(graph_of(looking_down(3, 1e-4), plate(-2, shining) + glass_ball(1.5, 1.25), 4, 3), bins(200, 0, 0.1))
            .only_bin(),
        67u);  // 1.25 * 2 + 1.5 * 2 + 1.25 * 1
}

TEST(TimeOfFlight, DirectlySeenLampArrivesAfterItsDistance) {
    const Cube cube = cube_of(graph_of(looking_down(3, 1), plate(0.25, shining)), bins(100, 0, 0.1));
    EXPECT_EQ(cube.only_bin(), 27u);
    EXPECT_NEAR(cube.bin(5, 27), 2, 1e-6);
}

// Distances start at the camera, not at the near plane. Detected mutation: rays that start there.
TEST(TimeOfFlight, NearPlaneChangesNothing) {
    const auto of = [](double near_clip) {
        return cube_of(graph_of(looking_down(3, 1, near_clip), plate(0, white) + lamp_above(5, 1)), bins(300, 0, 0.05));
    };
    const Cube a = of(1e-3), b = of(1.5);
    EXPECT_EQ(a.radiance, b.radiance);
    EXPECT_GT(a.histogram()[162], 0);
}

// A slab of 0.5 m and index n at normal incidence makes the path (n - 1) 0.5 m longer. The emitter is behind it.
TEST(TimeOfFlight, SlabDelaysByItsIndex) {
    for (const double n : {1.0001, 1.33, 1.5, 2.4}) {
        const PathGraph graph = graph_of(looking_down(3, 1), glass_box(1, 0.25, n) + plate(-1, shining, 4), 4, 3, 64);
        const double opl = 4 + (n - 1) * 0.5;
        const Cube cube = cube_of(graph, bins(2, opl - 1e-4, 2e-4));
        const double through = sqr(4 * n / sqr(n + 1));  // straight through both faces
        EXPECT_NEAR(cube.histogram()[0] + cube.histogram()[1], 16 * 2 * through, 16 * 2 * (n > 2 ? 0.12 : 0.05)) << n;
        EXPECT_EQ(cube.before[1] + cube.after[1], 0) << n;
    }
}

// The group index, not the phase index, determines the time of flight.
TEST(TimeOfFlight, GroupIndexStandsForThePhaseIndex) {
    const PathGraph graph = graph_of(looking_down(3, 1), glass_box(1, 0.25, 1.5) + plate(-1, shining, 4), 4, 3, 64);
    const Cube cube = cube_of(graph, bins(2, 4 + 0.52 * 0.5 - 1e-4, 2e-4), {{true, {{1.5f, 1.52f}}}});
    EXPECT_GT(cube.histogram()[0] + cube.histogram()[1], 16 * 1.7);
    EXPECT_EQ(cube.before[1] + cube.after[1], 0);
}

// An emitter inside glass, glass inside water: absolute indices at any nesting. METHODS 4.4, 7. Detected mutation: the
// relative index of the last interface.
TEST(TimeOfFlight, NestedAndImmersedObjectsHaveAbsoluteIndices) {
    // Water from z = -2 to 2, in it glass from -1 to 1, in that the emitter at 0; camera at 4.
    const PathGraph graph = graph_of(
        looking_down(4, 0.5), glass_box(0, 2, 1.33) + glass_box(0, 1, 1.5, 1.33, 4) + plate(0, shining, 1), 4, 3, 64);
    const double opl = 2 + 1.33 * 1 + 1.5 * 1;
    const Cube cube = cube_of(graph, bins(2, opl - 1e-4, 2e-4));
    // Radiance falls by the square of the index, and by what two faces reflect.
    const double through = (1 - sqr(0.33 / 2.33)) * (1 - sqr(0.17 / 2.83)) / sqr(1.5);
    EXPECT_NEAR(cube.histogram()[0] + cube.histogram()[1], 16 * 2 * through, 16 * 2 * 0.02);
    EXPECT_EQ(cube.before[1] + cube.after[1], 0);
}

// A diffuse plate and an emitter, both under water; light travels to the emitter in water with either technique.
// Detected mutation: index 1 for edges of next-event estimation.
TEST(TimeOfFlight, LightEdgesUnderWaterAreSlowToo) {
    // The emitter is a large ceiling 0.5 m over the plate, at a distance of 0.5 to 0.7 m; the camera looks through a
    // hole.
    const PathGraph graph = graph_of(
        looking_down(2, 0.05),
        glass_box(0, 1, 1.33, 1, 3) + plate(0, white, 1) + lamp_above(0.5, 0.2, -0.35) + lamp_above(0.5, 0.2, 0.35), 4,
        3, 4096);
    std::size_t n[2] = {};
    for (const std::uint8_t technique : graph.light_edges.technique) ++n[technique];
    ASSERT_GT(n[0], 100u);
    ASSERT_GT(n[1], 100u);
    const double near = 1 + 1.33 * (1 + std::hypot(0.5, 0.1)),
                 far = 1 + 1.33 * (1 + std::sqrt(sqr(0.5) + sqr(0.65) + sqr(0.3)));
    const Cube cube = cube_of(graph, bins(1, near, far - near));
    EXPECT_GT(cube.histogram()[0], 0);
    for (const float late : cube.after) EXPECT_EQ(late, 0);
    for (const float early : cube.before) EXPECT_EQ(early, 0);
}

// An emitter inside rough glass: next-event estimation passes through the surface into the glass, as the BSDF sample
// does. METHODS 4.4, 8. Detected mutation: the index of the side of wo, for next-event estimation.
TEST(TimeOfFlight, NextEventEstimationThroughRoughGlassIsSlow) {
    const std::string rough = R"(<shape type="cube"><transform name="to_world"><scale x="4" y="4" z="1"/></transform>
<bsdf type="roughdielectric"><float name="alpha" value="0.4"/><float name="int_ior" value="1.5"/></bsdf></shape>)";
    const PathGraph graph = graph_of(looking_down(2, 0.05), rough + plate(0, shining, 0.5), 4, 2, 1024);
    std::size_t n[2] = {};
    for (const std::uint8_t technique : graph.light_edges.technique) ++n[technique];
    ASSERT_GT(n[0], 100u);
    ASSERT_GT(n[1], 100u);
    const double near = 1 + 1.5 - 1e-4, far = 1 + 1.5 * std::sqrt(1 + 2 * sqr(0.56));
    const Cube cube = cube_of(graph, bins(1, near, far - near));
    EXPECT_GT(cube.histogram()[0], 0);
    for (std::size_t i = 0; i < cube.after.size(); ++i) EXPECT_EQ(cube.after[i] + cube.before[i], 0);
}

// Light from infinity has no time of arrival: it is kept apart, not lost.
TEST(TimeOfFlight, EnvironmentNeverArrives) {
    const Cube cube =
        cube_of(graph_of(looking_down(3, 8), plate(0, white) + R"(<emitter type="constant"/>)", 8), bins(10, 0, 10));
    double never = 0, steady = 0;
    for (std::size_t i = 0; i < cube.never.size(); ++i) never += cube.never[i], steady += cube.steady[i];
    EXPECT_EQ(never, steady);
    EXPECT_GT(never, 0);
    for (const double h : cube.histogram()) EXPECT_EQ(h, 0);
}

// Fifty bounces of one way of sqrt(2) m each: sums are in double precision. METHODS 4.4, 4.
TEST(TimeOfFlight, ManySegmentsAddUpExactly) {
    PathGraph g;
    constexpr int n = 50;
    g.sensor.width = g.sensor.height = 1;
    g.tracing.samples_per_pixel = 1;
    g.sensor.origin = {0, 0, 0};
    std::vector<float> p, wo;
    for (int i = 1; i <= n; ++i) {
        p.insert(p.end(), {float(i % 2), float(i), 0.0f});
        wo.insert(wo.end(), {0, -1, 0});
    }
    g.paths.first_vertex = {0, n};
    g.paths.Le = {1, 1, 1};
    g.vertices.p = p;
    g.vertices.wo = wo;
    const auto all = [&](auto value) { return std::vector<decltype(value)>(n, value); };
    std::vector<std::int16_t> ns;
    for (int i = 0; i < n; ++i) ns.insert(ns.end(), {0, 0});
    g.vertices.ns = ns;
    g.vertices.material = all(std::uint16_t(0));
    g.vertices.shape = all(std::uint32_t(0));
    g.vertices.flags = all(std::uint16_t(vertex_flag::continued));
    g.vertices.lobe = all(std::uint8_t(Lobe::null));
    g.vertices.pdf_w = all(1.0f);
    auto& m = g.materials;
    m.kind = {std::uint8_t(BsdfKind::null)};
    for (auto* c : {&m.distribution, &m.two_sided, &m.nonlinear, &m.sample_visible, &m.textured}) *c = {0};
    for (auto* c : {&m.int_ior, &m.ext_ior, &m.opacity, &m.exponent, &m.fdr_int, &m.fdr_ext}) *c = {1};
    m.alpha = {0, 0};
    for (auto* c : {&m.diffuse, &m.specular, &m.transmittance, &m.eta_c, &m.k_c}) *c = {1, 1, 1};
    g.light_edges.vertex = {n - 1};
    g.light_edges.technique = {1};
    g.light_edges.y = {1, n + 1, 0, 1};
    g.light_edges.Li = {1, 1, 1};
    g.light_edges.pdf_nee_w = {0};
    g.light_edges.pdf_bsdf_w = {1};
    g.light_edges.emitter = {0};
    const GraphReader reader(g);
    std::vector<double> opl;
    std::size_t edge = 0;
    walk_in_time(reader, OpticalLengths(g, {}), 0, edge, [&](const Spectrum&, double l) { opl.push_back(l); });
    ASSERT_EQ(opl.size(), 2u);
    const long double exact = (n + 1) * std::sqrt(2.0L);
    EXPECT_LT(std::abs(double((opl[1] - exact) / exact)), 1e-12);
}

// Narrow bins far away: 1e-4 at 4000. METHODS 4.4, 3. In single precision the lengths themselves are 2.4e-4 apart.
TEST(TimeOfFlight, NarrowBinsFarAwayAreHit) {
    const TimeResponse response = bins(2000, 4000, 1e-4);
    int misses = 0, misses_in_float = 0;
    for (std::uint32_t k = 0; k < response.n_bins; ++k) {
        const double tof = 4000 + (k + 0.5) * 1e-4;
        response.spread(tof, [&](std::uint32_t bin, double) { misses += bin != k; });
        response.spread(double(float(tof)), [&](std::uint32_t bin, double) { misses_in_float += bin != k; });
    }
    EXPECT_EQ(misses, 0);
    std::printf("    of %u arrivals %d would miss their bin in single precision\n", response.n_bins, misses_in_float);
    EXPECT_GT(misses_in_float, 500);
}

// The same room in another unit: the same histogram over bins of that unit. Paths are equal except for the offset of
// rays, which has a length of its own.
TEST(TimeOfFlight, UnitOfTheSceneChangesNothing) {
    const auto of = [](double scale) {
        const std::string body = fmt::format(
            R"(<shape type="cube"><transform name="to_world"><scale x="{0}" y="{0}" z="{0}"/></transform><boolean name="flip_normals" value="true"/>
<bsdf type="diffuse"><rgb name="reflectance" value="0.7"/></bsdf></shape><emitter type="point"><point name="position" x="{1}" y="{1}" z="{1}"/><rgb name="intensity" value="{2}"/></emitter>)",
            scale, 0.3 * scale, scale * scale);
        const std::string sensor = fmt::format(
            R"(type="perspective"><float name="fov" value="70"/><float name="near_clip" value="0.001"/><transform name="to_world"><lookat origin="{0}, 0, 0" target="{1}, 0, 0" up="0, 0, 1"/></transform>)",
            -0.9 * scale, scale);
        return cube_of(graph_of(sensor, body, 16, 6, 64), bins(60, 0, 0.2 * scale)).histogram();
    };
    const auto a = of(1), b = of(8);
    double difference = 0, sum = 0;
    for (std::size_t k = 0; k < a.size(); ++k) difference += std::abs(a[k] - b[k]), sum += a[k];
    EXPECT_LT(difference, 1e-3 * sum);
}

/// The glossy box: every kind of lobe, glass and an emitter.
PathGraph glossy_graph(int size, std::uint64_t spp, std::uint64_t seed = 11) {
    const auto scene = testing::own_scene("glossy-box.xml", size, size, {});
    return testing::trace_graph(*scene, testing::path_options(*scene, seed), spp);
}

// Bins, before, after and never add up to the steady image of the same paths, for every pulse.
TEST(TimeOfFlight, SumsOverTimeAreTheSteadyImage) {
    const PathGraph graph = glossy_graph(16, 16);
    const Image image = gather::path_traced_image(graph, 0);
    for (const Pulse& pulse :
         {Pulse::delta(), Pulse::box(0.3), Pulse::gaussian(0.1), Pulse::exponential_gaussian(0.05, 0.2)}) {
        TimeResponse response = bins(40, 4, 0.1);
        response.pulse = pulse;
        const Cube cube = cube_of(graph, response);
        for (std::size_t p = 0; p < graph.n_pixels(); ++p)
            for (int c = 0; c < 3; ++c) {
                double sum = cube.before[3 * p + c] + cube.after[3 * p + c] + cube.never[3 * p + c];
                for (std::uint32_t k = 0; k < cube.n_bins; ++k) sum += cube.bin(p, k, c);
                const double steady = image.find(std::string(1, "RGB"[c]))[p];
                ASSERT_NEAR(sum, steady, 1e-5 * steady);
                ASSERT_NEAR(cube.steady[3 * p + c], steady, 1e-5 * steady);
            }
    }
}

// The same values for any number of threads and any size of blocks.
TEST(TimeOfFlight, ThreadsAndBlocksChangeNothing) {
    const PathGraph graph = glossy_graph(24, 4);
    const Clusters clusters = testing::clusters_of(graph, 16);
    TimeResponse response = bins(200, 3, 0.05);
    response.pulse = Pulse::gaussian(0.1);
    for (const Clusters* shared : {static_cast<const Clusters*>(nullptr), &clusters}) {
        const Cube one = cube_of(graph, response, {{}, 1u << 30, 1, shared});
        for (const auto& [bytes, threads] : {std::pair<std::uint64_t, int>{1u << 30, 2}, {1, 2}, {300'000, 3}}) {
            const Cube other = cube_of(graph, response, {{}, bytes, threads, shared});
            EXPECT_EQ(one.radiance, other.radiance);
            EXPECT_EQ(one.var_mean, other.var_mean);
            EXPECT_EQ(one.steady, other.steady);
        }
    }
}

// Clusters of one vertex share nothing: what is left is the path's own light, weighted by the balance heuristic where
// the path alone has the power heuristic; in a scene of point lights there is nothing to weigh.
TEST(SharedArrivals, ClustersOfOneAreThePathsThemselves) {
    const auto scene = testing::own_scene("cornell-box.xml", 12, 12, {});
    const PathGraph graph = testing::trace_graph(*scene, testing::path_options(*scene, 5), 4);
    const Clusters alone = testing::clusters_of(graph, 1);
    const TimeResponse response = bins(60, 0, 0.2);
    const Cube own = cube_of(graph, response), shared = cube_of(graph, response, {{}, 1u << 30, 0, &alone});
    double difference = 0, sum = 0;
    for (std::size_t i = 0; i < own.radiance.size(); ++i)
        difference += std::abs(own.radiance[i] - shared.radiance[i]), sum += own.radiance[i];
    EXPECT_LT(difference, 0.02 * sum);
}

// Direct light shared by clusters, summed over time, is that of refining. Detected mutation: factors without 1 / rho.
TEST(SharedArrivals, DirectLightIsThatOfRefining) {
    const auto scene = testing::own_scene("cornell-box.xml", 16, 16, {{"max_depth", "2"}});
    PathOptions path = testing::path_options(*scene, 5);
    path.max_depth = 2;
    const PathGraph graph = testing::trace_graph(*scene, path, 4);
    const Clusters clusters = testing::clusters_of(graph, 16);
    refine::Options options;
    const Radiance radiance = testing::radiance_of(graph, clusters, options);
    const Cube cube = cube_of(graph, bins(1, 0, 1e6), {{}, 1u << 30, 0, &clusters});
    double difference = 0, sum = 0;
    for (std::size_t pixel = 0; pixel < graph.n_pixels(); ++pixel)
        for (int c = 0; c < 3; ++c) {
            double refined = 0;
            for (std::size_t s = 0; s < 4; ++s) {
                const std::size_t i = s * graph.n_pixels() + pixel;
                refined += (radiance.direct[3 * i + c] + graph.paths.Le[3 * i + c]) / 4;
            }
            difference += std::abs(refined - cube.steady[3 * pixel + c]);
            sum += refined;
        }
    EXPECT_GT(sum, 0);
    EXPECT_LT(difference, 1e-5 * sum);
}

}  // namespace
}  // namespace loom
