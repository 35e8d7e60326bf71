#include "stages/learn/train.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <memory>
#include <numeric>

#include "stages/core/compute/parallel.h"
#include "stages/core/math/exponential.h"
#include "stages/core/sampling/streams.h"

namespace loom::learn {

using namespace neural;

std::vector<std::uint32_t> shuffled_places(std::size_t n, std::uint64_t seed) {
    std::vector<std::uint32_t> place(n);
    std::iota(place.begin(), place.end(), 0u);
    for (std::size_t i = n; i > 1; --i) {
        // The upper half of a product of 32-bit numbers is below i, and uniform up to i / 2^32.
        const std::uint64_t j = (streams::shuffle(seed, i) >> 32) * i >> 32;
        std::swap(place[i - 1], place[j]);
    }
    return place;
}

float rate_factor(const TrainingPlan& plan, std::uint64_t batch) {
    constexpr double constant = 0.4, log_final = -3.912023005428146;  // ln 0.02
    const double done = double(batch) / double(plan.n_batches);
    // Not by a function of the C library, whose bits depend on the processor.
    return done <= constant ? 1 : exponential(float(log_final * (done - constant) / (1 - constant)));
}

Trainer::Trainer(const TrainingRows& rows, const NetworkShape& shape, const TrainingPlan& plan, int threads,
                 const NeuralKernels& kernels)
    : rows_(rows), plan_(plan), threads_(threads), kernels_(kernels), first_(shape.first_entries()) {
    network_.shape = shape;
    const std::size_t n = n_features * shape.n_entries();
    // Zero, so that an entry that no sample touches is known by its value.
    network_.features.resize(n);
    // Rows of the network as on disk, so that padding draws no number. Variance 2 / fan-in.   [He2015] eq. (10)
    std::vector<float> weights(n_weights(shape.n_inputs()));
    for (std::size_t i = 0; i < weights.size(); ++i) {
        const bool in_first = i < std::size_t(n_hidden * shape.n_inputs());
        const float bound = std::sqrt(6.0f / float(in_first ? shape.n_inputs() : n_hidden));
        const std::uint32_t bits = std::uint32_t(streams::weight(plan.seed, i) >> 32);
        weights[i] = (2 * unit_float(bits) - 1) * bound;
    }
    network_.weights = weights_of_rows(shape, weights.data());

    feature_gradient_.resize(n), feature_moment1_.resize(n), feature_moment2_.resize(n);
    const std::size_t n_all = network_.weights.size();
    weight_gradient_.resize(n_all), weight_moment1_.resize(n_all), weight_moment2_.resize(n_all);
    chunk_gradient_.resize(n_chunks * n_all);
    first_grid_.resize(std::size_t(n_hidden * padded(shape.n_grid_inputs(), lane_block)));
    second_out_.resize(std::size_t(n_hidden * n_hidden));
    transpose();

    position_columns_.resize(3 * batch_size);
    for (std::size_t axis = 0; axis < 3; ++axis) position_[axis] = position_columns_.data() + axis * batch_size;
    encoded_.resize(std::size_t(batch_size * shape.n_grid_inputs()));
    encoded_gradient_.resize(encoded_.size());
}

void Trainer::transpose() {
    const MlpWeights w = network_.mlp();
    const int n = network_.shape.n_grid_inputs(), columns = padded(n, lane_block);
    for (int o = 0; o < n_hidden; ++o) {
        for (int k = 0; k < n; ++k) first_grid_[std::size_t(o * columns + k)] = w.first[k * n_hidden + o];
        for (int k = 0; k < n_hidden; ++k) second_out_[std::size_t(o * n_hidden + k)] = w.second[k * n_hidden + o];
    }
}

void Trainer::load_batch() {
    const std::uint64_t begin = batch_ * batch_size % rows_.size();
    for (std::size_t i = 0; i < batch_size; ++i) {
        const std::span<const float> row = rows_[(begin + i) % rows_.size()];
        for (std::size_t axis = 0; axis < 3; ++axis) position_columns_[axis * batch_size + i] = row[axis];
    }
}

void Trainer::encode() {
    constexpr std::uint64_t part = 4096, parts = batch_size / part;
    const std::size_t n_levels = network_.shape.levels.size();
    parallel_chunks(n_levels * parts, 1, threads_, [&](std::uint64_t task, std::uint64_t, std::uint64_t) {
        const std::size_t level = task / parts, at = task % parts * part;
        const float* const columns[3] = {position_[0] + at, position_[1] + at, position_[2] + at};
        kernels_.encode(network_.shape.levels[level],
                        network_.features.data() + n_features * std::size_t(first_[level]), columns, int(part),
                        encoded_.data() + n_features * (level * batch_size + at), n_features);
    });
}

double Trainer::evaluate() {
    const int n_levels = int(network_.shape.levels.size()), n_extra = network_.shape.n_extra;
    const std::uint64_t begin = batch_ * batch_size % rows_.size();
    MlpWeights w = network_.mlp();
    w.n_grid_columns = padded(network_.shape.n_grid_inputs(), lane_block);
    w.first_grid = first_grid_.data();
    w.second_out = second_out_.data();
    const std::size_t n_all = network_.weights.size();
    parallel_chunks(batch_size, chunk_size, threads_, [&](std::uint64_t chunk, std::uint64_t from, std::uint64_t to) {
        const auto tile = std::make_unique<Tile>();
        float label[tile_size][n_outputs], loss[tile_size];
        float* const gradient = chunk_gradient_.data() + chunk * n_all;
        std::fill_n(gradient, n_all, 0.0f);
        double sum = 0;
        for (std::uint64_t first = from; first < to; first += tile_size) {
            for (std::size_t i = 0; i < tile_size; ++i) {
                float* x = tile->x[i];
                for (int level = 0; level < n_levels; ++level, x += n_features)
                    std::memcpy(x, encoded_.data() + n_features * (std::size_t(level) * batch_size + first + i),
                                sizeof(float) * n_features);
                const float* row = rows_[(begin + first + i) % rows_.size()].data();
                std::copy_n(row + TrainingRows::first_extra, n_extra, x);
                std::copy_n(row + 3, n_outputs, label[i]);
            }
            kernels_.forward(w, *tile, tile_size);
            kernels_.loss(*tile, label, plan_.epsilon, plan_.limit, loss);
            for (const float l : loss) sum += double(l);
            kernels_.backward(w, *tile, gradient);
            for (std::size_t i = 0; i < tile_size; ++i)
                for (int level = 0; level < n_levels; ++level)
                    std::memcpy(encoded_gradient_.data() + n_features * (std::size_t(level) * batch_size + first + i),
                                tile->dx[i] + n_features * level, sizeof(float) * n_features);
        }
        chunk_loss_[chunk] = sum;
    });
    return std::accumulate(chunk_loss_.begin(), chunk_loss_.end(), 0.0) / batch_size;
}

void Trainer::scatter(std::size_t level) {
    const std::size_t at = n_features * std::size_t(first_[level]);
    kernels_.scatter(network_.shape.levels[level], position_.data(), batch_size,
                     encoded_gradient_.data() + n_features * level * batch_size, feature_gradient_.data() + at);
}

void Trainer::sum_weight_gradients() {
    const std::size_t n_all = network_.weights.size();
    for (std::size_t chunk = 0; chunk < n_chunks; ++chunk)
        for (std::size_t i = 0; i < n_all; ++i) weight_gradient_[i] += chunk_gradient_[chunk * n_all + i];
}

double Trainer::step() {
    load_batch();
    encode();
    const double loss = evaluate();

    beta1_power_ *= double(plan_.beta1), beta2_power_ *= double(plan_.beta2);
    AdamStep adam;
    adam.rate = plan_.rate * rate_factor(plan_, batch_);
    adam.beta1 = plan_.beta1, adam.beta2 = plan_.beta2;
    adam.correction1 = float(1 / (1 - beta1_power_)), adam.correction2 = float(1 / (1 - beta2_power_));
    const std::size_t n_levels = network_.shape.levels.size();
    parallel_chunks(n_levels + 1, 1, threads_, [&](std::uint64_t task, std::uint64_t, std::uint64_t) {
        if (task < n_levels) {
            // Finest levels first: they take longest.
            const std::size_t level = n_levels - 1 - task, at = n_features * std::size_t(first_[level]);
            scatter(level);
            kernels_.adam(adam, n_features * std::size_t(first_[level + 1] - first_[level]),
                          feature_gradient_.data() + at, feature_moment1_.data() + at, feature_moment2_.data() + at,
                          network_.features.data() + at);
            return;
        }
        sum_weight_gradients();
        AdamStep of_weights = adam;
        of_weights.rate *= 0.5f;
        kernels_.adam(of_weights, network_.weights.size(), weight_gradient_.data(), weight_moment1_.data(),
                      weight_moment2_.data(), network_.weights.data());
        transpose();
    });
    ++batch_;
    return loss;
}

Trainer::Gradients Trainer::gradients() {
    load_batch();
    encode();
    Gradients g;
    g.loss = evaluate();
    for (std::size_t level = 0; level < network_.shape.levels.size(); ++level) scatter(level);
    sum_weight_gradients();
    g.features = feature_gradient_, g.weights = weight_gradient_;
    std::fill(feature_gradient_.begin(), feature_gradient_.end(), 0.0f);
    std::fill(weight_gradient_.begin(), weight_gradient_.end(), 0.0f);
    return g;
}

}  // namespace loom::learn
