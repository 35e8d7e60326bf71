#pragma once
// Parts of the old scene's paths that an edit can change: changed geometry, changed lights, and whether any path can be
// unchanged at all.

#include <algorithm>
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "stages/core/edit/edit.h"
#include "stages/core/scene/embree.h"
#include "stages/core/scene/scene.h"

namespace loom {

/// Shapes that a segment may hit, slightly enlarged, so that a ray known up to its last few bits hits all that the
/// exact ray hits.
class Obstacles {
  public:
    void add(const Shape& shape);
    /// in:      around  maximum distance of a ray's start from its surface, m
    void finish(float around);

    bool empty() const { return shapes_.empty(); }
    /// Bounds of all shapes, each enlarged by the start offset of a ray: a ray that hits no box hits no obstacle.
    const std::vector<Box3f>& boxes() const { return boxes_; }
    /// Returns false only if no ray hits an obstacle that starts at a, or within `around` of it, and ends at b.
    bool may_meet(const Point3f& a, const Point3f& b) const { return !apart(a, {b, b}) && crosses(a, b); }
    /// Tests all rays from a along the unit vector d.
    bool may_meet(const Point3f& a, const Vector3f& d) const;
    /// Tests all rays from a to any point in a box.
    bool may_meet(const Point3f& a, const Box3f& to) const { return !apart(a, to); }
    /// out:     met  [ray] whether it hits an obstacle
    void meet(const Ray* const* rays, std::size_t n, bool* met) const { rays_->occluded(rays, n, met); }

  private:
    /// Whether all obstacles lie on one side of a point and a box.
    bool apart(const Point3f& a, const Box3f& to) const {
        bool is = false;
        for (int k = 0; k < 3; ++k)
            is |= (std::max(a[k], to.hi[k]) < box_.lo[k]) | (std::min(a[k], to.lo[k]) > box_.hi[k]);
        return is;
    }
    bool crosses(const Point3f& a, const Point3f& b) const {
        const Vector3f d = b - a;
        return box_.met_by(a, {1 / d.x, 1 / d.y, 1 / d.z}, 0, 1);
    }

    std::vector<Shape> shapes_;
    std::unique_ptr<RayEngine> rays_;
    Box3f box_;
    std::vector<Box3f> boxes_;
};

/// Geometry, shapes and lights of the old scene that differ in any bit from the new one. What find_edit() treats as
/// equal may differ in bits (numbers of more than nine digits, placements equal to 1e-7); it counts as changed here.
struct EditReach {
    EditReach(const Scene& old_scene, const Scene& new_scene, const Edit& edit);

    std::string everything;  // reason why every path may have changed; empty: some may be unchanged
    // [shape of the old scene] moved, scatters or emits differently (other than relit only), or is removed
    std::vector<std::uint8_t> shapes;
    // [shape of the old scene] its material in the new scene, if only that has changed and a vertex without texture
    // coordinates suffices to evaluate both BSDFs; -1: else
    std::vector<int> repainted;
    // [emitter of the old scene] its position or density has changed, or its emission depends on position or direction
    // and has changed
    std::vector<std::uint8_t> emitters;
    // [emitter of the old scene] of the others: emits one non-zero radiance everywhere, and now another one
    std::vector<std::uint8_t> relit;
    bool sky = false;  // the environment emitter is changed in this sense
    bool any_emitter = false, any_relit = false;
    bool dark_light = false;  // a changed shape that emits but reflects nothing: a path may end there without a record
    Obstacles old_places, new_places;  // shapes that moved, were removed or added

    /// Bounds of all points that light sampling can choose; unbounded with a light at infinity.
    bool bounded_lights = true;
    Box3f lights;
};

}  // namespace loom
