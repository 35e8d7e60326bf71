#include "stages/residual/sky_pair.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <vector>

#include "stages/core/sampling/sampler.h"

namespace loom::residual {
namespace {

const Emitter* sky_of(const Scene& scene) {
    return scene.environment_idx < 0 ? nullptr : &scene.emitters[std::size_t(scene.environment_idx)];
}

/// Returns the finer map of two skies of which at least one has a map.
const Emitter& finer(const Emitter& a, const Emitter& b) {
    if (!a.map || !b.map) return a.map ? a : b;
    return a.map->texels.size() > b.map->texels.size() ? a : b;
}

std::shared_ptr<const SkyProposals> proposals_of(const Scene& old_scene, const Scene& new_scene) {
    const Emitter& grid = finer(*sky_of(new_scene), *sky_of(old_scene));
    auto proposals = std::make_shared<SkyProposals>();
    proposals->frame = grid.frame;
    EnvironmentMap& map = proposals->map;
    map.width = grid.map->width, map.height = grid.map->height;
    map.texels.resize(grid.map->texels.size());
    double sum = 0;
    for (int y = 0; y < map.height; ++y)
        for (int x = 0; x < map.width; ++x) {
            const Vector3f d = grid.frame.to_world(map.direction(map.centre(x, y)));
            const Spectrum before = environment(old_scene, d), after = environment(new_scene, d);
            Spectrum difference;
            for (int c = 0; c < 3; ++c) difference[c] = std::abs(after[c] - before[c]);
            const Spectrum p = difference * 0.5f + (before + after) * 0.25f;
            map.texels[std::size_t(y) * std::size_t(map.width) + std::size_t(x)] = p;
            sum += luminance(p);
        }
    // A cell may miss what a map in another frame has between its corners.
    constexpr float even = 0.01f;
    for (Spectrum& p : map.texels) p += Spectrum(even * float(sum / double(map.texels.size())));
    return map.prepare() ? proposals : nullptr;
}

/// Variance of the difference of two skies' irradiance from one pair of light samples, over the square of the new one.
double relative_variance(const Scene& old_scene, const Scene& new_scene) {
    constexpr std::uint64_t n = 4096;
    std::vector<Normal3f> normals;
    for (int x = -1; x <= 1; ++x)
        for (int y = -1; y <= 1; ++y)
            for (int z = -1; z <= 1; ++z)
                if (x || y || z) normals.push_back(Normal3f(normalize(Vector3f(float(x), float(y), float(z)))));
    std::vector<double> sum(normals.size()), squares(normals.size()), irradiance(normals.size());
    struct Light {
        Vector3f d;
        double E = 0;  // over the density
    };
    const auto sample = [](const Scene& scene, Point2f u) {
        LightQuery query;
        query.u = u;
        look_up_light(scene, query);
        if (int(query.point.emitter_idx) != scene.environment_idx || !(query.point.pdf_w > 0)) return Light{};
        return Light{Vector3f(query.point.y), luminance(query.point.Li) / double(query.point.pdf_w)};
    };
    for (std::uint64_t i = 0; i < n; ++i) {
        const Point2f u = Sampler(SamplerKind::sobol, 0, 0, i).pair(0);
        const Light before = sample(old_scene, u), after = sample(new_scene, u);
        for (std::size_t k = 0; k < normals.size(); ++k) {
            const double of_new = std::max(dot(normals[k], after.d), 0.0f) * after.E,
                         difference = of_new - std::max(dot(normals[k], before.d), 0.0f) * before.E;
            sum[k] += difference / n;
            squares[k] += difference * difference / n;
            irradiance[k] += of_new / n;
        }
    }
    double variance = 0, scale = 0;
    for (std::size_t k = 0; k < normals.size(); ++k) {
        variance += squares[k] - sum[k] * sum[k];
        scale += irradiance[k] * irradiance[k];
    }
    return scale > 0 ? variance / scale : 0;
}

/// Whether one sky is the other, turned.
bool is_turned(const Emitter& a, const Emitter& b) {
    return a.map && b.map && a.map->width == b.map->width && a.map->texels == b.map->texels;
}

/// Returns a scene without anything but its sky.
Scene sky_alone(const Scene& scene, std::shared_ptr<const SkyProposals> proposals = {}) {
    Scene alone;
    alone.emitters.push_back(*sky_of(scene));
    alone.emitters[0].proposals = std::move(proposals);
    alone.environment_idx = 0;
    return alone;
}

}  // namespace

std::string SkyPair::describe() const {
    if (own_variance == 0) return {};
    if (shared_variance == 0)
        return fmt::format("the sky is turned: light samples at the same texel (relative variance of a pair {:.2g})",
                           own_variance);
    return fmt::format("light samples of the skies {} (relative variance of a pair {:.2g}, else {:.2g})",
                       shared ? "in common directions, by what differs" : "each by its own density",
                       shared ? shared_variance : own_variance, shared ? own_variance : shared_variance);
}

SkyPair find_sky_pair(const Scene& old_scene, const Scene& new_scene) {
    SkyPair pair;
    const Emitter *before = sky_of(old_scene), *after = sky_of(new_scene);
    if (!before || !after || !(before->map || after->map) || old_scene.environment_idx != new_scene.environment_idx)
        return pair;
    const Scene old_sky = sky_alone(old_scene), new_sky = sky_alone(new_scene);
    pair.own_variance = relative_variance(old_sky, new_sky);
    if (is_turned(*before, *after)) return pair;
    auto shared = proposals_of(old_sky, new_sky);
    if (!shared) return pair;
    pair.shared_variance = relative_variance(sky_alone(old_scene, shared), sky_alone(new_scene, shared));
    if (pair.shared_variance < pair.own_variance) pair.shared = std::move(shared);
    return pair;
}

std::shared_ptr<const Scene> with_proposals(const Scene& scene, std::shared_ptr<const SkyProposals> proposals) {
    auto copy = std::make_shared<Scene>(scene);
    copy->emitters[std::size_t(scene.environment_idx)].proposals = std::move(proposals);
    return copy;
}

}  // namespace loom::residual
