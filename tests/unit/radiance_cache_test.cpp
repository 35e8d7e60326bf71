// loom-learn and the queries of its caches: what is learnt is read back, and nothing else.

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>

#include "formats/io/octahedral.h"
#include "stages/core/cache/point_cache.h"
#include "stages/core/sampling/sampler.h"
#include "stages/learn/learn.h"
#include "tests/traced_graph.h"

namespace loom {
namespace {

using learn::LearnInput;
using learn::LearnOptions;

float uniform(std::uint64_t i) {
    return unit_float(std::uint32_t(mix64(i * 0x9e3779b97f4a7c15ull + 5) >> 32));
}

/// Vertices in paths of one vertex each, with a radiance of their own.
struct Surface {
    std::vector<float> p, wo, L;
    std::vector<std::int16_t> ns;

    void add(const Point3f& at, const Vector3f& n, const Spectrum& radiance) {
        p.insert(p.end(), {at.x, at.y, at.z});
        wo.insert(wo.end(), {n.x, n.y, n.z});
        L.insert(L.end(), {radiance.r, radiance.g, radiance.b});
        const auto code = octahedral_from_unit(n.x, n.y, n.z);
        ns.insert(ns.end(), code.begin(), code.end());
    }
    LearnInput input(std::uint32_t k, float reflectance = 0.5f) const {
        const std::size_t n = p.size() / 3;
        LearnInput in;
        PathGraph& g = in.graph;
        std::vector<std::uint64_t> first(n + 1);
        std::iota(first.begin(), first.end(), std::uint64_t{0});
        g.paths.first_vertex = std::move(first);
        g.vertices.p = p;
        g.vertices.wo = wo;
        g.vertices.ns = ns;
        g.vertices.material = std::vector<std::uint16_t>(n);
        g.vertices.flags = std::vector<std::uint16_t>(n, flags_with_ending(0, Ending::max_depth));
        auto& m = g.materials;
        m.id = {"paint"};
        for (auto* bytes : {&m.kind, &m.distribution, &m.nonlinear, &m.sample_visible, &m.textured})
            *bytes = std::vector<std::uint8_t>{0};
        m.two_sided = std::vector<std::uint8_t>{1};
        for (auto* one : {&m.int_ior, &m.ext_ior, &m.opacity, &m.exponent}) *one = std::vector<float>{1};
        m.alpha = std::vector<float>{0.1f, 0.1f};
        m.diffuse = std::vector<float>(3, reflectance);
        for (auto* rgb : {&m.specular, &m.transmittance, &m.eta_c, &m.k_c}) *rgb = std::vector<float>(3, 1);
        for (auto* zero : {&m.fdr_int, &m.fdr_ext}) *zero = std::vector<float>{0};
        cluster::ClusterOptions options;
        options.k = k;
        in.clusters = cluster::make_clusters(g, options);
        in.radiance.settings.start = "paths";
        in.radiance.L = L;
        in.graph_id = {"g.h5", "0123456789abcdef"};
        return in;
    }
};

std::vector<LearnInput> inputs_of(LearnInput input) {
    std::vector<LearnInput> inputs;
    inputs.push_back(std::move(input));
    return inputs;
}

CacheQuery query(const Point3f& p, const Normal3f& n, float reflectance = 0.5f) {
    return {p, n, Vector3f(n), INFINITY, Spectrum(reflectance)};
}

/// Radiance over the unit square.
Spectrum gradient(float x, float y) {
    return {1 + x, 2 - y, 1 + 0.5f * (x + y)};
}

Surface plane(std::size_t n) {
    Surface s;
    for (std::size_t i = 0; i < n; ++i) {
        const float x = uniform(2 * i), y = uniform(2 * i + 1);
        s.add({x, y, 0}, {0, 0, 1}, gradient(x, y));
    }
    return s;
}

// Detected mutation: held-back vertices learnt.
TEST(RadianceCache, APlaneOfKnownGradientIsReadBack) {
    const auto inputs = inputs_of(plane(200'000).input(32));
    const auto reader = make_cache_reader(learn::learn(inputs, {}));
    std::vector<CacheQuery> queries;
    for (std::uint64_t i = 0; i < 5000; ++i)
        queries.push_back(
            query({0.02f + 0.96f * uniform(900'000 + 2 * i), 0.02f + 0.96f * uniform(900'001 + 2 * i), 0}, {0, 0, 1}));
    std::vector<CacheAnswer> answers(queries.size());
    reader->answer(queries, answers);
    double worst = 0;
    std::size_t far = 0;
    for (std::size_t i = 0; i < queries.size(); ++i) {
        const Spectrum expected = gradient(queries[i].p.x, queries[i].p.y);
        for (int c = 0; c < 3; ++c) worst = std::max(worst, std::abs(double(answers[i].L[c]) / expected[c] - 1));
        far += answers[i].is_far;
    }
    EXPECT_LT(worst, 0.01);
    EXPECT_LT(far, queries.size() / 50);
    // Held back: 1 % of the vertices, none of which is in a mean.
    const RadianceCache& cache = reader->cache();
    EXPECT_EQ(cache.settings.samples + cache.validation.vertices[0], 200'000u);
    EXPECT_NEAR(double(cache.validation.vertices[0]), 2000, 5 * std::sqrt(2000));
    EXPECT_LT(cache.validation.relative_l2[0], 1e-4);
    EXPECT_NEAR(cache.validation.mean_ratio[0], 1, 1e-3);
    EXPECT_GT(cache.metric.median_distance, 0.1);
    EXPECT_LT(cache.metric.median_distance, 1);
    // A texture's reflectance is put back in.
    std::vector<CacheQuery> darker{query({0.5f, 0.5f, 0}, {0, 0, 1}, 0.05f)};
    reader->answer(darker, answers);
    EXPECT_NEAR(answers[0].L.r, 0.15f, 0.0015f);
}

// The mean of one vertex has no spread; that of many equals the textbook's.
TEST(RadianceCache, PointsAreMeansOfClusters) {
    const LearnInput input = plane(3000).input(16);
    const auto inputs = inputs_of(plane(3000).input(16));
    const RadianceCache cache = learn::learn(inputs, {});
    std::size_t row = 0;
    for (std::size_t c = 0; c < input.clusters.n_clusters(); ++c) {
        std::vector<double> L, x;
        for (std::uint32_t i = input.clusters.first[c]; i < input.clusters.first[c + 1]; ++i) {
            const std::uint32_t j = input.clusters.member[i];
            if (learn::is_held_back(0, 0, j)) continue;
            L.push_back(double(input.radiance.L[3 * j]) / 0.5);
            x.push_back(double(input.graph.vertices.p[3 * j]));
        }
        if (L.empty()) continue;
        const auto n = double(L.size());
        const double mean = std::accumulate(L.begin(), L.end(), 0.0) / n;
        double square = 0;
        for (const double l : L) square += sqr(l - mean);
        ASSERT_EQ(cache.points.members[row], L.size());
        EXPECT_NEAR(cache.points.E[3 * row], mean, 1e-5 * mean);
        EXPECT_NEAR(cache.points.p[3 * row], std::accumulate(x.begin(), x.end(), 0.0) / n, 1e-6);
        EXPECT_NEAR(cache.points.var[3 * row], n > 1 ? square / (n * (n - 1)) : 0, 1e-4 * square + 1e-12);
        ++row;
    }
    EXPECT_EQ(row, cache.n_points());
}

// Detected mutations: the number of members left out of the weights; no normal in the metric.
TEST(RadianceCache, TheTreeFindsWhatBruteForceFinds) {
    RadianceCache cache;
    cache.metric = {3, 0.2f, 0.5f};
    std::vector<float> p, E;
    std::vector<std::int16_t> n;
    std::vector<std::uint16_t> members;
    constexpr std::size_t n_points = 700;
    for (std::uint64_t i = 0; i < n_points; ++i) {
        for (std::uint64_t c = 0; c < 3; ++c) p.push_back(uniform(10 * i + c)), E.push_back(uniform(10 * i + 3 + c));
        const Vector3f v = normalize(Vector3f{uniform(10 * i + 6) - 0.5f, uniform(10 * i + 7) - 0.5f, 0.1f});
        const auto code = octahedral_from_unit(v.x, v.y, v.z);
        n.insert(n.end(), code.begin(), code.end());
        members.push_back(std::uint16_t(1 + i % 60));
    }
    cache.points.p = p, cache.points.n = n, cache.points.E = E, cache.points.members = members;
    cache.points.var = std::vector<float>(E.size());
    const auto reader = make_cache_reader(std::move(cache));
    std::vector<CacheQuery> queries;
    for (std::uint64_t i = 0; i < 500; ++i)
        queries.push_back(query({uniform(77'000 + 5 * i), uniform(77'001 + 5 * i), 1.5f * uniform(77'002 + 5 * i)},
                                normalize(Normal3f{uniform(77'003 + 5 * i) - 0.5f, uniform(77'004 + 5 * i), 0.2f})));
    std::vector<CacheAnswer> answers(queries.size());
    reader->answer(queries, answers);
    std::size_t n_far = 0;
    for (std::size_t q = 0; q < queries.size(); ++q) {
        const auto distances_from = [&](const std::array<double, 3>& at, const std::array<double, 3>& along) {
            std::vector<std::pair<double, std::size_t>> by_distance;
            for (std::size_t i = 0; i < n_points; ++i) {
                const auto normal = unit_from_octahedral(n[2 * i], n[2 * i + 1]);
                double d2 = 0;
                for (std::size_t c = 0; c < 3; ++c)
                    d2 += sqr((double(p[3 * i + c]) - at[c]) / 0.2) + sqr(3 * (double(normal[c]) - along[c]));
                by_distance.emplace_back(d2, i);
            }
            return by_distance;
        };
        const CacheQuery& asked = queries[q];
        const auto of_query = distances_from({asked.p.x, asked.p.y, asked.p.z}, {asked.n.x, asked.n.y, asked.n.z});
        const auto [first, nearest] = *std::min_element(of_query.begin(), of_query.end());
        const auto normal = unit_from_octahedral(n[2 * nearest], n[2 * nearest + 1]);
        auto of_nearest =
            distances_from({p[3 * nearest], p[3 * nearest + 1], p[3 * nearest + 2]}, {normal[0], normal[1], normal[2]});
        std::sort(of_nearest.begin(), of_nearest.end());
        double sum = 0, weights = 0;
        for (std::size_t m = 0; m < PointCache::neighbours; ++m) {
            const std::size_t i = of_nearest[m].second;
            const double w = members[i] / (of_query[i].first + first);
            sum += w * double(E[3 * i]), weights += w;
        }
        EXPECT_NEAR(answers[q].L.r, sum / weights, 1e-4);  // not demodulated
        EXPECT_NEAR(answers[q].distance, std::sqrt(first), 1e-4);
        EXPECT_EQ(answers[q].is_far, answers[q].distance > 1.5f);
        n_far += answers[q].is_far;
    }
    EXPECT_GT(n_far, 10u);
    EXPECT_LT(n_far, 490u);
}

// Detected mutation: no normal in the metric.
TEST(RadianceCache, ASheetLitOnOneSideDoesNotLeak) {
    Surface s;
    for (std::size_t i = 0; i < 20'000; ++i) {
        const float x = uniform(2 * i), y = uniform(2 * i + 1);
        s.add({x, y, 1e-4f}, {0, 0, 1}, Spectrum(1));
        s.add({x, y, -1e-4f}, {0, 0, -1}, Spectrum(0));
    }
    const auto inputs = inputs_of(s.input(32));
    const auto reader = make_cache_reader(learn::learn(inputs, {}));
    for (const float side : {1.0f, -1.0f}) {
        std::vector<CacheQuery> queries;
        for (std::uint64_t i = 0; i < 1000; ++i)
            queries.push_back(query({uniform(500'000 + 2 * i), uniform(500'001 + 2 * i), side * 1e-4f}, {0, 0, side}));
        std::vector<CacheAnswer> answers(queries.size());
        reader->answer(queries, answers);
        double mean = 0;
        for (const CacheAnswer& answer : answers) mean += double(answer.L.r) / 1000;
        EXPECT_NEAR(mean, side > 0 ? 1 : 0, 0.01) << side;
    }
}

// Detected mutation: such radiance learnt.
TEST(RadianceCache, RadianceThatIsNotFiniteIsCountedNotLearnt) {
    Surface s = plane(4000);
    std::uint64_t n = 0;
    for (std::size_t j = 0; j < 4000; j += 100) {
        s.L[3 * j + 1] = j % 200 == 0 ? std::numeric_limits<float>::quiet_NaN() : INFINITY;
        n += !learn::is_held_back(0, 0, j);
    }
    const auto inputs = inputs_of(s.input(16));
    const RadianceCache cache = learn::learn(inputs, {});
    EXPECT_EQ(cache.settings.nonfinite, n);
    EXPECT_TRUE(std::all_of(cache.points.E.begin(), cache.points.E.end(), [](float e) { return std::isfinite(e); }));
    EXPECT_TRUE(std::isfinite(cache.validation.relative_l2[0]));
    EXPECT_LT(cache.validation.relative_l2[0], 1e-3);
}

TEST(RadianceCache, IsTheSameForAnyNumberOfThreads) {
    const auto inputs = inputs_of(plane(30'000).input(16));
    LearnOptions one;
    one.threads = 1;
    const RadianceCache a = learn::learn(inputs, one), b = learn::learn(inputs, {});
    const auto same = [](const auto& x, const auto& y) {
        return x.size() == y.size() && std::equal(x.begin(), x.end(), y.begin());
    };
    EXPECT_TRUE(same(a.points.E, b.points.E) && same(a.points.p, b.points.p) && same(a.points.var, b.points.var));
    EXPECT_EQ(a.metric.median_distance, b.metric.median_distance);
    EXPECT_EQ(a.validation.relative_l2[0], b.validation.relative_l2[0]);
}

// Of a glossy sheet first hits look along its normal, deeper vertices along it.
TEST(RadianceCache, GlossySurfacesAreLearntFromFirstHits) {
    Surface s;
    for (std::size_t i = 0; i < 8000; ++i)
        s.add({uniform(2 * i), uniform(2 * i + 1), 0}, {0, 0, 1}, Spectrum(i % 2 ? 5 : 1));
    const auto learnt = [&](BsdfKind kind, const char* start) {
        LearnInput input = s.input(32);
        std::vector<std::uint64_t> first;
        for (std::uint64_t j = 0; j <= 8000; j += 2) first.push_back(j);
        input.graph.paths.first_vertex = first;
        input.graph.materials.kind = std::vector<std::uint8_t>{std::uint8_t(kind)};
        input.radiance.settings.start = start;
        const RadianceCache cache = learn::learn(inputs_of(std::move(input)), {});
        double mean = 0;
        for (std::size_t i = 0; i < cache.n_points(); ++i)
            mean += double(cache.points.E[3 * i]) / double(cache.n_points());
        return mean * (kind == BsdfKind::diffuse ? 0.5 : 1);
    };
    EXPECT_NEAR(learnt(BsdfKind::diffuse, "paths"), 3, 0.2);
    EXPECT_NEAR(learnt(BsdfKind::diffuse, "zero"), 1, 1e-4);
    const double glossy = learnt(BsdfKind::phong, "paths");
    EXPECT_NEAR(learnt(BsdfKind::phong, "zero"), glossy, 1e-6);
}

}  // namespace
}  // namespace loom
