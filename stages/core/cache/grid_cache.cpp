#include "stages/core/cache/grid_cache.h"

#include <fmt/format.h>

#include <algorithm>

#include "formats/io/error.h"

namespace loom {
namespace {

using namespace neural;

/// Returns the inputs of a cache beside its features.
GridInputs inputs_of(const RadianceCache& cache) {
    for (const bool directional : {false, true}) {
        const GridInputs inputs(directional);
        if (cache.inputs == inputs.names(cache.n_levels())) return inputs;
    }
    throw InputError("inputs: are not those of this build (loom-inspect shows the producer of the cache)");
}

std::vector<GridLevel> levels_of(const RadianceCache& cache) {
    const auto& grid = cache.grid;
    if (cache.n_levels() > std::size_t(max_levels))
        throw InputError(
            fmt::format("grid/resolution: has {} rows; this build reads up to {}", cache.n_levels(), max_levels));
    std::vector<GridLevel> levels;
    for (std::size_t i = 0; i < cache.n_levels(); ++i) {
        constexpr std::uint32_t finest = 1u << 20;
        if (grid.resolution[i] > finest)
            throw InputError(
                fmt::format("grid/resolution: row {} is {}; this build reads up to {}", i, grid.resolution[i], finest));
        const std::uint32_t n = grid.first[i + 1] - grid.first[i];
        const std::uint64_t side = std::uint64_t{grid.resolution[i]} + 1, lattice = side * side * side;
        if (n < lattice && (n & (n - 1)) != 0)
            throw InputError(
                fmt::format("grid/first: {} entries of level {}, neither {} nor a power of two", n, i, lattice));
        levels.push_back({grid.resolution[i], n, n < lattice});
    }
    return levels;
}

}  // namespace

Network network_of(const RadianceCache& cache) {
    Network network;
    network.shape = {levels_of(cache), inputs_of(cache).size()};
    const auto& [weight, rows, columns] = cache.mlp;
    const std::uint32_t n_inputs = std::uint32_t(network.shape.n_inputs());
    const std::array<std::uint32_t, 3> expected_rows = {n_hidden, n_hidden, n_outputs};
    if (!std::ranges::equal(rows, expected_rows) || columns[0] != n_inputs)
        throw InputError(fmt::format("mlp/rows: this build reads two hidden layers of {}", n_hidden));
    network.features.assign(cache.grid.features.begin(), cache.grid.features.end());
    network.weights = weights_of_rows(network.shape, weight.data());
    return network;
}

void store_network(const Network& network, const GridInputs& inputs, RadianceCache& cache) {
    std::vector<std::uint32_t> resolution;
    for (const GridLevel& level : network.shape.levels) resolution.push_back(level.resolution);
    cache.grid.resolution = std::move(resolution);
    cache.grid.first = network.shape.first_entries();
    cache.grid.features = network.features;
    cache.mlp.weight = rows_of_weights(network);
    cache.mlp.rows = std::vector<std::uint32_t>{n_hidden, n_hidden, n_outputs};
    cache.mlp.columns = std::vector<std::uint32_t>{std::uint32_t(network.shape.n_inputs()), n_hidden, n_hidden};
    cache.inputs = inputs.names(network.shape.levels.size());
}

GridCache::GridCache(RadianceCache cache)
    : CacheReader(std::move(cache)),
      network_(network_of(cache_)),
      inputs_(inputs_of(cache_)),
      readers_([this] { return std::make_unique<NetworkReader>(network_); }) {}

void GridCache::answer(std::span<const CacheQuery> queries, std::span<CacheAnswer> answers) const {
    NetworkReader& reader = *readers_.local();
    const NetworkReader::Input in = reader.input();
    const float inv_size = 1 / cache_.domain.size;
    for (std::size_t first = 0; first < queries.size(); first += tile_size) {
        const auto part = queries.subspan(first, std::min<std::size_t>(tile_size, queries.size() - first));
        for (int i = 0; i < int(part.size()); ++i) {
            const CacheQuery& query = part[std::size_t(i)];
            for (int axis = 0; axis < 3; ++axis)
                in.position[axis][i] = (query.p[axis] - cache_.domain.lo[std::size_t(axis)]) * inv_size;
            inputs_.fill(query, in.extra(i));
        }
        const float(*y)[4] = reader.evaluate(int(part.size()));
        for (int i = 0; i < int(part.size()); ++i) {
            CacheAnswer& answer = answers[first + std::size_t(i)];
            for (int c = 0; c < 3; ++c) answer.L[c] = y[i][c] > 0 ? y[i][c] : 0.0f;
            if (cache_.demodulated) answer.L *= demodulator(part[std::size_t(i)].reflectance);
            answer.distance = 0;
            answer.is_far = reader.is_untouched(i);
            for (const float* column : in.position) answer.is_far |= !(column[i] >= 0 && column[i] <= 1);
        }
    }
}

}  // namespace loom
