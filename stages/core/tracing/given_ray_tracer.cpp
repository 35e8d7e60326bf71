#include "stages/core/tracing/given_ray_tracer.h"

namespace loom {

GivenRayTracer::GivenRayTracer(const Scene& scene, const PathOptions& options, const OptionalColumns& columns)
    : batch_(scene, options), graph_(scene, options, columns) {
    records_.keeps_misses = columns.misses;
}

const PathGraph& GivenRayTracer::trace(std::span<const GivenRay> rays) {
    results_.resize(rays.size());
    batch_.trace(rays, results_, records_);
    return graph_.set(records_);
}

}  // namespace loom
