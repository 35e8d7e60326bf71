#pragma once
// Queries of a radiance cache: outgoing radiance of points on the surfaces of a static scene.        [HY] section 3.4

#include <cstddef>
#include <memory>
#include <span>
#include <string>

#include "formats/radiance_cache.h"
#include "stages/core/scene/shading.h"

namespace loom {

struct Scene;

/// A point on a surface, and the direction in which light leaves it.
struct CacheQuery {
    Point3f p;             // world space, m
    Normal3f n;            // shading normal, on the side of wo
    Vector3f wo;           // unit, world space
    float roughness = 1;   // specular_alpha() of the BSDF
    Spectrum reflectance;  // albedo of the BSDF for wo
};
CacheQuery cache_query(const ShadingPoint& at);

/// Whether a cache covers such a surface. The others are mirrors, smooth glass, null and nearly specular surfaces, whose
/// radiance varies too fast with direction: their light is found by following the path to the next surface.
bool is_cached(const Bsdf<float>& bsdf, float smallest_roughness);

struct CacheAnswer {
    Spectrum L;           // outgoing radiance without emission, W m^-2 sr^-1
    float distance = 0;   // to the nearest point of the cache, in its metric; 0: has no points
    bool is_far = false;  // outside of what the cache was made of: its validation does not hold there
};

/// Answers queries; one for all threads.
class CacheReader {
  public:
    virtual ~CacheReader() = default;

    const RadianceCache& cache() const { return cache_; }
    /// Returns the cache; the reader answers no more.
    RadianceCache take() && { return std::move(cache_); }
    /// in:      queries  in an order in which neighbours lie close together
    /// out:     answers  of the same length; that of a query does not depend on the others
    virtual void answer(std::span<const CacheQuery> queries, std::span<CacheAnswer> answers) const = 0;

  protected:
    explicit CacheReader(RadianceCache cache) : cache_(std::move(cache)) {}

    RadianceCache cache_;
};

/// Makes the reader of the cache's method.
std::unique_ptr<CacheReader> make_cache_reader(RadianceCache cache);

/// Refuses a cache of another scene.
/// throws:  InputError that names both files
void require_scene_of(const RadianceCache& cache, const std::string& cache_file, const Scene& scene,
                      const std::string& scene_file);

}  // namespace loom
