#include "stages/residual/dynamic/touch_observer.h"

#include "stages/core/scene/embree.h"
#include "stages/core/tracing/path_tracer.h"

namespace loom::residual {

TouchObserver::TouchObserver(const Scene& scene, EditTargets targets)
    : scene_(scene),
      targets_(std::move(targets)),
      columns_(PathBatch::capacity),
      rays_(PathBatch::capacity),
      blocked_(new bool[PathBatch::capacity]) {
    waiting_.reserve(PathBatch::capacity);
    segments_.reserve(PathBatch::capacity);
}

void TouchObserver::start(std::size_t n) {
    touched_.assign(n, 0);
}

bool TouchObserver::is_target(const Hit& hit, const LightQuery& light) const {
    if (!hit) return targets_.environment;
    const int emitter = scene_.shapes[hit.shape_idx].emitter_idx;
    return targets_.shapes[hit.shape_idx] || (emitter >= 0 && targets_.emitters[std::size_t(emitter)]) ||
           (light.kind == LightQuery::Kind::point && !scene_.emitters.empty() &&
            targets_.emitters[light.point.emitter_idx]);
}

void TouchObserver::add_segment(std::uint32_t path, const Ray& segment) {
    columns_.set(waiting_.size(), segment);
    waiting_.push_back(path);
    segments_.push_back(segment);
}

void TouchObserver::arrive(std::span<const std::uint32_t> paths, std::span<const Ray* const> rays,
                           std::span<const Hit> hits, std::span<const LightQuery> lights) {
    for (std::size_t k = 0; k < paths.size(); ++k) {
        std::uint8_t& touched = touched_[paths[k]];
        touched |= std::uint8_t(!touched && is_target(hits[k], lights[k]));
        if (touched) continue;
        Ray segment = *rays[k];
        if (hits[k]) segment.t_max = hits[k].t * (1 - point_epsilon);
        add_segment(paths[k], segment);
    }
    test_segments();
}

void TouchObserver::trace_shadow_rays(std::span<const std::uint32_t> paths, std::span<const Ray* const> rays) {
    for (std::size_t k = 0; k < paths.size(); ++k)
        if (!touched_[paths[k]]) add_segment(paths[k], *rays[k]);
    test_segments();
}

void TouchObserver::test_segments() {
    find_met(columns_, waiting_.size(), targets_.boxes.data(), targets_.boxes.size());
    std::size_t n = 0;
    for (std::size_t k = 0; k < waiting_.size(); ++k) {
        if (!columns_.met[k]) continue;
        rays_[n] = &segments_[k];
        waiting_[n++] = waiting_[k];
    }
    if (n > 0) targets_.passed->occluded(rays_.data(), n, blocked_.get());
    for (std::size_t k = 0; k < n; ++k)
        if (blocked_[k]) touched_[waiting_[k]] = 1;
    waiting_.clear();
    segments_.clear();
}

}  // namespace loom::residual
