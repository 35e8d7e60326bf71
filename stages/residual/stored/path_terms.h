#pragma once
// What one path of a graph gains, term by term.

#include <cstdint>

#include "stages/residual/stored/stored_block.h"

namespace loom::residual {

/// Walks along a stored path, vertex by vertex, and computes what each of its light edges contributes, to the last bit as
/// the tracer did.
///   L = Le + sum over light edges of beta_j f Li w / p                                          (PathBatch)
class PathTerms {
  public:
    /// in:      path     of the graph
    ///          edge     its first light edge, or that of a later path
    ///          sampler  its random numbers
    PathTerms(const StoredPaths& paths, std::size_t path, std::size_t edge, const Sampler& sampler)
        : paths_(paths),
          first_(paths.graph().paths.first_vertex[path]),
          last_(paths.graph().paths.first_vertex[path + 1]),
          vertex_(first_),
          edge_(edge) {
        block_.start(paths, path, path + 1);
        vertices_ = block_.path(path, sampler);
    }

    /// Row of the vertex that the walk has reached, and whether there is none left.
    std::size_t vertex() const { return vertex_; }
    bool ended() const { return vertex_ == last_; }
    /// Row of the next light edge of this vertex.
    std::size_t edge() const { return edge_; }
    bool has_edge() const {
        const auto& of = paths_.graph().light_edges.vertex;
        return edge_ < of.size() && of[edge_] == vertex_;
    }

    /// Returns the contribution of the next light edge, and moves past it.
    /// needs:   has_edge()
    Spectrum take_edge();
    /// Moves to the next vertex.
    /// needs:   no edges left
    void advance();

  private:
    bool is_hit(std::size_t edge) const {
        return paths_.graph().light_edges.technique[edge] == std::uint8_t(LightTechnique::bsdf_hit);
    }
    /// Sets the throughput to that of the ray that leaves the vertex.
    void leave();

    const StoredPaths& paths_;
    StoredBlock block_;
    std::span<StoredVertex> vertices_;  // of the path
    std::size_t first_, last_, vertex_, edge_;
    Spectrum beta_{1};
    bool left_ = false;  // beta_ includes the sample of this vertex
};

}  // namespace loom::residual
