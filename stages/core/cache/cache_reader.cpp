#include "stages/core/cache/cache_reader.h"

#include <fmt/format.h>

#include "formats/io/content_hash.h"
#include "formats/io/error.h"
#include "stages/core/cache/grid_cache.h"
#include "stages/core/cache/point_cache.h"
#include "stages/core/scattering/lobe_width.h"
#include "stages/core/scene/scene.h"

namespace loom {

CacheQuery cache_query(const ShadingPoint& at) {
    const Normal3f& n = at.frame.n;
    return {at.p, dot(n, at.wo) < 0 ? -n : n, at.wo,
            specular_alpha(at.bsdf.model->kind, at.bsdf.alpha_u, at.bsdf.alpha_v, at.bsdf.exponent),
            albedo(at.bsdf, at.wo_local)};
}

bool is_cached(const Bsdf<float>& bsdf, float smallest_roughness) {
    const float width = narrowest_lobe(bsdf.model->kind, bsdf.alpha_u, bsdf.alpha_v, bsdf.exponent);
    return bsdf.opacity > 0 && width > 0 && width >= smallest_roughness;
}

std::unique_ptr<CacheReader> make_cache_reader(RadianceCache cache) {
    if (cache.is_grid()) return std::make_unique<GridCache>(std::move(cache));
    return std::make_unique<PointCache>(std::move(cache));
}

void require_scene_of(const RadianceCache& cache, const std::string& cache_file, const Scene& scene,
                      const std::string& scene_file) {
    const std::string hash = content_hash_text(scene.content_hash);
    if (cache.scene != hash)
        throw InputError(fmt::format(
            "{}: made of another scene (content {}), not of {} with these values (content {}); make it again",
            cache_file, cache.scene, scene_file, hash));
}

}  // namespace loom
