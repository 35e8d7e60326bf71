// The hash grid and its MLP against an obvious twin in double, written from the formulas alone, and finite differences;
// bytes at every x86-64 level and for any number of threads; a known field is learnt.
//
// Mutations that fail here: a hash without the prime of z (the gradient by a feature is off by 100 % of the largest); a
// gradient that does not hold y of the denominator (100 %); weight gradients summed by thread instead of by chunk (other
// bytes with more threads).

#include "stages/core/neural/network.h"

#include <gtest/gtest.h>
#include <tbb/global_control.h>

#include <cmath>
#include <cstring>
#include <random>
#include <string>
#include <utility>
#include <vector>

#include "stages/learn/train.h"

namespace loom::learn {
namespace {

using namespace neural;

/// Kernels of every level that this processor has.
std::vector<std::pair<std::string, NeuralKernels>> all_kernels() {
    std::vector<std::pair<std::string, NeuralKernels>> all = {{"v2", LOOM_NEURAL_KERNELS_OF(v2)}};
    if (__builtin_cpu_supports("x86-64-v3")) all.emplace_back("v3", LOOM_NEURAL_KERNELS_OF(v3));
    if (__builtin_cpu_supports("x86-64-v4")) all.emplace_back("v4", LOOM_NEURAL_KERNELS_OF(v4));
    return all;
}

/// Four levels, of which the last two are hashed with many collisions.
NetworkShape small_shape(int n_extra) {
    return {grid_levels(4, 9, 4, 1.7), n_extra};
}

/// A network whose parameters are all of the order of 1.
Network random_network(const NetworkShape& shape, unsigned seed) {
    std::mt19937 random(seed);
    std::uniform_real_distribution<float> uniform(-1, 1);
    Network network;
    network.shape = shape;
    for (std::size_t i = 0; i < n_features * shape.n_entries(); ++i) network.features.push_back(uniform(random));
    std::vector<float> rows(n_weights(shape.n_inputs()));
    for (float& w : rows) w = 0.4f * uniform(random);
    network.weights = weights_of_rows(shape, rows.data());
    return network;
}

TrainingRows random_rows(std::size_t n, int n_extra, unsigned seed) {
    std::mt19937 random(seed);
    std::uniform_real_distribution<float> uniform;
    TrainingRows rows(n, n_extra);
    for (std::size_t i = 0; i < n; ++i)
        for (float& x : rows[i]) x = uniform(random);
    return rows;
}

/// Twin of a network: one sample at a time, in double.
struct Twin {
    struct Corner {
        std::size_t entry;
        double weight;
    };
    struct Values {
        std::vector<std::vector<Corner>> corners;  // [level]
        std::vector<double> x, h1, h2;
        std::array<double, 3> y;
    };

    NetworkShape shape;
    std::vector<double> features, first, second, third;  // weights row-major, [output][input]

    explicit Twin(const Network& n) : shape(n.shape), features(n.features.begin(), n.features.end()) {
        const std::vector<float> rows = rows_of_weights(n);
        const auto end_first = rows.begin() + 64 * shape.n_inputs(), end_second = end_first + 64 * 64;
        first.assign(rows.begin(), end_first);
        second.assign(end_first, end_second);
        third.assign(end_second, rows.end());
    }

