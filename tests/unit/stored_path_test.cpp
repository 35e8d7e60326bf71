// Contributions of stored paths: the walk with several numbers, and the fast versions of the walk and of the readers.

#include <gtest/gtest.h>

#include "stages/cluster/metric.h"
#include "stages/core/graph/own_samples.h"
#include "stages/core/math/dual.h"
#include "stages/core/math/matrix.h"
#include "stages/refine/system.h"
#include "tests/traced_graph.h"

namespace loom {
namespace {

PathGraph graph_of(const char* scene_file) {
    const auto scene = testing::own_scene(scene_file, 32, 24);
    PathOptions path = testing::path_options(*scene, 7);
    path.rr_depth = 2;
    return testing::trace_graph(*scene, path, 2);
}

using Derivative = Dual<1, double>;

/// All continuations times a variable whose value is 1.
struct ScaledContinuations {
    OwnSamples samples;

    const PathGraph& graph() const { return samples.graph(); }
    ShadingPoint vertex(std::size_t j) const { return samples.vertex(j); }
    Rgb<Derivative> continuation(std::size_t j, const ShadingPoint& at) const {
        return Rgb<Derivative>(samples.continuation(j, at)) * Derivative::variable(1, 0);
    }
    Rgb<Derivative> light(std::size_t j, const ShadingPoint& at, std::size_t k) const {
        return Rgb<Derivative>(samples.light(j, at, k));
    }
};

/// The paths of a scene that moves rigidly with a parameter whose value is 0, camera and all.
struct MovedSamples {
    const GraphReader& reader;
    Matrix4<Derivative> motion =
        Matrix4<Derivative>::rotation({Derivative(1), Derivative(2), Derivative(3)}, Derivative::variable(0, 0)) *
        Matrix4<Derivative>::translation(Derivative::variable(0, 0), Derivative(0), Derivative(0));

