#pragma once
#include <string>
#include <vector>

#include "stages/core/cache/cache_reader.h"

namespace loom {

/// Inputs of a grid's network beside its features: n; where the surfaces of the scene are not all diffuse the direction r
/// in which wo is reflected, by its five second-order harmonics too, all times 1 - roughness, and n.wo; reflectance; 1.
class GridInputs {
  public:
    explicit GridInputs(bool directional) : directional_(directional) {}

    int size() const { return directional_ ? 16 : 7; }
    bool directional() const { return directional_; }
    /// Returns the names of all inputs of the network, of the features first.
    std::vector<std::string> names(std::size_t n_levels) const;
    /// out:     inputs  size() numbers
    void fill(const CacheQuery& query, float* inputs) const;

  private:
    bool directional_;
};

/// Smallest divisor of radiance where it is demodulated; see RadianceCache::demodulated.
inline constexpr float smallest_reflectance = 0.01f;
inline Spectrum demodulator(const Spectrum& reflectance) {
    Spectrum divisor;
    for (int c = 0; c < 3; ++c) divisor[c] = std::max(reflectance[c], smallest_reflectance);
    return divisor;
}

}  // namespace loom