    std::vector<Corner> corners(std::size_t level, std::span<const float> position) const {
        std::size_t offset = 0;
        for (std::size_t l = 0; l < level; ++l) offset += shape.levels[l].n_entries;
        const GridLevel& g = shape.levels[level];
        const double n = double(g.resolution);
        std::array<std::uint64_t, 3> cell;
        std::array<double, 3> part;
        for (std::size_t a = 0; a < 3; ++a) {
            // The float product decides in which cell a position lies.
            const double u = double(std::clamp(position[a], 0.0f, 1.0f) * float(n));
            cell[a] = std::uint64_t(std::min(std::floor(u), n - 1));
            part[a] = u - double(cell[a]);
        }
        std::vector<Corner> all;
        for (std::uint64_t dz = 0; dz < 2; ++dz)
            for (std::uint64_t dy = 0; dy < 2; ++dy)
                for (std::uint64_t dx = 0; dx < 2; ++dx) {
                    const std::uint64_t x = cell[0] + dx, y = cell[1] + dy, z = cell[2] + dz, side = g.resolution + 1;
                    const bool all_points = side * side * side <= g.n_entries;
                    const std::uint64_t index =
                        all_points ? x + side * (y + side * z)
                                   : (x ^ (y * 2654435761ull) ^ (z * 805459861ull)) % 4294967296ull % g.n_entries;
                    all.push_back({offset + index, (dx ? part[0] : 1 - part[0]) * (dy ? part[1] : 1 - part[1]) *
                                                       (dz ? part[2] : 1 - part[2])});
                }
        return all;
    }

    /// in:      row  position, label, other inputs
    Values evaluate(std::span<const float> row) const {
        Values v;
        for (std::size_t level = 0; level < shape.levels.size(); ++level) {
            v.corners.push_back(corners(level, row));
            for (std::size_t f = 0; f < 2; ++f) {
                double sum = 0;
                for (const Corner& c : v.corners.back()) sum += c.weight * features[2 * c.entry + f];
                v.x.push_back(sum);
            }
        }
        for (const float extra : row.subspan(6)) v.x.push_back(double(extra));
        const auto layer = [](const std::vector<double>& w, const std::vector<double>& in, std::size_t n, bool relu) {
            std::vector<double> out(n);
            for (std::size_t o = 0; o < n; ++o) {
                for (std::size_t k = 0; k < in.size(); ++k) out[o] += w[o * in.size() + k] * in[k];
                if (relu) out[o] = std::max(out[o], 0.0);
            }
            return out;
        };
        v.h1 = layer(first, v.x, 64, true);
        v.h2 = layer(second, v.h1, 64, true);
        const std::vector<double> y = layer(third, v.h2, 3, false);
        std::copy(y.begin(), y.end(), v.y.begin());
        return v;
    }

    /// Loss of one sample whose denominator has the values `held`.
    static double loss(const std::array<double, 3>& y, const std::array<double, 3>& held, std::span<const float> row) {
        double sum = 0;
        for (std::size_t c = 0; c < 3; ++c) sum += std::pow(y[c] - double(row[3 + c]), 2) / (held[c] * held[c] + 0.01);
        return sum;
    }

    struct Gradient {
        double loss = 0;
        std::vector<double> features, first, second, third;
    };

