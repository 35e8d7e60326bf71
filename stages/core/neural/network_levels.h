#pragma once
// Kernels of a hash grid with a multilayer perceptron (MLP) behind it, compiled once per x86-64 level. Every element is
// computed by the same operations in the same order at each level, without fused multiply-add: equal bytes.

#include <cstddef>
#include <cstdint>

namespace loom::neural {

inline constexpr int n_features = 2;  // per entry of the grid
inline constexpr int n_hidden = 64;   // width of both hidden layers
inline constexpr int n_outputs = 3;   // RGB
/// Samples that pass through the MLP together.
inline constexpr int tile_size = 64;
/// Columns of positions are padded to whole blocks of lanes, rows and inputs of matrices to whole blocks of rows.
inline constexpr int lane_block = 16, row_block = 8;
inline constexpr int max_levels = 16, max_inputs = 48;
constexpr int padded(int n, int block) {
    return (n + block - 1) / block * block;
}

/// One level of the grid: a lattice of (resolution + 1)^3 entries, or a table that the lattice is hashed into.
struct GridLevel {
    std::uint32_t resolution = 0;  // cells per edge
    std::uint32_t n_entries = 0;   // of a hashed level a power of two
    bool hashed = false;
};

/// Weights of the MLP in the layouts that the kernels read:
///   h1 = max(x first, 0)   h2 = max(h1 second, 0)   y = third h2
struct MlpWeights {
    int n_inputs = 0;               // a multiple of row_block
    const float* first = nullptr;   // [n_inputs][n_hidden]
    const float* second = nullptr;  // [n_hidden][n_hidden], [input][output]
    const float* third = nullptr;   // [n_outputs][n_hidden]
    // Transposed copies; for the backward pass only.
    int n_grid_columns = 0;             // first inputs, whose gradient is wanted; a multiple of lane_block
    const float* first_grid = nullptr;  // [n_hidden][n_grid_columns]
    const float* second_out = nullptr;  // [n_hidden][n_hidden], [output][input]
};

/// Returns the number of weights. In one array their order is first, second, third.
constexpr std::size_t n_weights(int n_inputs) {
    return std::size_t(n_hidden) * std::size_t(n_inputs + n_hidden + n_outputs);
}

/// Values of the samples of one tile. The caller sets x; for the backward pass also dy.
struct Tile {
    alignas(64) float x[tile_size][max_inputs];
    alignas(64) float h1[tile_size][n_hidden], h2[tile_size][n_hidden];
    alignas(64) float y[tile_size][4];
    alignas(64) float dy[tile_size][4];
    alignas(64) float dh1[tile_size][n_hidden], dh2[tile_size][n_hidden];
    alignas(64) float dx[tile_size][2 * lane_block];  // of the grid's inputs
};

/// Step of Adam at one moment of the training.                                        [Kingma2015] algorithm 1
struct AdamStep {
    float rate = 0;                          // learning rate
    float beta1 = 0, beta2 = 0;              // decay of the moments
    float correction1 = 1, correction2 = 1;  // 1 / (1 - beta^t)
    float epsilon = 1e-8f;
};

#define LOOM_NEURAL_KERNELS                                                                                     \
    /* Interpolates the features of one level at n positions in [0, 1]^3 (clamped): out[stride i + feature]. */ \
    /* n is a multiple of lane_block. */                                                                        \
    void encode_level(const GridLevel& level, const float* features, const float* const position[3], int n,     \
                      float* out, int stride);                                                                  \
    /* Adds the gradient by the features of one level: d[2 i + feature] is that by the value at position i. */  \
    void scatter_level(const GridLevel& level, const float* const position[3], int n, const float* d,           \
                       float* gradient);                                                                        \
    /* Computes h1, h2, y of the first n samples of a tile, n rounded up to a whole row_block. */               \
    void mlp_forward(const MlpWeights& weights, Tile& tile, int n);                                             \
    /* Adds the gradients by the weights of a whole tile to `gradient`, and computes dx, from dy. */            \
    void mlp_backward(const MlpWeights& weights, Tile& tile, float* gradient);                                  \
    /* Computes the gradient dy of the loss of a whole tile, y held in the denominator and each component */    \
    /* limited to +-limit; loss[i] is that of sample i:  sum_rgb (y - t)^2 / (y^2 + epsilon). */                \
    void relative_loss(Tile& tile, const float(*label)[n_outputs], float epsilon, float limit, float* loss);    \
    /* Updates n parameters whose gradient is not zero, and sets all gradients to zero. */                      \
    void adam_update(const AdamStep& step, std::size_t n, float* gradient, float* moment1, float* moment2,      \
                     float* value);

namespace v2 {
LOOM_NEURAL_KERNELS
}
namespace v3 {
LOOM_NEURAL_KERNELS
}
namespace v4 {
LOOM_NEURAL_KERNELS
}

struct NeuralKernels {
    decltype(&v2::encode_level) encode;
    decltype(&v2::scatter_level) scatter;
    decltype(&v2::mlp_forward) forward;
    decltype(&v2::mlp_backward) backward;
    decltype(&v2::relative_loss) loss;
    decltype(&v2::adam_update) adam;
};

#define LOOM_NEURAL_KERNELS_OF(level)                                                                                  \
    ::loom::neural::NeuralKernels {                                                                                    \
        ::loom::neural::level::encode_level, ::loom::neural::level::scatter_level, ::loom::neural::level::mlp_forward, \
            ::loom::neural::level::mlp_backward, ::loom::neural::level::relative_loss,                                 \
            ::loom::neural::level::adam_update                                                                         \
    }

/// Kernels of the highest x86-64 level of this processor.
const NeuralKernels& neural_kernels();

}  // namespace loom::neural
