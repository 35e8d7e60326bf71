#pragma once
#include <cstddef>
#include <cstdint>
#include <vector>

#include "formats/path_graph.h"

namespace loom {

/// Which vertices of a path graph share their samples with their neighbours. The one place for this rule: the
/// stage that makes clusters and those that use them must agree.
///
/// A vertex shares when a neighbour's sample has a finite, not too peaked density there: when it has a diffuse
/// lobe beside at most delta ones (diffuse, smooth plastic), or its smooth lobes are all at least
/// `private_roughness` wide (microfacet alpha, the smaller of both axes; for Phong sqrt(2 / (exponent + 2))).
/// Solitary are mirrors, smooth glass, null and wholly transparent surfaces, and nearly specular ones, rough
/// plastic below the limit included: its diffuse lobe would share, its narrow one would not.
/// How the path went on from the vertex does not matter: one that ended at max_depth shares too.
/// differs: the paper does not say what becomes of delta lobes
class SharingRule {
  public:
    /// The graph is borrowed. Costs one look at each material.
    SharingRule(const PathGraph& graph, float private_roughness);

    bool operator()(std::size_t vertex) const {
        const Kind kind = kinds_[graph_.vertices.material[vertex]];
        return kind == Kind::asks_vertex ? shares_by_own_parameters(vertex) : kind == Kind::shares;
    }

  private:
    enum class Kind : std::uint8_t { solitary, shares, asks_vertex };

    bool shares_by_own_parameters(std::size_t vertex) const;

    const PathGraph& graph_;
    float limit_;
    std::vector<Kind> kinds_;
};

}  // namespace loom