    /// Sum of the gradients of all rows, each component of dy limited to +-limit; mean loss.
    Gradient gradient(const TrainingRows& rows, double limit) const {
        Gradient g{0, std::vector<double>(features.size()), std::vector<double>(first.size()),
                   std::vector<double>(second.size()), std::vector<double>(third.size())};
        const std::size_t n_in = std::size_t(shape.n_inputs());
        for (std::size_t i = 0; i < rows.size(); ++i) {
            const Values v = evaluate(rows[i]);
            g.loss += loss(v.y, v.y, rows[i]) / double(rows.size());
            std::vector<double> d2(64), d1(64), dx(n_in);
            for (std::size_t c = 0; c < 3; ++c) {
                const double slope = 2 * (v.y[c] - double(rows[i][3 + c])) / (v.y[c] * v.y[c] + 0.01);
                const double dy = std::clamp(slope, -limit, limit);
                for (std::size_t k = 0; k < 64; ++k) {
                    g.third[c * 64 + k] += dy * v.h2[k];
                    d2[k] += dy * third[c * 64 + k];
                }
            }
            for (std::size_t o = 0; o < 64; ++o) {
                if (!(v.h2[o] > 0)) continue;
                for (std::size_t k = 0; k < 64; ++k) {
                    g.second[o * 64 + k] += d2[o] * v.h1[k];
                    d1[k] += d2[o] * second[o * 64 + k];
                }
            }
            for (std::size_t o = 0; o < 64; ++o) {
                if (!(v.h1[o] > 0)) continue;
                for (std::size_t k = 0; k < n_in; ++k) {
                    g.first[o * n_in + k] += d1[o] * v.x[k];
                    dx[k] += d1[o] * first[o * n_in + k];
                }
            }
            for (std::size_t level = 0; level < shape.levels.size(); ++level)
                for (const Corner& c : v.corners[level])
                    for (std::size_t f = 0; f < 2; ++f) g.features[2 * c.entry + f] += c.weight * dx[2 * level + f];
        }
        return g;
    }
};

/// Largest difference of two lists in units of the largest value.
template <class A, class B>
double difference(const A& a, const B& b) {
    EXPECT_EQ(a.size(), b.size());
    double most = 0, largest = 0;
    for (std::size_t i = 0; i < a.size(); ++i) {
        most = std::max(most, std::abs(double(a[i]) - double(b[i])));
        largest = std::max(largest, std::abs(double(b[i])));
    }
    return most / largest;
}

TEST(Network, evaluation_equals_a_twin_in_double) {
    for (const int n_extra : {0, 1, 5, 16}) {
        const Network network = random_network(small_shape(n_extra), 1);
        EXPECT_TRUE(network.shape.levels[3].hashed);
        EXPECT_FALSE(network.shape.levels[1].hashed);
        const Twin twin(network);
        TrainingRows rows = random_rows(tile_size, n_extra, 2);
        rows[0][0] = -0.5f, rows[1][1] = 1, rows[2][2] = 7, rows[3][0] = 0;  // on the border, and outside
        for (const auto& [level, kernels] : all_kernels()) {
            NetworkReader reader(network, kernels);
            const NetworkReader::Input in = reader.input();
            for (int i = 0; i < tile_size; ++i) {
                for (std::size_t a = 0; a < 3; ++a) in.position[a][i] = rows[std::size_t(i)][a];
                for (int k = 0; k < n_extra; ++k) in.extra(i)[k] = rows[std::size_t(i)][std::size_t(6 + k)];
            }
            const float(*y)[4] = reader.evaluate(tile_size);
            for (int i = 0; i < tile_size; ++i) {
                const auto expected = twin.evaluate(rows[std::size_t(i)]).y;
                for (std::size_t c = 0; c < 3; ++c)
                    EXPECT_NEAR(double(y[i][c]), expected[c], 1e-5) << level << " " << n_extra << " " << i;
            }
        }
    }
}

TEST(Network, samples_of_a_call_do_not_depend_on_each_other) {
    const Network network = random_network(small_shape(5), 3);
    const TrainingRows rows = random_rows(tile_size, 5, 4);
    const auto evaluate = [&](NetworkReader& reader, int first, int n) {
        const NetworkReader::Input in = reader.input();
        for (int i = 0; i < n; ++i) {
            const auto row = rows[std::size_t(first + i)];
            for (std::size_t a = 0; a < 3; ++a) in.position[a][i] = row[a];
            std::copy(row.begin() + 6, row.end(), in.extra(i));
        }
        const float(*y)[4] = reader.evaluate(n);
        std::vector<float> all;
        for (int i = 0; i < n; ++i) all.insert(all.end(), y[i], y[i] + 3);
        return all;
    };
    NetworkReader reader(network);
    const std::vector<float> together = evaluate(reader, 0, tile_size);
    std::vector<float> apart;
    for (int first = 0, n = 1; first < tile_size; first += n, n = std::min(n + 1, tile_size - first))
        for (const float y : evaluate(reader, first, n)) apart.push_back(y);
    EXPECT_EQ(together, apart);
}

TEST(Network, weights_survive_the_layout_of_the_file) {
    const NetworkShape shape = small_shape(3);
    const Network network = random_network(shape, 5);
    EXPECT_EQ(weights_of_rows(shape, rows_of_weights(network).data()), network.weights);
    EXPECT_EQ(network.padded_inputs(), 16);
}

struct Prepared {
    TrainingRows rows;
    Network network;
    Trainer::Gradients gradients;
};

/// Gradients after some steps: features of zero would leave the weights that they meet without a gradient.
Prepared prepared(const NeuralKernels& kernels, float limit) {
    TrainingPlan plan{.n_batches = 60, .seed = 9};
    plan.limit = limit;
    Prepared p{random_rows(512, 5, 6), {}, {}};
    Trainer trainer(p.rows, small_shape(5), plan, 2, kernels);
    for (int i = 0; i < 30; ++i) trainer.step();
    p.network = trainer.network();
    p.gradients = trainer.gradients();
    return p;
}

TEST(Network, gradients_equal_a_twin_in_double) {
    for (const float limit : {50.0f, 0.5f}) {
        for (const auto& [level, kernels] : all_kernels()) {
            const Prepared p = prepared(kernels, limit);
            const Twin::Gradient expected = Twin(p.network).gradient(p.rows, double(limit));
            const double copies = double(batch_size) / double(p.rows.size());
            Twin::Gradient found;
            Network as_network = p.network;
            as_network.weights = p.gradients.weights;
            const Twin rows(as_network);  // its weights as [output][input]
            const auto scaled = [&](const auto& values) {
                std::vector<double> all;
                for (const auto v : values) all.push_back(double(v) / copies);
                return all;
            };
            EXPECT_NEAR(p.gradients.loss, expected.loss, 1e-5 * expected.loss) << level;
            EXPECT_LT(difference(scaled(p.gradients.features), expected.features), 1e-5) << level;
            EXPECT_LT(difference(scaled(rows.first), expected.first), 1e-5) << level;
            EXPECT_LT(difference(scaled(rows.second), expected.second), 1e-5) << level;
            EXPECT_LT(difference(scaled(rows.third), expected.third), 1e-5) << level;
        }
    }
}

TEST(Network, gradients_equal_finite_differences) {
    const Prepared p = prepared(neural_kernels(), 1e6f);  // a limit that nothing reaches
    Network as_network = p.network;
    as_network.weights = p.gradients.weights;
    const Twin by(as_network);
    Twin twin(p.network);
    std::vector<std::array<double, 3>> held;
    for (std::size_t i = 0; i < p.rows.size(); ++i) held.push_back(twin.evaluate(p.rows[i]).y);
    const auto loss = [&] {
        double sum = 0;
        for (std::size_t i = 0; i < p.rows.size(); ++i)
            sum += Twin::loss(twin.evaluate(p.rows[i]).y, held[i], p.rows[i]);
        return sum;
    };
    std::mt19937 random(7);
    const double copies = double(batch_size) / double(p.rows.size());
    const auto compare = [&](const char* name, std::vector<double>& parameters, const auto& gradient) {
        double largest = 0;
        for (const auto g : gradient) largest = std::max(largest, std::abs(double(g)) / copies);
        ASSERT_GT(largest, 0) << name;
        for (int k = 0; k < 12; ++k) {
            const std::size_t i = random() % parameters.size();
            const double value = parameters[i], step = 1e-6;
            parameters[i] = value + step;
            const double above = loss();
            parameters[i] = value - step;
            const double below = loss();
            parameters[i] = value;
            EXPECT_NEAR(double(gradient[i]) / copies, (above - below) / (2 * step), 1e-4 * largest) << name << " " << i;
        }
    };
    compare("features", twin.features, p.gradients.features);
    compare("first", twin.first, by.first);
    compare("second", twin.second, by.second);
    compare("third", twin.third, by.third);
}

TEST(Training, levels_and_threads_give_the_same_bytes) {
    const tbb::global_control allow(tbb::global_control::max_allowed_parallelism, 8);  // also on fewer cores
    const TrainingRows rows = random_rows(40000, 5, 10);
    const auto trained = [&](const NeuralKernels& kernels, int threads) {
        Trainer trainer(rows, {grid_levels(8, 12, 16, 1.6), 5}, {.n_batches = 12, .seed = 1}, threads, kernels);
        for (int i = 0; i < 12; ++i) trainer.step();
        return trainer.network();
    };
    const Network one = trained(all_kernels()[0].second, 1);
    for (const auto& [level, kernels] : all_kernels())
        for (const int threads : {1, 2, 8}) {
            const Network other = trained(kernels, threads);
            EXPECT_TRUE(one.features == other.features) << level << " " << threads;
            EXPECT_TRUE(one.weights == other.weights) << level << " " << threads;
        }
}

TEST(Training, order_is_a_permutation) {
    const std::vector<std::uint32_t> place = shuffled_places(1000, 1);
    std::vector<std::uint32_t> sorted = place;
    std::sort(sorted.begin(), sorted.end());
    double correlation = 0;
    for (std::uint32_t i = 0; i < 1000; ++i) {
        EXPECT_EQ(sorted[i], i);
        correlation += (i - 499.5) * (place[i] - 499.5) / (1000 * 1000 * 1000 / 12.0);
    }
    EXPECT_LT(std::abs(correlation), 0.13);  // 4 standard deviations
    EXPECT_NE(place, shuffled_places(1000, 2));
}

TEST(Training, rate_is_constant_and_then_falls) {
    const TrainingPlan plan{.n_batches = 1000};
    EXPECT_EQ(rate_factor(plan, 0), 1);
    EXPECT_EQ(rate_factor(plan, 400), 1);
    EXPECT_NEAR(rate_factor(plan, 700), std::sqrt(0.02f), 1e-5f);
    EXPECT_NEAR(rate_factor(plan, 1000), 0.02f, 1e-6f);
}

// Plane z = 0.3 with a smooth gradient, and a step at x = 0.4; a second plane above it, 0.02 away, emits ten times less.
TEST(Training, a_known_field_is_learnt) {
    const auto field = [](float x, float y, bool upper) {
        const float base = 0.2f + 0.5f * x + 0.3f * y * y, step = x < 0.4f ? 1 : 0.5f;
        return (upper ? 0.1f : 1.0f) * base * step;
    };
    std::mt19937 random(11);
    std::uniform_real_distribution<float> uniform;
    const auto fill = [&](TrainingRows& rows) {
        for (std::size_t i = 0; i < rows.size(); ++i) {
            const std::span<float> row = rows[i];
            const bool upper = i % 2;
            row[0] = uniform(random), row[1] = uniform(random), row[2] = upper ? 0.32f : 0.3f;
            for (std::size_t c = 0; c < 3; ++c) row[3 + c] = field(row[0], row[1], upper) * (1 + float(c));
            row[6] = 1;
        }
    };
    TrainingRows rows(1000000, 1), fresh(20000, 1);
    fill(rows), fill(fresh);
    Trainer trainer(rows, {grid_levels(8, 17, 16, 1.6), 1}, {.n_batches = 120, .seed = 2}, 0);
    double first_loss = trainer.step(), last_loss = 0;
    while (trainer.n_steps() < 120) last_loss = trainer.step();
    NetworkReader reader(trainer.network());
    double far = 0, near = 0;
    int n_far = 0, n_near = 0;
    for (std::size_t i = 0; i < fresh.size(); ++i) {
        const auto row = fresh[i];
        const NetworkReader::Input in = reader.input();
        for (std::size_t a = 0; a < 3; ++a) in.position[a][0] = row[a];
        in.extra(0)[0] = 1;
        const float(*y)[4] = reader.evaluate(1);
        double error = 0;
        for (std::size_t c = 0; c < 3; ++c)
            error += std::pow(double(y[0][c] - row[3 + c]), 2) / (std::pow(double(row[3 + c]), 2) + 0.01) / 3;
        const bool is_near = std::abs(row[0] - 0.4f) < 1.0f / 400;
        (is_near ? near : far) += error;
        ++(is_near ? n_near : n_far);
    }
    EXPECT_LT(last_loss, 2e-3 * first_loss);
    EXPECT_LT(far / n_far, 2e-3);
    EXPECT_LT(near / n_near, 0.1);
}

}  // namespace
}  // namespace loom::learn
