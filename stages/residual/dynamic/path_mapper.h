#pragma once
// Path mappings: map a path sampled in one scene of an edit to its partner in the other.           [RP] §5

#include "stages/residual/dynamic/path_finder.h"

namespace loom::residual {

/// Reason why a path has no mapped partner and is left to the pair with the same random stream.
enum class Rejection : std::uint8_t {
    none,
    moved,     // a vertex lies on another moving shape, or the start has no counterpart
    crossed,   // a kept segment crosses a shape of the other scene
    blocked,   // a new segment is occluded
    specular,  // a new segment ends at a perfectly specular or too smooth vertex
    near,      // a new segment, or the one that it replaces, is too short
    light,     // the light differs there, or emits to the other side
    black,     // the partner contributes zero
};
inline constexpr int n_rejections = 8;

struct MappingLimits {
    float alpha_min = 0.2f;  // microfacet roughness
    float d_min = 0;         // m
};

struct MappedPath {
    FullPath path;
    double density_ratio = 1;  // Jacobian |T'|: geometry terms of this path over those of the base path
};

/// Keeps every vertex in place except the start of the path, which moves with its shape.
///   x_D -> its place in the other scene, |t'| = 1         [RP] Eq. (18)
///   all others -> themselves: both neighbours of x_D are reconnected to it, at once     [RP] Eq. (19) to (21)
/// The rule is symmetric: p to q is accepted exactly if q to p is.
/// differs: no walk with the same random stream before reconnection; a path that cannot be reconnected at once is left
///          to the pair with the same random stream. No limit on the Jacobian: the weights of pairs bound it.
class PathMapper {
  public:
    PathMapper(const DynamicScenes& scenes, bool from_new, const MappingLimits& limits);

    /// Must be called before the paths of another sample: paths of one sample share computed results.
    void start_sample() { reconnected_.base = nullptr; }
    /// Maps a path.
    /// in:  path, found  the path, and the technique that sampled it in the source scene
    /// out: its partner, valid until the next call; null: rejected for the reason `why`
    const MappedPath* map(const FullPath& path, const Found& found, Rejection& why);

    std::uint64_t n_rays = 0;

  private:
    const MappedPath* reject(Rejection& why, Rejection reason) {
        why = reason;
        return nullptr;
    }
    bool smooth_enough(const Vertex& v) const;

    /// The start of a path at its new place and its segments to its neighbours. All paths of a sample through these
    /// three vertices share it.
    struct Reconnected {
        const Vertex *base = nullptr, *before = nullptr, *next = nullptr;  // of the path; next null: the light
        Rejection why = Rejection::none;
        Vertex moved;
        Segment towards_sensor, towards_light;
        LightEnd light;            // when there is no next vertex
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
    std::vector<Vertex> places_;  // vertices that differ in the other scene
};

}  // namespace loom::residual
