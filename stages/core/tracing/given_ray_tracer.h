#pragma once
#include <span>
#include <vector>

#include "stages/core/tracing/graph_builder.h"
#include "stages/core/tracing/path_tracer.h"

namespace loom {

/// Traces paths that start with given rays into a graph that walk_in_time() and other walkers read: for every light that
/// arrives along a ray, its radiance and its length from the ray's origin. State of one thread.
///     GivenRayTracer tracer(scene, options);
///     const GraphReader reader(tracer.graph());
///     const OpticalLengths lengths(tracer.graph(), Timing{});
///     for each batch: tracer.trace(rays), then for each ray walk_in_time(reader, lengths, i, edge, on_light)
/// Results depend neither on the other rays of a batch nor on the thread.
class GivenRayTracer {
  public:
    /// in:      scene    borrowed
    ///          options  its seed must differ from that of paths that must be independent of these (streams.h)
    explicit GivenRayTracer(const Scene& scene, const PathOptions& options, const OptionalColumns& columns = {});

    /// Traces a batch of rays, at most PathBatch::capacity; full batches are fastest.
    /// out:     graph()  path i starts with ray i: paths/origin is the ray's origin, paths/Le the emission that the ray
    ///                   itself hits, at full weight. The throughput of the ray is 1. The former paths are lost.
    const PathGraph& trace(std::span<const GivenRay> rays);

    /// Returns the paths of the last batch. The graph stays at one address, so that one GraphReader reads all batches.
    const PathGraph& graph() const { return graph_.graph(); }
    /// Returns the sum of the radiance along each ray of the last batch, its first hit, and the effort. Vertices before
    /// the ray do not count.
    std::span<const PathResult> results() const { return results_; }

  private:
    PathBatch batch_;
    PathRecords records_;
    std::vector<PathResult> results_;
    BatchGraph graph_;
};

}  // namespace loom
