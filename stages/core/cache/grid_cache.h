#pragma once
#include <tbb/enumerable_thread_specific.h>

#include <memory>

#include "stages/core/cache/cache_reader.h"
#include "stages/core/cache/grid_inputs.h"
#include "stages/core/neural/network.h"

namespace loom {

/// A hash grid and its network:  L = max(y, 0), times reflectance where demodulated. A query is far outside of the cube
/// of the grid, and in cells that no training sample touched, of the finest level that is not hashed.
class GridCache : public CacheReader {
  public:
    /// throws:  InputError when its layers, inputs or levels are not those of this build
    explicit GridCache(RadianceCache cache);

    void answer(std::span<const CacheQuery> queries, std::span<CacheAnswer> answers) const override;

  private:
    neural::Network network_;
    GridInputs inputs_;
    mutable tbb::enumerable_thread_specific<std::unique_ptr<neural::NetworkReader>> readers_;
};

/// Returns the network of a cache of method grid.
/// throws:  InputError as GridCache
neural::Network network_of(const RadianceCache& cache);
/// Sets grid, mlp and inputs of a cache.
void store_network(const neural::Network& network, const GridInputs& inputs, RadianceCache& cache);

}  // namespace loom
