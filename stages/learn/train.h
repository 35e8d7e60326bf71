#pragma once
// Training of a network on samples of a function, by Adam on batches of a fixed order. The result is the same for any
// number of threads and at any x86-64 level: a batch is processed in fixed chunks whose gradients are added in order, and
// each level of the grid is updated by one thread.

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "stages/core/compute/huge_array.h"
#include "stages/core/neural/network.h"

namespace loom::learn {

/// Rows of samples to train on: position in [0, 1]^3, label RGB, n_extra other inputs.
class TrainingRows {
  public:
    static constexpr int first_extra = 6;

    TrainingRows(std::size_t n, int n_extra)
        : n_(n), stride_(first_extra + n_extra), values_(n * std::size_t(stride_)) {}

    std::size_t size() const { return n_; }
    int n_extra() const { return stride_ - first_extra; }
    std::span<float> operator[](std::size_t i) { return {values_.data() + i * std::size_t(stride_), row_size()}; }
    std::span<const float> operator[](std::size_t i) const {
        return {values_.data() + i * std::size_t(stride_), row_size()};
    }
    static std::uint64_t bytes_per_row(int n_extra) { return sizeof(float) * std::uint64_t(first_extra + n_extra); }

  private:
    std::size_t row_size() const { return std::size_t(stride_); }

    std::size_t n_;
    int stride_;
    HugeArray<float> values_;
};

/// Returns a random order of n rows: the place of each.
std::vector<std::uint32_t> shuffled_places(std::size_t n, std::uint64_t seed);

struct TrainingPlan {
    std::uint64_t n_batches = 0;
    std::uint64_t seed = 0;
    float rate = 2e-2f;  // of the features; the weights have half of it
    float beta1 = 0.9f, beta2 = 0.99f;
    float epsilon = 0.01f;  // of the loss, see relative_loss()
    float limit = 10;       // of a sample's gradient per channel
};

inline constexpr int batch_size = 16384;

/// Returns the factor on the learning rate at a batch: 1 during the first 40 % of them, then falling exponentially to
/// 0.02.
float rate_factor(const TrainingPlan& plan, std::uint64_t batch);

/// A network in training. The rows are borrowed; they must be in random order (shuffled_places()), because batch k has
/// the rows k batch_size, k batch_size + 1, ... modulo their number.
class Trainer {
  public:
    /// needs:   at least one row; shape.n_extra of the rows
    Trainer(const TrainingRows& rows, const neural::NetworkShape& shape, const TrainingPlan& plan, int threads,
            const neural::NeuralKernels& kernels = neural::neural_kernels());

    /// Trains on the next batch.
    /// returns: mean loss of its samples before the step, summed over channels
    double step();
    std::uint64_t n_steps() const { return batch_; }
    const neural::Network& network() const { return network_; }

    /// Loss and gradients of the current network on the next batch, without a step. For tests.
    struct Gradients {
        double loss = 0;
        std::vector<float> features, weights;
    };
    Gradients gradients();

  private:
    static constexpr int chunk_size = 512, n_chunks = batch_size / chunk_size;
    static_assert(chunk_size % neural::tile_size == 0 && batch_size % chunk_size == 0);

    void load_batch();
    void encode();
    double evaluate();
    void scatter(std::size_t level);
    void sum_weight_gradients();
    void transpose();

    const TrainingRows& rows_;
    TrainingPlan plan_;
    int threads_;
    const neural::NeuralKernels& kernels_;
    neural::Network network_;
    std::vector<std::uint32_t> first_;
    std::uint64_t batch_ = 0;

    std::vector<float> feature_gradient_, feature_moment1_, feature_moment2_;
    std::vector<float> weight_gradient_, weight_moment1_, weight_moment2_;
    std::vector<float> first_grid_, second_out_;  // transposed weights
    double beta1_power_ = 1, beta2_power_ = 1;    // beta^steps

    // Columns of one batch.
    std::vector<float> position_columns_;
    std::array<const float*, 3> position_;
    std::vector<float> encoded_;           // [level][sample][feature]
    std::vector<float> encoded_gradient_;  // the same
    std::vector<float> chunk_gradient_;    // [chunk][weight]
    std::array<double, n_chunks> chunk_loss_{};
};

}  // namespace loom::learn
