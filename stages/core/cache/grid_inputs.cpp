#include "stages/core/cache/grid_inputs.h"

#include <fmt/format.h>

namespace loom {

std::vector<std::string> GridInputs::names(std::size_t n_levels) const {
    std::vector<std::string> all;
    for (std::size_t level = 0; level < n_levels; ++level)
        for (int feature = 0; feature < 2; ++feature) all.push_back(fmt::format("level {} feature {}", level, feature));
    const auto add = [&](std::initializer_list<const char*> names) {
        all.insert(all.end(), names.begin(), names.end());
    };
    add({"n x", "n y", "n z"});
    if (directional_) add({"r x", "r y", "r z", "r xy", "r yz", "r zx", "r xx-yy", "r zz", "n.wo"});
    add({"reflectance r", "reflectance g", "reflectance b", "1"});
    return all;
}

void GridInputs::fill(const CacheQuery& query, float* inputs) const {
    const auto add = [&](float value) { *inputs++ = value; };
    add(query.n.x), add(query.n.y), add(query.n.z);
    if (directional_) {
        const float cos = dot(query.n, query.wo), part = 1 - std::min(query.roughness, 1.0f);
        const Vector3f r = Vector3f(query.n) * (2 * cos) - query.wo;
        add(part * r.x), add(part * r.y), add(part * r.z);
        add(part * (r.x * r.y)), add(part * (r.y * r.z)), add(part * (r.z * r.x));
        add(part * (r.x * r.x - r.y * r.y)), add(part * (1.5f * (r.z * r.z) - 0.5f));
        add(cos);
    }
    add(query.reflectance.r), add(query.reflectance.g), add(query.reflectance.b);
    add(1);
}

}  // namespace loom
