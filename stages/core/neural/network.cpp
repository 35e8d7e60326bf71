#include "stages/core/neural/network.h"

#include <algorithm>

namespace loom::neural {

const NeuralKernels& neural_kernels() {
    static const NeuralKernels chosen = __builtin_cpu_supports("x86-64-v4")   ? LOOM_NEURAL_KERNELS_OF(v4)
                                        : __builtin_cpu_supports("x86-64-v3") ? LOOM_NEURAL_KERNELS_OF(v3)
                                                                              : LOOM_NEURAL_KERNELS_OF(v2);
    return chosen;
}

std::vector<std::uint32_t> NetworkShape::first_entries() const {
    std::vector<std::uint32_t> first = {0};
    for (const GridLevel& level : levels) first.push_back(first.back() + level.n_entries);
    return first;
}

std::vector<GridLevel> grid_levels(int n_levels, int log2_entries, double base, double growth) {
    std::vector<GridLevel> levels;
    double resolution = base;
    for (int i = 0; i < n_levels; ++i, resolution *= growth) {
        GridLevel level;
        level.resolution = std::uint32_t(resolution);
        const std::uint64_t side = std::uint64_t(level.resolution) + 1, lattice = side * side * side;
        level.hashed = lattice > std::uint64_t{1} << log2_entries;
        level.n_entries = level.hashed ? 1u << log2_entries : std::uint32_t(lattice);
        levels.push_back(level);
    }
    return levels;
}

MlpWeights Network::mlp() const {
    MlpWeights w;
    w.n_inputs = padded_inputs();
    w.first = weights.data();
    w.second = w.first + w.n_inputs * n_hidden;
    w.third = w.second + n_hidden * n_hidden;
    return w;
}

void Network::scale_outputs(float factor) {
    const std::size_t n_third = std::size_t(n_outputs * n_hidden);
    for (std::size_t i = weights.size() - n_third; i < weights.size(); ++i) weights[i] *= factor;
}

std::vector<float> rows_of_weights(const Network& network) {
    const MlpWeights w = network.mlp();
    const int n = network.shape.n_inputs();
    std::vector<float> rows;
    rows.reserve(n_weights(n));
    for (int o = 0; o < n_hidden; ++o)
        for (int k = 0; k < n; ++k) rows.push_back(w.first[k * n_hidden + o]);
    for (int o = 0; o < n_hidden; ++o)
        for (int k = 0; k < n_hidden; ++k) rows.push_back(w.second[k * n_hidden + o]);
    rows.insert(rows.end(), w.third, w.third + n_outputs * n_hidden);
    return rows;
}

std::vector<float> weights_of_rows(const NetworkShape& shape, const float* rows) {
    const int n = shape.n_inputs(), n_padded = padded(n, row_block);
    std::vector<float> weights(n_weights(n_padded));
    for (int o = 0; o < n_hidden; ++o)
        for (int k = 0; k < n; ++k) weights[std::size_t(k * n_hidden + o)] = *rows++;
    float* second = weights.data() + n_padded * n_hidden;
    for (int o = 0; o < n_hidden; ++o)
        for (int k = 0; k < n_hidden; ++k) second[k * n_hidden + o] = *rows++;
    std::copy(rows, rows + n_outputs * n_hidden, second + n_hidden * n_hidden);
    return weights;
}

struct NetworkReader::State {
    alignas(64) float position[3][tile_size] = {};
    Tile tile = {};
};

void NetworkReader::Delete::operator()(State* state) const {
    delete state;
}

NetworkReader::NetworkReader(const Network& network, const NeuralKernels& kernels)
    : network_(network), kernels_(kernels), first_(network.shape.first_entries()), state_(new State) {
    for (std::size_t i = 0; i < network.shape.levels.size(); ++i)
        if (!network.shape.levels[i].hashed) finest_lattice_ = int(i);
}

bool NetworkReader::is_untouched(int i) const {
    if (finest_lattice_ < 0) return false;
    const float* x = state_->tile.x[i] + n_features * finest_lattice_;
    return x[0] == 0 && x[1] == 0;
}

NetworkReader::Input NetworkReader::input() {
    return {{state_->position[0], state_->position[1], state_->position[2]},
            state_->tile.x[0] + network_.shape.n_grid_inputs()};
}

const float (*NetworkReader::evaluate(int n))[4] {
    const float* const position[3] = {state_->position[0], state_->position[1], state_->position[2]};
    for (std::size_t level = 0; level < network_.shape.levels.size(); ++level)
        kernels_.encode(network_.shape.levels[level],
                        network_.features.data() + n_features * std::size_t(first_[level]), position,
                        padded(n, lane_block), state_->tile.x[0] + n_features * level, max_inputs);
    kernels_.forward(network_.mlp(), state_->tile, n);
    return state_->tile.y;
}

}  // namespace loom::neural
