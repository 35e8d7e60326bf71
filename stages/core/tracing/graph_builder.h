#pragma once
#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "formats/path_graph.h"
#include "stages/core/scene/scene.h"
#include "stages/core/tracing/path_record.h"
#include "stages/core/tracing/path_tracer.h"

namespace loom {

/// Columns of a graph that are stored only on request.
struct OptionalColumns {
    bool misses = false;      // failed light samples
    bool primitives = false;  // triangle of each vertex
    bool media = false;       // material of each segment's medium, in a scene with dielectrics
};

/// Collects the paths of all workers in huge pages, as a structure of arrays, and numbers their vertices consecutively.
class GraphBuilder {
  public:
    /// in:      n_pieces  batches to come
    ///          memory    for their columns; its former contents are lost
    GraphBuilder(const Scene& scene, const PathOptions& options, std::size_t n_pieces, std::shared_ptr<Arena> memory,
                 const OptionalColumns& columns);

    /// Takes a batch as the i-th piece. From any thread, once for each i.
    void set(std::size_t i, const PathRecords& records);

    /// The pieces, in their order, as a graph of `samples` samples per pixel, with what it says of the scene.
    PathGraphInPieces finish(std::uint64_t first_sample, std::uint64_t samples) &&;

  private:
    using Rows = PathRows<PlacedColumn>;
    using Piece = std::vector<std::span<std::byte>>;  // columns in the order of their declaration

    const Scene& scene_;
    PathOptions options_;
    Rows wanted_;
    std::vector<Piece> pieces_;
    std::shared_ptr<Arena> arena_;
};

/// Graph of one batch of paths at a time, to be walked and not to be written. Its columns are in memory that the next
/// batch reuses; what it says of the scene is set once. Every path has its paths/origin.
class BatchGraph {
  public:
    BatchGraph(const Scene& scene, const PathOptions& options, const OptionalColumns& columns);

    /// Replaces the paths of the graph.
    const PathGraph& set(const PathRecords& records);
    /// Returns the graph, always at the same address.
    const PathGraph& graph() const { return graph_; }

  private:
    PathRows<PlacedColumn> wanted_;
    Arena arena_;
    PathGraph graph_;
};

/// Names as on disk and on command lines.
std::string_view roulette_name(Roulette roulette);
std::string_view sampler_name(SamplerKind sampler);

}  // namespace loom