    const PathGraph& graph() const { return reader.graph(); }
    ShadingPointOf<Derivative> vertex(std::size_t j) const {
        ShadingPointOf<Derivative> at(reader.vertex(j));
        const auto turn = [&](auto& v) { v = std::decay_t<decltype(v)>(motion.vector(Vector3<Derivative>(v))); };
        at.p = motion.point(at.p);
        turn(at.wo), turn(at.ng), turn(at.n_side), turn(at.frame.s), turn(at.frame.t), turn(at.frame.n);
        at.wo_local = at.frame.to_local(at.wo);
        return at;
    }
    Rgb<Derivative> continuation(std::size_t j, const ShadingPointOf<Derivative>& at) const {
        const Vector3<Derivative> wi(continuation_direction(graph(), j));
        return own_continuation(reader, at, j, motion.vector(wi));
    }
    Rgb<Derivative> light(std::size_t j, const ShadingPointOf<Derivative>& at, std::size_t k) const {
        const float* y = graph().light_edges.y.data() + 4 * k;
        const Vector3<Derivative> to(Vector3f{y[0], y[1], y[2]});
        const Vector3<Derivative> wi =
            y[3] == 0 ? motion.vector(to) : normalize(motion.point(Point3<Derivative>(to)) - at.p);
        return own_light(reader, at, j, k, wi, Rgb<Derivative>(rgb(graph().light_edges.Li, k)));
    }
};

class StoredPath : public ::testing::TestWithParam<const char*> {};

// Detected mutations: the light points stay; the shading frames do not turn.
TEST_P(StoredPath, OfASceneThatMovesRigidlyHasNoDerivative) {
    const PathGraph graph = graph_of(GetParam());
    const GraphReader reader(graph);
    const auto no_vertex = [](std::size_t, const auto&) {};
    std::size_t edge[2] = {};
    double sum = 0;
    for (std::size_t path = 0; path < graph.n_paths(); ++path) {
        std::vector<Spectrum> still;
        walk_path(OwnSamples(reader), path, edge[0], no_vertex,
                  [&](std::size_t, std::size_t, const Spectrum& L) { still.push_back(L); });
        std::size_t i = 0;
        walk_path<Derivative>(
            MovedSamples{reader}, path, edge[1], no_vertex, [&](std::size_t, std::size_t, const Rgb<Derivative>& L) {
                const Spectrum& value = still[i++];
                for (int c = 0; c < 3; ++c) {
                    EXPECT_NEAR(L[c].value, value[c], 0.1 * value[c] + 1e-9);  // narrow lobes in float
                    EXPECT_NEAR(L[c].d[0], 0, 2e-4 * value[c]) << path;
                    sum += value[c];
                }
            });
    }
    EXPECT_GT(sum, 0);
}

TEST_P(StoredPath, HasTheSameRadianceInEveryNumber) {
    const PathGraph graph = graph_of(GetParam());
    const GraphReader reader(graph);
    const OwnSamples samples(reader);
    const auto no_vertex = [](std::size_t, const ShadingPoint&) {};
    std::size_t edge[3] = {};
    double sum = 0, derivative = 0, largest_error = 0;
    for (std::size_t path = 0; path < graph.n_paths(); ++path) {
        const std::size_t first = vertices_of(graph, path).begin;
        std::vector<Spectrum> plain;
        walk_path(samples, path, edge[0], no_vertex,
                  [&](std::size_t, std::size_t, const Spectrum& L) { plain.push_back(L); });
        std::size_t i = 0;
        walk_path<double>(samples, path, edge[1], no_vertex, [&](std::size_t, std::size_t, const Rgb<double>& L) {
            const double size = std::max(max_channel(L), 1e-30);
            largest_error = std::max(largest_error, std::abs(max_channel(plain[i++]) - size) / size);
        });
        ASSERT_EQ(i, plain.size());
        // The derivative of a product of n equal factors at 1 is n times the product.
        walk_path<Derivative>(ScaledContinuations{samples}, path, edge[2], no_vertex,
                              [&](std::size_t j, std::size_t, const Rgb<Derivative>& L) {
                                  const double n = double(j - first);
                                  EXPECT_NEAR(L.g.d[0], n * L.g.value, 1e-12 * n * L.g.value);
                                  sum += L.g.value;
                                  derivative += L.g.d[0];
                              });
    }
    for (const std::size_t last : edge) EXPECT_EQ(last, graph.n_light_edges());
    EXPECT_LT(largest_error, 1e-5);
    EXPECT_GT(derivative, 0.1 * sum);
}

// The columns that refine sums up against vertices read one by one. Detected mutation: the balance heuristic on one
// side.
TEST_P(StoredPath, IsTheSameFromTheColumnsOfTheSystem) {
    const PathGraph graph = graph_of(GetParam());
    const GraphReader reader(graph);
    refine::System system = refine::build_system(graph, testing::clusters_of(graph, 16), {});
    const HugeArray<refine::Light> plain = refine::path_radiance(reader, 0);
    const HugeArray<refine::Light> indirect = refine::path_radiance(system, graph, 0);
    double error = 0, sum = 0, indirect_error = 0, indirect_sum = 0;
    for (std::size_t j = 0; j < graph.n_vertices(); ++j) {
        const refine::Light& X = system.at[system.unknown[j]].X;
        error += std::abs(X.r - plain[j].r) + std::abs(X.g - plain[j].g) + std::abs(X.b - plain[j].b);
        sum += plain[j].r + plain[j].g + plain[j].b;
    }
    const OwnSamples samples(reader);
    for (std::size_t path = 0; path < graph.n_paths(); ++path) {
        const auto [first, end] = vertices_of(graph, path);
        if (end - first < 2) continue;
        const refine::Light& next = plain[first + 1];
        const float expected = samples.continuation(first, samples.vertex(first)).g * next.g;
        indirect_error += std::abs(indirect[path].g - expected);
        indirect_sum += expected;
    }
    EXPECT_LT(error, 1e-5 * sum);
    EXPECT_LT(indirect_error, 1e-5 * indirect_sum);
    EXPECT_GT(indirect_sum, 0);
}

INSTANTIATE_TEST_SUITE_P(Scenes, StoredPath, ::testing::Values("cornell-box.xml", "glossy-box.xml", "caustic.xml"),
                         [](const auto& info) {
                             const std::string name = info.param;
                             return name.substr(0, name.find_first_of("-."));
                         });

// Detected mutation: the shading normal in place of the geometric one.
TEST(StoredVertex, HasTheGeometricNormalOfItsCluster) {
    PathGraph graph = graph_of("glossy-box.xml");
    // Geometric normals that differ from the shading normals: each vertex gets that of another.
    const auto& ns = graph.vertices.ns;
    const std::size_t n_vertices = graph.n_vertices();
    std::vector<std::int16_t> ng(2 * n_vertices);
    for (std::size_t j = 0; j < n_vertices; ++j)
        for (std::size_t c = 0; c < 2; ++c) ng[2 * j + c] = ns[2 * (n_vertices - 1 - j) + c];
    graph.vertices.ng = ng;
    const cluster::Pool pool(graph, nullptr, 0);
    const cluster::Metric metric(pool, 1, 0, 0);
    for (std::size_t j = 0; j < n_vertices; ++j) {
        const Normal3f n = facing(geometric_normal(graph, j), outgoing(graph, j));
        const auto code = metric.geometric_normal(j);
        const auto unit = unit_from_octahedral(code[0], code[1]);
        const Vector3f of_metric{unit[0], unit[1], unit[2]};
        ASSERT_LT(length(of_metric - Vector3f(n)), 1e-6f) << j;
    }
}

}  // namespace
}  // namespace loom
