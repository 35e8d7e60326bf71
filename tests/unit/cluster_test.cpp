// loom-cluster: every vertex that shares is in exactly one cluster, and clusters satisfy their options.

#include "stages/cluster/cluster.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <numeric>
#include <vector>

#include "formats/io/octahedral.h"
#include "stages/cluster/median_splits.h"
#include "stages/cluster/nearest_centres.h"
#include "stages/core/clusters/cluster_quality.h"
#include "stages/core/clusters/sharing.h"
#include "stages/core/sampling/sampler.h"
#include "stages/core/scattering/bsdf_model.h"

namespace loom {
namespace {

using cluster::ClusterOptions;
using cluster::make_clusters;
using cluster::Method;
using cluster::Point;

float uniform(std::uint64_t i) {
    return unit_float(std::uint32_t(mix64(i * 0x9e3779b97f4a7c15ull + 11) >> 32));
}

/// A graph of paths of one vertex each; what clusters do not look at stays empty.
struct GraphOfVertices {
    std::vector<float> p, wo;
    std::vector<std::int16_t> ns;
    std::vector<std::uint16_t> material, flags;

    void add(Vector3f at, Vector3f n, Vector3f towards, std::uint16_t row = 0) {
        p.insert(p.end(), {at.x, at.y, at.z});
        wo.insert(wo.end(), {towards.x, towards.y, towards.z});
        const auto code = octahedral_from_unit(n.x, n.y, n.z);
        ns.insert(ns.end(), code.begin(), code.end());
        material.push_back(row);
        flags.push_back(flags_with_ending(0, Ending::max_depth));
    }
    /// Each vertex is of a path of its own.
    PathGraph graph(const std::vector<BsdfModel>& models = {BsdfModel{}}) const {
        PathGraph g;
        std::vector<std::uint64_t> first(flags.size() + 1);
        std::iota(first.begin(), first.end(), std::uint64_t{0});
        g.paths.first_vertex = std::move(first);
        g.vertices.p = p;
        g.vertices.wo = wo;
        g.vertices.ns = ns;
        g.vertices.material = material;
        g.vertices.flags = flags;
        std::vector<std::uint8_t> kind, textured(models.size());
        std::vector<float> alpha, exponent, opacity;
        for (const BsdfModel& m : models) {
            kind.push_back(std::uint8_t(m.kind));
            alpha.insert(alpha.end(), {m.alpha_u, m.alpha_v});
            exponent.push_back(m.exponent);
            opacity.push_back(m.opacity);
            g.materials.id.push_back("m");
        }
        g.materials.kind = kind;
        g.materials.textured = textured;
        g.materials.alpha = alpha;
        g.materials.exponent = exponent;
        g.materials.opacity = opacity;
        return g;
    }
};

/// A room of 10 x 10 x 3 m and a ground plane of 220 m around it, one vertex in eight on a mirror; 1/20 of the vertices
/// are far outside.
PathGraph room_on_a_plain(std::size_t n) {
    GraphOfVertices v;
    for (std::uint64_t i = 0; i < n; ++i) {
        const float a = uniform(4 * i), b = uniform(4 * i + 1), c = uniform(4 * i + 2), kind = uniform(4 * i + 3);
        const auto material = std::uint16_t(i % 8 == 7);
        const Vector3f up{0, 1, 0}, slant{0.6f, 0.64f, 0.48f};
        if (kind < 0.05f)
            v.add({220 * a - 110, 0, 220 * b - 110}, up, slant, material);
        else if (kind < 0.5f)
            v.add({10 * a - 5, 0.01f, 10 * b - 5}, up, slant, material);
        else if (kind < 0.8f)
            v.add({-5, 3 * a, 10 * b - 5}, {1, 0, 0}, slant, material);
        else {  // a ball
            const float z = 2 * a - 1, r = std::sqrt(1 - z * z), phi = 6.2831853f * b;
            const Vector3f d{r * std::cos(phi), z, r * std::sin(phi)};
            v.add(Vector3f{0, 1, 0} + d * (0.5f + 0.001f * c), d, d, material);
        }
    }
    std::vector<BsdfModel> models(2);
    models[1].kind = BsdfKind::conductor;
    return v.graph(models);
}

Normal3f side_normal(const PathGraph& g, std::size_t j) {
    const auto u = unit_from_octahedral(g.vertices.ns[2 * j], g.vertices.ns[2 * j + 1]);
    const Normal3f n{u[0], u[1], u[2]};
    return dot(n, Vector3f{g.vertices.wo[3 * j], g.vertices.wo[3 * j + 1], g.vertices.wo[3 * j + 2]}) < 0 ? -n : n;
}

class MakeClusters : public ::testing::TestWithParam<Method> {
  protected:
    ClusterOptions options() const {
        ClusterOptions o;
        o.method = GetParam();
        return o;
    }
};
INSTANTIATE_TEST_SUITE_P(Methods, MakeClusters, ::testing::Values(Method::balanced, Method::centres),
                         [](const auto& info) { return std::string(cluster::method_name(info.param)); });

// problem() refuses a member twice, empty clusters and ones above max_size; here no sharing vertex may be missing.
TEST_P(MakeClusters, EverySharingVertexIsInOneCluster) {
    const PathGraph g = room_on_a_plain(40'000);
    for (const std::uint32_t k : {2u, 16u, 64u}) {
        ClusterOptions o = options();
        o.k = k;
        const Clusters c = make_clusters(g, o);
        EXPECT_EQ(c.problem(), "");
        EXPECT_EQ(c.settings.max_size, 2 * k);
        EXPECT_EQ(c.n_members(), 35'000u);
        const SharingRule shares(g, o.private_roughness);
        for (const std::uint32_t j : c.member) ASSERT_TRUE(shares(j)) << j;
        if (GetParam() == Method::balanced) {
            EXPECT_LE(cluster_sizes(c).max, k);
        }
    }
}

TEST_P(MakeClusters, OfOneAreSingletons) {
    ClusterOptions o = options();
    o.k = o.max_size = 1;
    const Clusters c = make_clusters(room_on_a_plain(3'000), o);
    EXPECT_EQ(c.n_clusters(), c.n_members());
    EXPECT_EQ(c.problem(), "");
}

TEST_P(MakeClusters, DoNotDependOnThreadsOrOnWhatTheWorkspaceHeld) {
    const PathGraph g = room_on_a_plain(150'000);  // several chunks, several buckets
    ClusterOptions o = options();
    cluster::Workspace workspace;
    o.seed = 5;
    o.threads = 1;
    const Clusters one = make_clusters(g, o, workspace);
    o.seed = 6;
    const Clusters other = make_clusters(g, o, workspace);
    o.seed = 5;
    o.threads = 2;
    const Clusters two = make_clusters(g, o, workspace);
    EXPECT_TRUE(std::ranges::equal(one.first, two.first));
    EXPECT_TRUE(std::ranges::equal(one.member, two.member));
    EXPECT_FALSE(std::ranges::equal(one.member, other.member));  // borders move from pass to pass
}

// Light leaks: a wall of 1 mm, one face lit. A cluster over both faces would carry the light through.
TEST_P(MakeClusters, FacesOfAThinWallNeverShare) {
    GraphOfVertices v;
    for (std::uint64_t i = 0; i < 30'000; ++i) {
        const bool front = uniform(3 * i) < 0.85f;  // uneven: a median would fall within one face
        const Vector3f at{2 * uniform(3 * i + 1) - 1, 2 * uniform(3 * i + 2) - 1, front ? 0.0005f : -0.0005f};
        // The stored normal is that of the surface, the same on both sides: the side is that of wo.
        v.add(at, {0, 0, 1}, {0, 0.6f, front ? 0.8f : -0.8f});
    }
    const PathGraph g = v.graph();
    for (const std::uint64_t seed : {0, 1, 2}) {
        ClusterOptions o = options();
        o.seed = seed;
        const Clusters c = make_clusters(g, o);
        for (std::size_t i = 0; i < c.n_clusters(); ++i)
            for (std::uint32_t row = c.first[i]; row < c.first[i + 1]; ++row)
                ASSERT_EQ(g.vertices.p[3 * c.member[row] + 2] > 0, g.vertices.p[3 * c.member[c.first[i]] + 2] > 0);
        EXPECT_GT(cluster_sizes(c).mean, 12) << "the faces come apart without falling to pieces";
        o.normal_weight = 0;  // the paper's metric mixes them: the test can see it
        EXPECT_GT(cluster_spread(g, make_clusters(g, o)).share_opposed, 0.02);
    }
}

TEST_P(MakeClusters, NormalsOfAClusterAreLessThan90DegreesApart) {
    const PathGraph g = room_on_a_plain(20'000);
    const Clusters c = make_clusters(g, options());
    for (std::size_t i = 0; i < c.n_clusters(); ++i)
        for (std::uint32_t a = c.first[i]; a < c.first[i + 1]; ++a)
            for (std::uint32_t b = a + 1; b < c.first[i + 1]; ++b)
                ASSERT_GT(dot(side_normal(g, c.member[a]), side_normal(g, c.member[b])), 0.0f);
}

// Cost: with vertices four times as dense, clusters must not be larger than twice the mean.
TEST_P(MakeClusters, DenseAndSparseHalvesHaveClustersOfBoundedSize) {
    GraphOfVertices v;
    for (std::uint64_t i = 0; i < 50'000; ++i) {
        const float side = uniform(3 * i) < 0.8f ? 0.0f : 1.0f;
        v.add({side + uniform(3 * i + 1), uniform(3 * i + 2), 0}, {0, 0, 1}, {0, 0, 1});
    }
    const Clusters c = make_clusters(v.graph(), options());
    EXPECT_LE(cluster_sizes(c).max, 32u);
    EXPECT_NEAR(cluster_sizes(c).mean, 15.5, 1.5);
}

// The metric must work in a scene of any size: the same clusters for the same scene in other units.
TEST_P(MakeClusters, UnitsOfLengthDoNotMatter) {
    PathGraph g = room_on_a_plain(10'000);
    const Clusters metres = make_clusters(g, options());
    std::vector<float> scaled(g.vertices.p.begin(), g.vertices.p.end());
    for (float& x : scaled) x *= 1024;
    g.vertices.p = scaled;
    const Clusters other = make_clusters(g, options());
    EXPECT_FLOAT_EQ(other.settings.length_scale, 1024 * metres.settings.length_scale);
    EXPECT_TRUE(std::ranges::equal(metres.member, other.member));
}

// A plane to the horizon must not set the scale of the room.
TEST(ClusterScale, IsThatOfMostVertices) {
    const PathGraph g = room_on_a_plain(80'000);
    // 0.45 of 80 000 vertices on 100 m^2 of floor, one in eight on a mirror: 16 of them cover 0.0508 m^2, the disc of
    // this area has a root mean square radius of 0.09 m. Wall and ball are 1.8 and 0.1 times as dense by radius.
    const float s = make_clusters(g, {}).settings.length_scale;
    EXPECT_GT(s, 0.04f);
    EXPECT_LT(s, 0.12f);
}

TEST_P(MakeClusters, DegenerateGraphs) {
    EXPECT_EQ(make_clusters(GraphOfVertices{}.graph(), options()).n_clusters(), 0u);
    GraphOfVertices same;
    for (int i = 0; i < 1000; ++i) same.add({1, 2, 3}, {0, 0, 1}, {0, 0, 1});
    const Clusters c = make_clusters(same.graph(), options());
    EXPECT_EQ(c.problem(), "");
    EXPECT_EQ(c.n_members(), 1000u);
    std::vector<BsdfModel> mirror(1);
    mirror[0].kind = BsdfKind::conductor;
    EXPECT_EQ(make_clusters(same.graph(mirror), options()).n_clusters(), 0u);
}

// The plain twin of the tree.
TEST(NearestCentres, EqualBruteForce) {
    std::vector<Point> points(10'000), centres(600);
    for (std::uint64_t i = 0; i < points.size(); ++i)
        for (std::uint64_t c = 0; c < 6; ++c) points[i].x[c] = (c < 3 ? 10 : 4) * uniform(6 * i + c);
    for (std::size_t m = 0; m < centres.size(); ++m) centres[m] = points[m * 16];
    for (const int dimensions : {3, 6}) {
        std::vector<std::uint32_t> found(points.size());
        nearest_centres(points, centres, dimensions, 2, found);
        for (std::size_t i = 0; i < points.size(); ++i) {
            const auto distance = [&](std::size_t m) {
                float sum = 0;
                for (int c = 0; c < dimensions; ++c) {
                    const float d = points[i].x[std::size_t(c)] - centres[m].x[std::size_t(c)];
                    sum += d * d;
                }
                return sum;
            };
            std::size_t best = 0;
            for (std::size_t m = 1; m < centres.size(); ++m)
                if (distance(m) < distance(best)) best = m;
            ASSERT_EQ(found[i], best) << "point " << i << " in " << dimensions << " dimensions";
        }
    }
}

TEST(SharingRule, GoesByTheNarrowestLobe) {
    GraphOfVertices v;
    std::vector<BsdfModel> models;
    std::vector<bool> expected;
    const auto add = [&](BsdfKind kind, float alpha_u, float alpha_v, float opacity, bool shares) {
        BsdfModel m;
        m.kind = kind;
        m.alpha_u = alpha_u;
        m.alpha_v = alpha_v;
        m.opacity = opacity;
        m.exponent = kind == BsdfKind::phong ? 2 / (alpha_u * alpha_u) - 2 : 30;
        v.add({0, 0, 0}, {0, 0, 1}, {0, 0, 1}, std::uint16_t(models.size()));
        models.push_back(m);
        expected.push_back(shares);
    };
    for (const BsdfKind kind :
         {BsdfKind::diffuse, BsdfKind::rough_diffuse, BsdfKind::plastic, BsdfKind::rough_plastic}) {
        add(kind, 0, 0, 1, true);
        add(kind, 0, 0, 0.3f, true);
        add(kind, 0, 0, 0, false);
    }
    for (const BsdfKind kind : {BsdfKind::conductor, BsdfKind::dielectric, BsdfKind::thin_dielectric, BsdfKind::null})
        add(kind, 0.5f, 0.5f, 1, false);
    for (const BsdfKind kind : {BsdfKind::rough_conductor, BsdfKind::rough_dielectric, BsdfKind::ward}) {
        add(kind, 0.2f, 0.05f, 1, true);
        add(kind, 0.05f, 0.05f, 1, true);
        add(kind, 0.2f, 0.04f, 1, false);
        add(kind, 0.04f, 0.2f, 1, false);
    }
    add(BsdfKind::phong, 0.06f, 0, 1, true);
    add(BsdfKind::phong, 0.04f, 0, 1, false);
    const PathGraph g = v.graph(models);
    const SharingRule shares(g, 0.05f);
    for (std::size_t j = 0; j < expected.size(); ++j) EXPECT_EQ(shares(j), expected[j]) << "material " << j;
}

TEST(SharingRule, ReadsTexturesAtTheVertex) {
    GraphOfVertices v;
    for (int i = 0; i < 4; ++i) v.add({0, 0, 0}, {0, 0, 1}, {0, 0, 1});
    std::vector<BsdfModel> models(1);
    models[0].kind = BsdfKind::rough_conductor;
    models[0].alpha_u = models[0].alpha_v = 0.5f;
    PathGraph g = v.graph(models);
    g.materials.textured = {std::uint8_t(textured_parameter::alpha | textured_parameter::opacity)};
    const auto half = [](float x) { return half_from_float(x); };
    g.vertices.alpha = {half(0.2f),  half(0.2f),  half(0.2f), half(0.01f),
                        half(0.03f), half(0.03f), half(0.2f), half(0.2f)};
    g.vertices.opacity = {half(1), half(1), half(1), half(0)};
    const SharingRule shares(g, 0.03f);
    EXPECT_TRUE(shares(0));
    EXPECT_FALSE(shares(1));
    EXPECT_TRUE(shares(2)) << "just the limit, in half precision";
    EXPECT_FALSE(shares(3));
    EXPECT_TRUE(SharingRule(g, 0)(1)) << "without a limit every finite width shares";
}

/// The rule of split_by_medians() for points of one normal, by sorting: sets of vertices, piece by piece.
void split_by_sorting(std::vector<Point> points, std::uint32_t k, std::uint64_t key,
                      std::vector<std::vector<std::uint32_t>>& pieces) {
    const std::size_t n = points.size();
    if (n <= k) {
        std::vector<std::uint32_t>& piece = pieces.emplace_back();
        for (const Point& p : points) piece.push_back(p.vertex);
        std::sort(piece.begin(), piece.end());
        return;
    }
    std::size_t axis = 0;
    float widest = -1;
    for (std::size_t c = 0; c < 3; ++c) {
        const auto [low, high] = std::minmax_element(points.begin(), points.end(),
                                                     [c](const Point& a, const Point& b) { return a.x[c] < b.x[c]; });
        if (high->x[c] - low->x[c] > widest) widest = high->x[c] - low->x[c], axis = c;
    }
    std::sort(points.begin(), points.end(), [axis](const Point& a, const Point& b) {
        return a.x[axis] < b.x[axis] || (a.x[axis] == b.x[axis] && a.vertex < b.vertex);
    });
    const std::size_t n_pieces = (n + k - 1) / k, n_left = n * ((n_pieces + (mix64(key) & 1)) / 2) / n_pieces;
    split_by_sorting({points.begin(), points.begin() + std::ptrdiff_t(n_left)}, k, 2 * key + 1, pieces);
    split_by_sorting({points.begin() + std::ptrdiff_t(n_left), points.end()}, k, 2 * key + 2, pieces);
}

// Points spread evenly, on a few planes (ties), with one point so far away that the rest shares a bin, and all at one
// position. Detected mutations: the bin of the median itself not divided; ties not broken by vertex.
TEST(MedianSplits, AreThoseOfSorting) {
    for (const int kind : {0, 1, 2, 3})
        for (const std::size_t n : {std::size_t(33), std::size_t(500), std::size_t(5000)}) {
            std::vector<Point> points(n);
            for (std::size_t i = 0; i < n; ++i) {
                Point& p = points[i];
                p = {{}, std::uint32_t(mix64(i) % n * n + i), {}};
                for (std::size_t c = 0; c < 3; ++c) {
                    const float u = uniform(3 * i + c);
                    p.x[c] = kind == 1 ? std::floor(4 * u) : kind == 3 ? 0.5f : u;
                }
                if (kind == 2 && i == n / 2) p.x[1] = 1e9f;
            }
            std::vector<std::vector<std::uint32_t>> expected;
            split_by_sorting(points, 16, 7, expected);
            std::vector<std::uint32_t> sizes;
            cluster::split_by_medians(points, {16, cluster::infinite_spread, 7}, sizes);
            ASSERT_EQ(sizes.size(), expected.size());
            std::size_t at = 0;
            for (std::size_t i = 0; i < sizes.size(); ++i) {
                std::vector<std::uint32_t> piece;
                for (std::uint32_t j = 0; j < sizes[i]; ++j) piece.push_back(points[at++].vertex);
                EXPECT_EQ(piece, expected[i]) << "kind " << kind << ", " << n << " points, piece " << i;
            }
        }
}

}  // namespace
}  // namespace loom
