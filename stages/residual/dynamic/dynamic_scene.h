#pragma once
// The two scenes of an edit, prepared for sampling paths through the edit: which shapes are dynamic, which are ghosts,
// and sample points on both.                                                                  [RP] §3.3, §4.1, §4.2

#include <array>
#include <cstdint>
#include <memory>
#include <vector>

#include "stages/core/edit/edit.h"
#include "stages/core/sampling/distribution.h"
#include "stages/core/scene/embree.h"
#include "stages/core/scene/scene.h"
#include "stages/core/scene/shading.h"
#include "stages/residual/dynamic/touch_observer.h"

namespace loom::residual {

/// Surfaces of the edit: present in the new scene only, in the old scene only, or in both with different BSDFs. The
/// first are dynamic in the new scene and ghosts in the old one. The second are ghosts in the new scene and dynamic in
/// the old one. The third are dynamic in both.
enum class Site : std::uint8_t { new_place, old_place, repainted };
inline constexpr int n_sites = 3;
inline constexpr std::uint8_t no_site = 255;

/// A point on a site, uniform by area.
struct SitePoint {
    std::uint32_t member = 0;  // index of the shape in the site
    Hit hit;                   // hit on that shape; t is unset
    Point3f p;
    Normal3f ng;
};

/// Start of a path: a scattering vertex, or a point that the path only passes through. Black shapes, such as most
/// emitters, do not scatter; they are ghosts, because they occlude.
enum class Start : std::uint8_t { scattering, passing };

/// The shapes of a site, in the order of their scene (for repainted ones, the new scene).
class SiteShapes {
  public:
    struct Member {
        std::uint32_t new_shape = ShapeEdit::none, old_shape = ShapeEdit::none;
    };
    void add(const Scene& scene, std::uint32_t shape, Member member, bool scatters);
    void finish();

    bool empty() const { return members_.empty(); }
    bool scatters() const { return area(Start::scattering) > 0; }    // anywhere
    double area(Start start) const { return by_area(start).sum(); }  // m^2
    const std::vector<Member>& members() const { return members_; }
    /// Samples a point; equal for both starts where no shape is black.
    /// in: u_choice, u  [0, 1)
    SitePoint sample(Start start, float u_choice, Point2f u) const;

  private:
    const Distribution1& by_area(Start start) const {
        return start == Start::scattering ? by_scattering_area_ : by_area_;
    }

    std::vector<Member> members_;
    std::vector<const Shape*> shapes_;
    std::vector<Distribution1> triangles_;
    std::vector<double> areas_, scattering_areas_;
    Distribution1 by_area_, by_scattering_area_;
};

/// Intersection of a segment with a ghost.
struct Crossing {
    Point3f p;
    Normal3f n;
    std::uint32_t member = 0, primitive = 0;
};

/// Crossings of all segments of a sample; those of one segment are consecutive.
struct Crossings {
    std::vector<Crossing> all;
    std::vector<Hit> scratch;
};

/// A surface point where a path scatters.
struct Vertex {
    SurfacePoint at;
    ShadingPoint here;  // for the direction of the ray that found it
    Hit hit;
    std::uint8_t site = no_site;  // site of the edit when its shape is dynamic in this scene
    bool sided = false;           // its material or normal depends on the side
};

/// Maps points from one scene to the other.
struct RigidMotion {
    Matrix4d matrix;
    Point3f operator()(const Point3f& p) const {
        const Point3<double> q = matrix.point({double(p.x), double(p.y), double(p.z)});
        return {float(q.x), float(q.y), float(q.z)};
    }
};

/// One of the two scenes of an edit.
struct DynamicScene {
    DynamicScene(const Scene& scene_, bool is_new_) : scene(scene_), is_new(is_new_) {}

    const Scene& scene;
    bool is_new;
    std::vector<std::uint8_t> site_of;      // [shape] site on which it is dynamic, or no_site
    std::vector<std::uint32_t> partner_of;  // [shape] its index in the other scene, or ShapeEdit::none
    std::vector<RigidMotion> to_partner;    // [shape] maps its points to those of its partner
    std::vector<bool> changed_emitter;      // [emitter]
    std::vector<Shape> ghosts;              // [member of the ghosts' site]
    std::unique_ptr<RayEngine> ghost_rays;  // null: none
    std::vector<Box3f> ghost_boxes;         // a few boxes around the ghosts

    Site own_site() const { return is_new ? Site::new_place : Site::old_place; }
    Site ghost_site() const { return is_new ? Site::old_place : Site::new_place; }

    Vertex vertex(const Ray& ray, const Hit& hit) const;
    /// Returns the vertex evaluated for light that leaves along wo.
    ShadingPoint aimed(const Vertex& vertex, const Vector3f& wo) const {
        ShadingPoint here = vertex.here;
        aim(vertex, wo, here);
        return here;
    }
    /// in, out: here  the vertex for light along some direction; afterwards for light along wo
    void aim(const Vertex& vertex, const Vector3f& wo, ShadingPoint& here) const;
    /// Returns the vertex at a point of a site that is dynamic here, viewed from wo.
    Vertex vertex(const SitePoint& point, std::uint32_t shape, const Vector3f& wo) const;
    /// Appends the ray's crossings of ghosts; returns their number.
    std::uint32_t cross(const Ray& ray, Crossings& crossings) const;
};

struct DynamicScenes {
    DynamicScenes(const Scene& old_scene, const Scene& new_scene, const Edit& edit);

    std::array<SiteShapes, n_sites> sites;
    DynamicScene new_scene, old_scene;
    std::vector<Shape> movers;              // shapes at both their old and new positions
    std::unique_ptr<RayEngine> mover_rays;  // null: none
    bool lights_changed = false;
    bool same_choice_of_lights = true;  // equal samples choose equal lights in both scenes

    /// Returns the parts of one scene by which a path may differ in the other.
    /// needs: same_choice_of_lights
    EditTargets targets(const DynamicScene& side) const;
    const SiteShapes& at(Site site) const { return sites[std::size_t(site)]; }
};

}  // namespace loom::residual
