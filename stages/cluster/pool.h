#pragma once
#include <cstddef>
#include <cstdint>

#include "formats/path_graph.h"
#include "stages/core/clusters/sharing.h"

namespace loom::cluster {

/// The vertices to cluster: those of one graph, or of two graphs, the second's after the first's.
class Pool {
  public:
    /// Borrows the graphs.
    /// in:  second  null: one graph alone
    Pool(const PathGraph& first, const PathGraph* second, float private_roughness)
        : first_(first),
          second_(second ? *second : first),
          first_shares_(first, private_roughness),
          second_shares_(second_, private_roughness),
          n_first_(first.n_vertices()),
          n_(n_first_ + (second ? second->n_vertices() : 0)),
          joint_(second != nullptr) {}

    struct Row {
        const PathGraph& graph;
        std::size_t row;
    };
    Row operator[](std::size_t vertex) const {
        return vertex < n_first_ ? Row{first_, vertex} : Row{second_, vertex - n_first_};
    }
    bool shares(std::size_t vertex) const {
        return vertex < n_first_ ? first_shares_(vertex) : second_shares_(vertex - n_first_);
    }
    std::size_t size() const { return n_; }
    /// Vertices from this index on belong to the second graph.
    std::size_t n_first() const { return n_first_; }
    /// Whether any vertex stores a medium other than vacuum.
    bool has_media() const { return !first_.vertices.eta.empty() || !second_.vertices.eta.empty(); }
    bool joint() const { return joint_; }
    /// Calls visit(graph, index of its first vertex in the pool).
    template <class Visitor>
    void for_each_graph(Visitor visit) const {
        visit(first_, std::size_t{0});
        if (joint_) visit(second_, n_first_);
    }

  private:
    const PathGraph &first_, &second_;
    SharingRule first_shares_, second_shares_;
    std::size_t n_first_, n_;
    bool joint_;
};

}  // namespace loom::cluster
