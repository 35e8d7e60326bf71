#pragma once
// What an edit can change of paths that were traced in the old scene: where it stands, what it does to lights, and
// whether there is anything that it leaves alone.

#include <algorithm>
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "stages/core/edit/edit.h"
#include "stages/core/scene/embree.h"
#include "stages/core/scene/scene.h"

namespace loom {

/// Shapes that a segment may meet, a little larger than they are, so that a ray that is known to its last bits but a
/// few meets all that it met.
class Obstacles {
  public:
    void add(const Shape& shape);
    /// in:      around  how far from its surface a ray may start, m
    void finish(float around);

    bool empty() const { return shapes_.empty(); }
    /// Around all of them, each with what a ray may start off its surface: a ray that meets no box meets no obstacle.
    const std::vector<Box3f>& boxes() const { return boxes_; }
    /// False: no ray that starts at a, or `around` from it, and ends at b meets one.
    bool may_meet(const Point3f& a, const Point3f& b) const { return !apart(a, {b, b}) && crosses(a, b); }
    /// The same of all rays from a along the unit vector d.
    bool may_meet(const Point3f& a, const Vector3f& d) const;
    /// The same of all rays from a to anywhere in a box.
    bool may_meet(const Point3f& a, const Box3f& to) const { return !apart(a, to); }
    /// out:     met  by ray: it does meet one
    void meet(const Ray* const* rays, std::size_t n, bool* met) const { rays_->occluded(rays, n, met); }

  private:
    /// A point and a box lie on one side of all obstacles.
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

/// Which places, shapes and lights of the old scene are not to the last bit what they are in the new one. What
/// find_edit() takes for the same may differ in bits (numbers of more than nine digits, places that are the same to
/// 1e-7): it is changed.
struct EditReach {
    EditReach(const Scene& old_scene, const Scene& new_scene, const Edit& edit);

    std::string everything;  // why no path is known to be the same; empty: some may be
    // of the old scene, by shape: stands or scatters otherwise now, shines otherwise and not just relit, or is gone
    std::vector<std::uint8_t> shapes;
    // of those, by shape: its material in the new scene, if that is all that has changed and a vertex without texture
    // coordinates is enough to know either BSDF; -1: else
    std::vector<int> repainted;
    // of the old scene, by emitter: where it shines, or its density, is not the same, or what arrives from it depends
    // on where
    std::vector<std::uint8_t> emitters;
    // of the others, by emitter: it sends one radiance everywhere, not black, and now another one
    std::vector<std::uint8_t> relit;
    bool sky = false;  // the emitter at infinity all around is changed so
    bool any_emitter = false, any_relit = false;
    bool dark_light = false;  // a shape that shines, reflects nothing and is changed: a path may end there untold
    Obstacles old_places, new_places;  // of what moved, came or went

    /// Bounds of all points that light is sampled on; unbounded where a light is at infinity.
    bool bounded_lights = true;
    Box3f lights;
};

}  // namespace loom
