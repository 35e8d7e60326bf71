#pragma once
#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "formats/path_graph.h"
#include "stages/core/scene/scene.h"
#include "stages/core/transport/path_record.h"
#include "stages/core/transport/path_tracer.h"

namespace loom {

/// Columns of consecutive paths while a worker fills them; only those that the scene needs. Rows are numbered
/// from the first of these paths, and `first_vertex` holds, for each path, where the next one begins.
struct GraphRows : PathRows<GrowingColumn> {
    void append(const PathRecord& path, const Scene& scene, bool roulette);
};

/// Collects the rows of all workers, packed tightly into huge pages, and numbers them through.
class GraphBuilder {
  public:
    explicit GraphBuilder(std::size_t n_pieces) : pieces_(n_pieces), arena_(std::make_shared<Arena>()) {}

    /// Takes a worker's rows as the i-th piece and empties them. From any thread, once for each i.
    void set(std::size_t i, GraphRows& rows);

    /// The pieces, in their order, as a graph of `samples` samples per pixel, with what it says of the scene.
    PathGraphInPieces finish(const Scene& scene, const PathOptions& options, std::uint64_t first_sample,
                             std::uint64_t samples) &&;

  private:
    using Piece = std::vector<std::span<std::byte>>;  // columns in the order of their declaration
    std::vector<Piece> pieces_;
    std::shared_ptr<Arena> arena_;
};

/// Names as on disk and on command lines.
std::string_view roulette_name(Roulette roulette);
std::string_view sampler_name(SamplerKind sampler);

}  // namespace loom
