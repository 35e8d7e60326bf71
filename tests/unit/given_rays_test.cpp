// Paths that start with given rays: those of the camera against the traced graph, to the last bit; those that leave a
// vertex against the rest of the path through it.
//
// Detected mutations: depths counted from 1 at the ray; its emission weighted; emission beyond max_depth; camera rays that
// hit hidden emitters, other rays that do not; the media of the ray ignored; random numbers by the order in the batch; the
// first vertex taken for a continuation; n_vertices with those before the ray.

#include <fmt/format.h>
#include <gtest/gtest.h>
#include <tbb/enumerable_thread_specific.h>

#include <stdexcept>

#include "stages/core/compute/parallel.h"
#include "stages/core/graph/time_of_flight.h"
#include "stages/core/tracing/given_ray_tracer.h"
#include "tests/path_states.h"
#include "tests/traced_graph.h"

namespace loom::testing {
namespace {

constexpr OptionalColumns all_columns{true, true, true};

/// Copies the rows of one path, numbers of vertices relative to its first one.
struct PathBytes : FieldVisitor<PathBytes> {
    std::array<std::size_t, 2> paths{}, vertices{}, edges{}, misses{};
    std::string bytes;

    PathBytes(const PathGraph& g, std::size_t path)
        : paths{path, path + 1}, vertices{g.paths.first_vertex[path], g.paths.first_vertex[path + 1]} {
        for (int k = 0; k < 2; ++k) {
            edges[k] = row_of(g.light_edges.vertex, vertices[k]);
            misses[k] = row_of(g.misses.vertex, vertices[k]);
        }
        PathGraph::row_fields(g, *this);
    }
    template <class T>
    void column_of(const Field& field, const Column<T>& column) {
        // A graph of a perspective camera has no origins; they are compared elsewhere.
        if (column.empty() || field.axes == "path+1" || field.name == "paths/origin") return;
        const auto& rows = field.axes.starts_with("path")     ? paths
                           : field.axes.starts_with("vertex") ? vertices
                           : field.axes.starts_with("edge")   ? edges
                                                              : misses;
        if (rows[0] < rows[1]) bytes += field.name;
        for (std::size_t i = rows[0] * field.row_size(); i < rows[1] * field.row_size(); ++i) {
            T value = column[i];
            if constexpr (std::is_same_v<T, std::uint32_t>)
                if (field.name.ends_with("/vertex")) value -= T(vertices[0]);
            bytes.append(reinterpret_cast<const char*>(&value), sizeof value);
        }
    }

