#pragma once
// A function of position and a few other inputs: features interpolated on grids of several resolutions, hashed where a
// lattice has more points than a table has entries, and a small MLP behind them.
//                   [Mueller2022] "Instant Neural Graphics Primitives with a Multiresolution Hash Encoding", section 3

#include <cstdint>
#include <memory>
#include <vector>

#include "stages/core/neural/network_levels.h"

namespace loom::neural {

/// Sizes of a grid and of the inputs beside its features.
struct NetworkShape {
    std::vector<GridLevel> levels;
    int n_extra = 0;

    int n_grid_inputs() const { return n_features * int(levels.size()); }
    int n_inputs() const { return n_grid_inputs() + n_extra; }
    /// Returns offsets of the levels into the entries of the grid: level+1.
    std::vector<std::uint32_t> first_entries() const;
    std::size_t n_entries() const { return first_entries().back(); }
};

/// Returns levels whose resolutions are base growth^level, rounded down. A level is hashed where its lattice has more
/// than 2^log2_entries points.
std::vector<GridLevel> grid_levels(int n_levels, int log2_entries, double base, double growth);

/// Parameters of a network, in the order of the kernels.
struct Network {
    NetworkShape shape;
    std::vector<float> features;  // [entry][feature]
    std::vector<float> weights;   // first, second, third; n_inputs padded, the additional weights 0

    int padded_inputs() const { return padded(shape.n_inputs(), row_block); }
    MlpWeights mlp() const;
    void scale_outputs(float factor);
};

/// Returns the weights of a network layer after layer, row-major [output][input] without padding, and back.
std::vector<float> rows_of_weights(const Network& network);
std::vector<float> weights_of_rows(const NetworkShape& shape, const float* rows);

/// Evaluates a network. Results of a sample do not depend on the others of a call. Not thread-safe; the network is
/// borrowed.
class NetworkReader {
  public:
    explicit NetworkReader(const Network& network, const NeuralKernels& kernels = neural_kernels());

    /// Rows of inputs of the next evaluation, to be filled in: position in [0, 1]^3 (clamped), and n_extra numbers.
    struct Input {
        float* position[3];  // [tile_size] each
        float* extra(int i) const { return first_extra + std::ptrdiff_t(i) * max_inputs; }
        float* first_extra;
    };
    Input input();
    /// Evaluates the first n samples of input(); n is at most tile_size.
    /// returns: rows of 4 numbers: R, G, B and 0, unclamped; valid until the next call
    const float (*evaluate(int n))[4];
    /// Whether the features of sample i of the last evaluation are 0 at the finest level that is not hashed. Those of a
    /// cell that no training sample touched are.
    bool is_untouched(int i) const;

  private:
    struct State;
    struct Delete {
        void operator()(State* state) const;
    };

    const Network& network_;
    const NeuralKernels& kernels_;
    std::vector<std::uint32_t> first_;
    int finest_lattice_ = -1;  // level; -1: all are hashed
    std::unique_ptr<State, Delete> state_;
};

}  // namespace loom::neural
