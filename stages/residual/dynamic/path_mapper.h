#pragma once
// Path mappings: from a path found in one scene of an edit to its partner in the other.            [RP] §5

#include "stages/residual/dynamic/path_finder.h"

namespace loom::residual {

/// Why a path has no partner other than what the same random numbers give.
enum class Rejection : std::uint8_t {
    none,
    moved,     // a vertex on another shape that moves, or a start without a counterpart
    crossed,   // a segment that the mapping keeps goes through where a shape stands in the other scene
    blocked,   // a new segment meets something
    specular,  // a perfectly specular or too smooth vertex at a new segment
    near,      // a new segment, or the one that it replaces, is too short
    light,     // the light is another one there, or shines the other way
    black,     // the partner carries nothing
};
inline constexpr int n_rejections = 8;

struct MappingLimits {
    float alpha_min = 0.2f;  // microfacet roughness
    float d_min = 0;         // m
};

struct MappedPath {
    FullPath path;
    double density_ratio = 1;  // of area products: what its measure grows by, over what the base's does
};

/// Keeps every vertex where it is, apart from the one that the path starts from: that goes with its shape.
///   x_D -> its place in the other scene, |t'| = 1         [RP] Eq. (18)
///   all others -> themselves: both neighbours of x_D are reconnected to it, at once     [RP] Eq. (19) to (21)
/// One rule for both directions: accepted from p to q exactly if from q to p.
/// differs: no walk by the same random numbers before reconnection; a path that cannot be reconnected at once is left
///          to the pair that the same random numbers make. No limit on the Jacobian: the weights of pairs bound it.
class PathMapper {
  public:
    PathMapper(const DynamicScenes& scenes, bool from_new, const MappingLimits& limits);

    /// Before the paths of another sample: what those of one have in common is worked out once.
    void start_sample() { reconnected_.base = nullptr; }
    /// in:  the path, and how it was found in the scene that paths come from
    /// out: its partner, valid until the next call; nothing: rejected, `why` says so
    const MappedPath* map(const FullPath& path, const Found& found, Rejection& why);

    std::uint64_t n_rays = 0;

  private:
    const MappedPath* reject(Rejection& why, Rejection reason) {
        why = reason;
        return nullptr;
    }
    bool smooth_enough(const Vertex& v) const;

    /// The start of a path in its new place and the segments that join it to its neighbours. All paths of a sample that
    /// go through the three have it in common.
    struct Reconnected {
        const Vertex *base = nullptr, *before = nullptr, *next = nullptr;  // of the path; next null: the light
        Rejection why = Rejection::none;
        Vertex moved;
        Segment towards_sensor, towards_light;
        LightEnd light;            // where there is no next
        double density_ratio = 1;  // of area products
        Interaction at_start;
    };
    void reconnect(const FullPath& path, std::size_t j);

    const DynamicScenes& scenes_;
    const DynamicScene &from_, &to_;
    MappingLimits limits_;
    MappedPath mapped_;
    Crossings crossings_;
    Reconnected reconnected_;
    std::vector<Vertex> places_;  // of the vertices that look otherwise there
};

}  // namespace loom::residual