  private:
    static std::size_t row_of(const Column<std::uint32_t>& of, std::size_t vertex) {
        return std::size_t(std::lower_bound(of.begin(), of.end(), vertex) - of.begin());
    }
};

/// Returns the rows of each path that starts with one of the rays.
std::vector<std::string> rows_of(const Scene& scene, const PathOptions& options, std::span<const GivenRay> rays,
                                 std::size_t batch = PathBatch::capacity, int threads = 1) {
    std::vector<std::string> rows(rays.size());
    tbb::enumerable_thread_specific<GivenRayTracer> tracers(
        [&] { return GivenRayTracer(scene, options, all_columns); });
    parallel_chunks(rays.size(), batch, threads, [&](std::uint64_t, std::uint64_t begin, std::uint64_t end) {
        GivenRayTracer& tracer = tracers.local();
        const PathGraph& g = tracer.trace(rays.subspan(begin, end - begin));
        EXPECT_EQ(g.n_paths(), end - begin);
        for (std::size_t i = 0; i < g.n_paths(); ++i) {
            rows[begin + i] = PathBytes(g, i).bytes;
            EXPECT_EQ(camera_origin<float>(g, i), rays[begin + i].ray.o);
        }
    });
    return rows;
}

std::vector<PathId> ids_of(const Scene& scene, std::uint64_t spp) {
    std::vector<PathId> ids;
    for (std::uint64_t sample = 0; sample < spp; ++sample)
        for (std::uint64_t pixel = 0; pixel < scene.sensor.n_pixels(); ++pixel) ids.push_back({pixel, sample});
    return ids;
}

GivenRay given(const PathState& state, PathId id) {
    return {state.ray, id, state.media, state.depth()};
}

/// A lamp over a plate under a constant sky; hidden from the camera.
std::unique_ptr<Scene> hidden_lamp() {
    auto scene =
        load_inline({.sensor = "type='perspective'><float name='fov' value='40'/><transform name='to_world'>"
                               "<lookat origin='0,0,5' target='0,0,0' up='0,1,0'/></transform>",
                     .body = "<emitter type='constant'><rgb name='radiance' value='0.5'/></emitter>"
                             "<shape type='rectangle'><transform name='to_world'><translate z='1'/></transform>"
                             "<emitter type='area'><rgb name='radiance' value='2'/></emitter></shape>"
                             "<shape type='rectangle'><transform name='to_world'><scale value='1.2'/><translate "
                             "z='-1'/></transform></shape>",
                     .width = 24,
                     .height = 24});
    scene->hides_emitters = true;
    scene->camera_rays = std::make_shared<RayEngine>(scene->shapes, RayEngine::Use::camera_rays);
    return scene;
}

struct GivenCase {
    std::string name, scene;
    SamplerKind sampler = SamplerKind::sobol;
    Roulette roulette = Roulette::albedo;
    int max_depth = -1;
};

class GivenRays : public ::testing::TestWithParam<GivenCase> {
  protected:
    GivenRays() {
        const GivenCase& c = GetParam();
        scene = c.scene.empty() ? hidden_lamp() : own_scene(c.scene, 24, 24);
        options = path_options(*scene, 7, c.sampler);
        options.roulette = c.roulette;
        options.rr_depth = 3;
        options.max_depth = c.max_depth;
    }
    std::unique_ptr<Scene> scene;
    PathOptions options;
};

TEST_P(GivenRays, OfTheCameraEqualTheTracedGraph) {
    const PathGraph whole = trace_graph(*scene, options, 2, 0, all_columns);
    std::vector<GivenRay> rays;
    for (const PathId& id : ids_of(*scene, 2)) {
        const Sampler sampler(options.sampler, options.seed, id.pixel, id.sample);
        rays.push_back(given(PathState(*scene, sampler, id, sampler.pair(film_pair)), id));
    }
    const std::vector<std::string> rows = rows_of(*scene, options, rays);
    ASSERT_EQ(rows.size(), whole.n_paths());
    for (std::size_t i = 0; i < rows.size(); ++i) {
        ASSERT_TRUE(rows[i] == PathBytes(whole, i).bytes) << "path " << i;
        ASSERT_EQ(camera_origin<float>(whole, i), rays[i].ray.o);
    }
}

struct Arrival {
    Spectrum L;
    double opl;
};

std::vector<Arrival> arrivals_of(const GraphReader& reader, const OpticalLengths& lengths, std::size_t path) {
    std::vector<Arrival> arrivals;
    std::size_t edge = first_light_edge(reader.graph(), reader.graph().paths.first_vertex[path]);
    walk_in_time(reader, lengths, path, edge, [&](const Spectrum& L, double opl) { arrivals.push_back({L, opl}); });
    return arrivals;
}

void expect_near(const Spectrum& a, const Spectrum& b) {
    const double tolerance = 2e-3 * std::max<double>(max_channel(a), max_channel(b));  // of stored colours
    for (int c = 0; c < 3; ++c) EXPECT_NEAR(a[c], b[c], tolerance);
}

// A path from vertex j on, started anew by the ray that leaves it, brings the light of the whole path divided by the
// throughput to there, along lengths without those to there.
TEST_P(GivenRays, ThatLeaveAVertexGiveTheRestOfItsPath) {
    if (options.roulette == Roulette::throughput) options.roulette = Roulette::albedo;  // no throughput before the ray
    const PathGraph whole = trace_graph(*scene, options, 1);
    const GraphReader reader(whole);
    const OpticalLengths lengths(whole, {});
    GivenRayTracer tracer(*scene, options);
    const GraphReader rest_reader(tracer.graph());
    const OpticalLengths rest_lengths(tracer.graph(), {});
    std::size_t n_arrivals = 0, path = 0;
    for (const PathId& id : ids_of(*scene, 1)) {
        const auto states = states_of(*scene, options, id);
        std::vector<GivenRay> rays;
        for (std::size_t k = 1; k < states.size(); ++k) rays.push_back(given(states[k], id));
        tracer.trace(rays);
        for (std::size_t k = 1; k < states.size(); ++k) {
            SCOPED_TRACE(fmt::format("path {}, vertex {}", path, k));
            // Lengths to vertex k, light edges behind it, and the light that its ray hits.
            const std::size_t first = whole.paths.first_vertex[path], end = whole.paths.first_vertex[path + 1];
            std::vector<Arrival> expected;
            double opl = 0, opl_to_k = 0;
            Point3<double> x;
            std::size_t edge = first_light_edge(whole, first);
            Spectrum Le;
            walk_path(
                OwnSamples(reader), path, edge,
                [&](std::size_t j, const ShadingPoint&) {
                    opl += j == first ? lengths.from_camera(path) : lengths.to_vertex(j, x);
                    x = position<double>(whole, j);
                    if (j == first + k - 1) opl_to_k = opl;
                },
                [&](std::size_t j, std::size_t e, const Spectrum& L) {
                    if (j >= first + k) expected.push_back({L, opl + lengths.to_light(e, x)});
                    if (j == first + k - 1 && whole.light_edges.technique[e] == 1) {
                        Le = rgb(whole.light_edges.Li, e);
                        expected.push_back({states[k].beta * Le, opl + lengths.to_light(e, x)});
                    }
                });
            EXPECT_EQ(rgb(tracer.graph().paths.Le, k - 1), Le);
            // A path ends on a black emitter without a vertex, but the ray's first hit is one.
            const bool on_emitter = first + k == end && ending_of(whole.vertices.flags[end - 1]) == Ending::hit_emitter;
            EXPECT_EQ(tracer.results()[k - 1].n_vertices, end - first - k + (on_emitter ? 1 : 0));
            const std::vector<Arrival> arrivals = arrivals_of(rest_reader, rest_lengths, k - 1);
            ASSERT_EQ(arrivals.size(), expected.size());
            Spectrum sum;
            for (std::size_t i = 0; i < arrivals.size(); ++i) {
                sum += arrivals[i].L;
                expect_near(states[k].beta * arrivals[i].L, expected[i].L);
                if (!std::isinf(expected[i].opl))
                    EXPECT_NEAR(arrivals[i].opl, expected[i].opl - opl_to_k, 2e-5 * expected[i].opl);
                else
                    EXPECT_EQ(arrivals[i].opl, expected[i].opl);
            }
            expect_near(sum, tracer.results()[k - 1].L);
            n_arrivals += arrivals.size();
        }
        ++path;
    }
    EXPECT_GT(n_arrivals, 100u);
}

TEST_P(GivenRays, AreTracedAlikeInAnyBatchOnAnyThread) {
    std::vector<GivenRay> rays;
    for (const PathId& id : ids_of(*scene, 1))
        for (const PathState& state : states_of(*scene, options, id)) rays.push_back(given(state, id));
    const auto rows = rows_of(*scene, options, rays);
    EXPECT_TRUE(rows == rows_of(*scene, options, rays, 7));
    EXPECT_TRUE(rows == rows_of(*scene, options, rays, 100, 2));
}

INSTANTIATE_TEST_SUITE_P(
    Scenes, GivenRays,
    ::testing::Values(GivenCase{"matte", "cornell-box.xml"},
                      GivenCase{"glossy", "glossy-box.xml", SamplerKind::independent, Roulette::throughput},
                      GivenCase{"lights", "all-emitters.xml", SamplerKind::sobol, Roulette::off, 6},
                      GivenCase{"glass", "caustic.xml"}, GivenCase{"textured", "textured.xml"},
                      GivenCase{"mask", "mask.xml", SamplerKind::independent, Roulette::off, 5},
                      GivenCase{"map", "environment-map.xml"}, GivenCase{"hidden", ""},
                      GivenCase{"short", "cornell-box.xml", SamplerKind::sobol, Roulette::albedo, 3}),
    [](const auto& info) { return info.param.name; });

GivenRay ray_along(Point3f o, Vector3f d, int depth) {
    return {{o, d}, {3, 5}, {}, depth};
}

TEST(GivenRay, HitsAHiddenEmitterUnlessItIsACameraRay) {
    const auto scene = hidden_lamp();
    GivenRayTracer tracer(*scene, path_options(*scene, 1));
    const std::vector<GivenRay> rays{ray_along({0.1f, 0.2f, 4}, {0, 0, -1}, 1),
                                     ray_along({0.1f, 0.2f, 4}, {0, 0, -1}, 2), ray_along({5, 0, 4}, {0, 0, -1}, 1),
                                     ray_along({5, 0, 4}, {0, 0, -1}, 2)};
    const PathGraph& g = tracer.trace(rays);
    EXPECT_EQ(rgb(g.paths.Le, 0), Spectrum(0));
    EXPECT_EQ(rgb(g.paths.Le, 1), Spectrum(2));
    EXPECT_EQ(tracer.results()[0].first.depth, 5);
    EXPECT_FLOAT_EQ(tracer.results()[1].first.depth, 3);
    EXPECT_EQ(rgb(g.paths.Le, 2), Spectrum(0));
    EXPECT_EQ(rgb(g.paths.Le, 3), Spectrum(0.5f));
}

TEST(GivenRay, AtTheLargestDepthHasEmissionAloneAndNothingBeyond) {
    const auto scene = hidden_lamp();
    PathOptions options = path_options(*scene, 1);
    options.max_depth = 4;
    options.roulette = Roulette::off;
    GivenRayTracer tracer(*scene, options);
    std::vector<GivenRay> rays;
    for (int depth = 3; depth <= 5; ++depth)
        for (const float x : {0.1f, 0.9f, 5.0f}) {  // to the lamp, the lit plate, the sky
            rays.push_back(ray_along({x, 0.2f, 4}, {0, 0, -1}, depth));
            if (x == 0.9f) rays.back().ray = {{0.5f, 0.2f, 0.5f}, {0, 0, -1}};
        }
    const PathGraph& g = tracer.trace(rays);
    for (std::size_t i = 0; i < rays.size(); ++i) {
        SCOPED_TRACE(i);
        const std::size_t target = i % 3;
        EXPECT_EQ(rgb(g.paths.Le, i),
                  rays[i].depth > 4 || target == 1 ? Spectrum(0) : Spectrum(target == 0 ? 2.0f : 0.5f));
        EXPECT_EQ(is_black(tracer.results()[i].L), rays[i].depth > 4 || (target == 1 && rays[i].depth == 4));
        EXPECT_EQ(tracer.results()[i].n_vertices > 0, target != 2);
    }
}

TEST(GivenRay, OfOneIdAndDepthHasTheSameRandomNumbers) {
    const auto scene = hidden_lamp();
    GivenRayTracer tracer(*scene, path_options(*scene, 1));
    std::vector<GivenRay> rays;
    for (int i = 0; i < 4; ++i) rays.push_back(ray_along({-0.7f, 0.1f * float(i), 0}, {0, 0, -1}, 2));
    rays[2].depth = 3;
    rays[3].id.sample = 6;
    const PathGraph& g = tracer.trace(rays);
    // The light point that the first vertex samples, or the direction of its light sample.
    const auto light_point = [&](std::size_t path) {
        const std::size_t k = first_light_edge(g, g.paths.first_vertex[path]);
        EXPECT_EQ(g.light_edges.vertex[k], g.paths.first_vertex[path]);
        const auto y = g.light_edges.y.row(k, 4);
        return std::vector<float>(y.begin(), y.end());
    };
    EXPECT_EQ(light_point(0), light_point(1));
    EXPECT_NE(light_point(0), light_point(2));
    EXPECT_NE(light_point(0), light_point(3));
}

TEST(GivenRay, InGlassTakesLongerToItsEmitter) {
    const auto scene = load_inline(
        {.sensor = "type='perspective'><transform name='to_world'><lookat origin='0,0,5' target='0,0,0' "
                   "up='0,1,0'/></transform>",
         .body = "<shape type='cube'><bsdf type='dielectric'><float name='int_ior' value='1.5'/><float name='ext_ior' "
                 "value='1'/></bsdf></shape><shape type='rectangle'><transform name='to_world'><scale value='.2'/>"
                 "<rotate y='1' angle='180'/><translate z='.5'/></transform><emitter type='area'><rgb name='radiance' "
                 "value='2'/></emitter></shape>"});
    GivenRay ray = ray_along({0.1f, 0, -0.5f}, {0, 0, 1}, 3);
    ray.media = media_at(*scene, ray.ray.o);
    GivenRayTracer tracer(*scene, path_options(*scene, 1), all_columns);
    const PathGraph& g = tracer.trace({&ray, 1});
    const auto arrivals = arrivals_of(GraphReader(g), OpticalLengths(g, {}), 0);
    ASSERT_FALSE(arrivals.empty());
    EXPECT_EQ(arrivals[0].L, Spectrum(2));
    EXPECT_NEAR(arrivals[0].opl, 1.5, 1e-6);
    EXPECT_EQ(g.vertices.medium[0], ray.media.medium().material_idx);
}

// Rays to the second vertices of a capture's paths, with their random numbers: the paths go on as those of the capture.
// Detected mutations: the laser point of the first pixel for all; the depth of the ray, 1.
TEST(GivenRay, GoesOnAsAPathOfAnNlosCapture) {
    const auto scene = load_scene(std::filesystem::path(LOOM_SOURCE_DIR) / "scenes/nlos.xml",
                                  {{"res", "4"}, {"capture", "confocal"}, {"max_depth", "6"}});
    const PathOptions options = path_options(*scene, 1);
    const PathGraph g = trace_graph(*scene, options, 64);
    std::vector<GivenRay> rays;
    std::vector<std::size_t> second;
    for (std::size_t path = 0; path < g.n_paths(); ++path) {
        const auto [begin, end] = vertices_of(g, path);
        if (end - begin < 2) continue;
        const Point3f from(position<double>(g, begin)), to(position<double>(g, begin + 1));
        GivenRay ray = ray_along(from, normalize(to - from), 2);
        ray.id = {path % g.n_pixels(), path / g.n_pixels()};
        ray.pixel = path % g.n_pixels();
        ray.media = scene->sensor_media.everywhere;
        rays.push_back(ray);
        second.push_back(begin + 1);
    }
    ASSERT_GT(rays.size(), 500u);
    ASSERT_LE(rays.size(), PathBatch::capacity);
    GivenRayTracer tracer(*scene, options, all_columns);
    const PathGraph& ours = tracer.trace(rays);
    std::size_t n_vertices = 0, n_lights = 0;
    for (std::size_t i = 0; i < rays.size(); ++i) {
        const auto [begin, end] = vertices_of(ours, i);
        for (std::size_t j = begin; j < end; ++j, ++n_vertices)
            ASSERT_LT(length(position<double>(ours, j) - position<double>(g, second[i] + j - begin)), 1e-3)
                << i << " " << j;
        const auto light_of = [](const PathGraph& of, std::size_t vertex) {
            const std::size_t k = first_light_edge(of, vertex);
            return k < of.n_light_edges() && of.light_edges.vertex[k] == vertex ? rgb(of.light_edges.Li, k)
                                                                                : Spectrum(0);
        };
        for (std::size_t j = begin; j < end; ++j) {
            const Spectrum a = light_of(ours, j), b = light_of(g, second[i] + j - begin);
            EXPECT_NEAR(a.g, b.g, 2e-3f * b.g) << i;
            n_lights += b.g > 0;
        }
    }
    EXPECT_GT(n_vertices, rays.size());
    EXPECT_GT(n_lights, 200u);
}

}  // namespace
}  // namespace loom::testing
