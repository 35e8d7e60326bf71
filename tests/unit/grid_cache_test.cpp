// A radiance cache of method grid: what is stored is what is read, learnt from graphs of small scenes.
//
// Detected: a NaN label that is learnt, other bytes with more threads, reflectance multiplied in but not divided out,
// directions that do not reach the network, queries outside of the vertices that are not reported.

#include "stages/core/cache/grid_cache.h"

#include <gtest/gtest.h>
#include <tbb/global_control.h>

#include <cmath>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <random>
#include <string>

#include "formats/io/content_hash.h"
#include "formats/io/error.h"
#include "stages/core/graph/graph_reader.h"
#include "stages/learn/grid.h"
#include "tests/traced_graph.h"

namespace loom::learn {
namespace {

using namespace loom::testing;

/// A network of parameters of the order of 1, with all inputs.
neural::Network random_network(const GridInputs& inputs) {
    std::mt19937 random(1);
    std::uniform_real_distribution<float> uniform(-1, 1);
    neural::Network network;
    network.shape = {neural::grid_levels(4, 9, 4, 1.7), inputs.size()};
    network.features.resize(neural::n_features * network.shape.n_entries());
    for (float& x : network.features) x = uniform(random);
    std::vector<float> rows(neural::n_weights(network.shape.n_inputs()));
    for (float& w : rows) w = 0.4f * uniform(random);
    network.weights = weights_of_rows(network.shape, rows.data());
    return network;
}

RadianceCache random_cache(bool directional) {
    RadianceCache cache;
    cache.settings.method = "grid";
    cache.domain = {{-1, 2, 0.5f}, 4};
    cache.demodulated = 1;
    const GridInputs inputs(directional);
    store_network(random_network(inputs), inputs, cache);
    return cache;
}

RadianceCache written_and_read(const RadianceCache& cache) {
    const auto file = scratch_file(".h5");
    write_radiance_cache(cache, file, Sync::no);
    RadianceCache read = read_radiance_cache(file);
    std::filesystem::remove(file);
    return read;
}

CacheQuery query_at(float x, float y, float z) {
    CacheQuery query;
    query.p = {x, y, z};
    query.n = Normal3f(0, 0.6f, 0.8f);
    query.wo = Vector3f(0.48f, 0.6f, 0.64f);
    query.roughness = 0.25f;
    query.reflectance = {0.5f, 0.004f, 0.25f};
    return query;
}

TEST(GridCache, a_stored_network_answers_as_before) {
    for (const bool directional : {false, true}) {
        const RadianceCache cache = written_and_read(random_cache(directional));
        EXPECT_EQ(cache.problem(), "");
        const GridInputs inputs(directional);
        const neural::Network network = random_network(inputs);
        EXPECT_EQ(network_of(cache).features, network.features);
        EXPECT_EQ(network_of(cache).weights, network.weights);

        std::vector<CacheQuery> queries;
        for (int i = 0; i < 150; ++i) queries.push_back(query_at(-1 + 0.02f * float(i), 3, 1.5f));
        std::vector<CacheAnswer> answers(queries.size());
        make_cache_reader(written_and_read(random_cache(directional)))->answer(queries, answers);
        neural::NetworkReader reader(network);
        int positive = 0;
        for (std::size_t i = 0; i < queries.size(); ++i) {
            const auto in = reader.input();
            for (int axis = 0; axis < 3; ++axis)
                in.position[axis][0] = (queries[i].p[axis] - cache.domain.lo[std::size_t(axis)]) * 0.25f;
            inputs.fill(queries[i], in.extra(0));
            const float(*y)[4] = reader.evaluate(1);
            const float divisor[3] = {0.5f, 0.01f, 0.25f};  // reflectance, at least 0.01
            for (int c = 0; c < 3; ++c) {
                EXPECT_EQ(answers[i].L[c], std::max(y[0][c], 0.0f) * divisor[c]) << i;
                positive += y[0][c] > 0;
            }
            EXPECT_FALSE(answers[i].is_far);
        }
        EXPECT_GT(positive, 50);
    }
}

TEST(GridCache, directional_inputs_are_harmonics_of_the_reflected_direction) {
    const CacheQuery query = query_at(0, 0, 0);
    float x[16];
    GridInputs(true).fill(query, x);
    const double cos = 0.6 * 0.6 + 0.8 * 0.64;
    const double r[3] = {-0.48, 2 * cos * 0.6 - 0.6, 2 * cos * 0.8 - 0.64}, part = 0.75;
    const double expected[16] = {0,
                                 0.6,
                                 0.8,
                                 part * r[0],
                                 part * r[1],
                                 part * r[2],
                                 part * r[0] * r[1],
                                 part * r[1] * r[2],
                                 part * r[2] * r[0],
                                 part * (r[0] * r[0] - r[1] * r[1]),
                                 part * (1.5 * r[2] * r[2] - 0.5),
                                 cos,
                                 0.5,
                                 double(0.004f),
                                 0.25,
                                 1};
    for (int i = 0; i < 16; ++i) EXPECT_NEAR(double(x[i]), expected[i], 1e-6) << i;
    EXPECT_EQ(GridInputs(true).names(2).size(), 4u + 16u);
    EXPECT_EQ(GridInputs(false).names(2).size(), 4u + 7u);
}

TEST(GridCache, refuses_what_this_build_cannot_evaluate) {
    const auto refused = [](const auto& change) {
        RadianceCache cache = random_cache(true);
        change(cache);
        try {
            make_cache_reader(std::move(cache));
        } catch (const InputError& error) {
            return std::string(error.what());
        }
        return std::string("accepted");
    };
    EXPECT_EQ(refused([](RadianceCache&) {}), "accepted");
    EXPECT_NE(refused([](RadianceCache& c) { c.inputs[9] = "time"; }).find("inputs:"), std::string::npos);
    EXPECT_NE(refused([](RadianceCache& c) {
                  c.mlp.rows = std::vector<std::uint32_t>{64, 3};
              }).find("mlp/rows:"),
              std::string::npos);
    EXPECT_NE(refused([](RadianceCache& c) {
                  c.grid.resolution = std::vector<std::uint32_t>{4, 6, 11, 1u << 21};
              }).find("grid/resolution:"),
              std::string::npos);
    EXPECT_NE(refused([](RadianceCache& c) {
                  auto first = std::vector<std::uint32_t>(c.grid.first.begin(), c.grid.first.end());
                  --first[4];
                  c.grid.first = std::move(first);
              }).find("grid/first:"),
              std::string::npos);
}

/// A graph of a scene with what is made of it.
LearnInput learn_input(const std::string& scene, int size, std::uint64_t spp) {
    LearnInput in;
    const auto loaded = own_scene(scene, size, size);
    in.graph = trace_graph(*loaded, path_options(*loaded, 3), spp);
    in.clusters = clusters_of(in.graph, 16);
    in.radiance = radiance_of(in.graph, in.clusters);
    in.graph_id = {"graph.h5", "0123456789abcdef"};
    return in;
}

LearnOptions grid_options(std::uint64_t samples, int threads = 0) {
    LearnOptions options;
    options.method = Method::grid;
    options.samples = samples;
    options.threads = threads;
    return options;
}

std::string hash_of(const RadianceCache& cache) {
    const auto file = scratch_file(".h5");
    write_radiance_cache(cache, file, Sync::no);
    const std::string hash = identify(file).hash;
    std::filesystem::remove(file);
    return hash;
}

TEST(GridCache, threads_give_the_same_file) {
    const tbb::global_control allow(tbb::global_control::max_allowed_parallelism, 8);  // also on fewer cores
    std::vector<LearnInput> inputs;
    inputs.push_back(learn_input("glossy-box.xml", 24, 4));
    const std::string one = hash_of(learn(inputs, grid_options(100'000, 1)));
    EXPECT_EQ(one, hash_of(learn(inputs, grid_options(100'000, 2))));
    EXPECT_EQ(one, hash_of(learn(inputs, grid_options(100'000, 8))));
    LearnOptions other = grid_options(100'000);
    other.seed = 1;
    EXPECT_NE(one, hash_of(learn(inputs, other)));
}

TEST(GridCache, a_scene_switches_on_what_it_needs) {
    std::vector<LearnInput> diffuse, textured, glossy;
    diffuse.push_back(learn_input("cornell-box.xml", 16, 2));
    textured.push_back(learn_input("textured.xml", 16, 2));
    glossy.push_back(learn_input("glossy-box.xml", 16, 2));
    const RadianceCache a = learn(diffuse, grid_options(1)), b = learn(textured, grid_options(1)),
                        c = learn(glossy, grid_options(1));
    EXPECT_EQ(a.inputs.size(), 16u + 7u);
    EXPECT_EQ(a.demodulated, 0);
    EXPECT_EQ(b.demodulated, 1);
    EXPECT_EQ(c.inputs.size(), 16u + 16u);
    EXPECT_EQ(c.demodulated, 0);
    EXPECT_EQ(a.settings.samples, 16384u);
    EXPECT_EQ(a.settings.batches, 1u);
}

TEST(GridCache, labels_that_are_not_finite_are_counted_and_not_learnt) {
    std::vector<LearnInput> inputs;
    inputs.push_back(learn_input("cornell-box.xml", 16, 4));
    LearnInput& in = inputs[0];
    std::vector<float> L(in.radiance.L.begin(), in.radiance.L.end());
    std::uint64_t bad = 0;
    const LearnOptions options = grid_options(40'000);
    const PreferredVertices preferred(in);
    const GraphReader reader(in.graph);
    for (std::size_t j = 0; j < in.graph.n_vertices(); j += 7) {
        L[3 * j + j % 3] = j % 2 ? NAN : INFINITY;
        const Bsdf<float> bsdf = reader.bsdf(j);
        bad += is_cached(bsdf, options.smallest_roughness) && preferred(j, bsdf) && !is_held_back(options.seed, 0, j);
    }
    in.radiance.L = std::move(L);
    const RadianceCache cache = learn(inputs, options);
    EXPECT_GT(bad, 50u);
    EXPECT_EQ(cache.settings.nonfinite, bad);
    for (const float f : cache.grid.features) ASSERT_TRUE(std::isfinite(f));
    for (const float w : cache.mlp.weight) ASSERT_TRUE(std::isfinite(w));
    EXPECT_LT(cache.training.loss[cache.training.loss.size() - 1], cache.training.loss[0]);
}

TEST(GridCache, queries_away_from_the_vertices_are_far) {
    std::vector<LearnInput> inputs;
    inputs.push_back(learn_input("cornell-box.xml", 24, 8));
    const auto reader = make_cache_reader(learn(inputs, grid_options(40'000)));
    const GraphReader graph(inputs[0].graph);
    std::vector<CacheQuery> queries;
    for (std::size_t path = 0; path < 400; ++path) {
        const std::size_t j = inputs[0].graph.paths.first_vertex[path];
        if (j < inputs[0].graph.paths.first_vertex[path + 1]) queries.push_back(cache_query(graph.vertex(j)));
    }
    std::vector<CacheAnswer> answers(queries.size());
    reader->answer(queries, answers);
    int far = 0;
    for (const CacheAnswer& answer : answers) far += answer.is_far;
    EXPECT_LT(far, int(queries.size()) / 20);
    // In the air, between surfaces; and outside of the box.
    const auto& domain = reader->cache().domain;
    for (CacheQuery& query : queries) query.p = query.p + Vector3f(query.n) * (0.2f * domain.size);
    reader->answer(queries, answers);
    far = 0;
    for (const CacheAnswer& answer : answers) far += answer.is_far;
    EXPECT_GT(far, int(queries.size()) * 9 / 10);
    for (CacheQuery& query : queries) query.p = query.p + Vector3f(10 * domain.size, 0, 0);
    reader->answer(queries, answers);
    for (const CacheAnswer& answer : answers) EXPECT_TRUE(answer.is_far);
}

// Held-back vertices are as good as those that were learnt, by material: what is read is what was learnt.
TEST(GridCache, held_back_vertices_are_predicted) {
    for (const char* scene : {"cornell-box.xml", "textured.xml", "glossy-box.xml"}) {
        std::vector<LearnInput> inputs;
        inputs.push_back(learn_input(scene, 64, 8));
        const RadianceCache cache = learn(inputs, grid_options(1'500'000));
        double error = 0, n = 0;
        for (std::size_t i = 0; i < cache.validation.material.size(); ++i) {
            error += cache.validation.relative_l2[i] * double(cache.validation.vertices[i]);
            n += double(cache.validation.vertices[i]);
        }
        EXPECT_GT(n, 100) << scene;
        EXPECT_LT(error / n, 0.05) << scene;
    }
}

}  // namespace
}  // namespace loom::learn
