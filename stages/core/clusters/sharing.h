#pragma once
#include <cstddef>
#include <cstdint>
#include <vector>

#include "formats/path_graph.h"

namespace loom {

/// Decides which vertices of a path graph share their samples with their neighbours. This is the only implementation of
/// the rule: the stage that makes clusters and the stages that use them must agree.
///
/// A vertex shares when a neighbour's sample has a finite, not too peaked density there. This holds when it has a
/// diffuse lobe beside at most delta ones (diffuse, smooth plastic). It also holds when its smooth lobes are all at
/// least `private_roughness` wide (microfacet alpha, the smaller of both axes; for Phong sqrt(2 / (exponent + 2))).
/// Solitary are mirrors, smooth glass, null and fully transparent surfaces, and nearly specular ones. Rough plastic
/// below the limit is solitary too: its diffuse lobe could share, its narrow lobe could not. The continuation of the
/// path has no influence: a vertex where the path ended at max_depth shares too.
/// differs: the paper does not specify delta lobes
class SharingRule {
  public:
    /// Borrows the graph and examines each material once.
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
