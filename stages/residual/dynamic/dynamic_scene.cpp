#include "stages/residual/dynamic/dynamic_scene.h"

#include "stages/core/sampling/warp.h"
#include "stages/core/tracing/vertex_rules.h"

namespace loom::residual {
namespace {

/// Returns the part of a shape that a ray engine reads.
Shape geometry_of(const Shape& shape) {
    Shape copy = shape;
    copy.emitter_idx = -1;
    return copy;
}

Normal3f normal_at(const Shape& shape, const Hit& hit, const Point3f& p) {
    if (shape.kind == ShapeKind::mesh) return shape.triangles[hit.primitive_idx].ng;
    if (shape.kind == ShapeKind::sphere) return Normal3f(normalize(p - shape.round.center));
    return shape.round.disk_normal();
}

/// Returns boxes around shapes, one per shape while they are few. Testing many boxes costs as much as tracing the
/// shapes.
std::vector<Box3f> boxes_around(const std::vector<Shape>& shapes, float grown_by) {
    constexpr std::size_t most = 16;
    std::vector<Box3f> boxes;
    for (const Shape& shape : shapes) {
        Box3f box = shape.bounds();
        box.grow(grown_by);
        if (boxes.size() < most)
            boxes.push_back(box);
        else
            boxes.back().add(box);
    }
    return boxes;
}

bool black(const Scene& scene, std::uint32_t shape) {
    return scene.materials[scene.shapes[shape].material_idx].black();
}

bool sided(const Scene& scene, const Shape& shape) {
    const Material& material = scene.materials[shape.material_idx];
    return material.perturbed() || material.back_idx >= 0;
}

}  // namespace

void SiteShapes::add(const Scene& scene, std::uint32_t index, Member member, bool scatters) {
    const Shape& shape = scene.shapes[index];
    std::vector<double> areas;
    double area = 0;
    if (shape.kind == ShapeKind::mesh) {
        for (const TriangleRecord& t : shape.triangles)
            areas.push_back(0.5 * length(cross(Vector3<double>(t.e1), Vector3<double>(t.e2))));
        if (std::none_of(areas.begin(), areas.end(), [](double a) { return a > 0; })) return;
        triangles_.emplace_back(areas);
        area = triangles_.back().sum();
    } else {
        triangles_.emplace_back();
        area =
            shape.kind == ShapeKind::sphere
                ? 4 * pi_double * sqr(double(shape.round.radius))
                : pi_double * length(cross(Vector3<double>(shape.round.u_axis), Vector3<double>(shape.round.v_axis)));
    }
    members_.push_back(member);
    shapes_.push_back(&shape);
    areas_.push_back(area);
    scattering_areas_.push_back(scatters ? area : 0);
}

void SiteShapes::finish() {
    if (areas_.empty()) return;
    by_area_ = Distribution1(areas_);
    if (std::any_of(scattering_areas_.begin(), scattering_areas_.end(), [](double a) { return a > 0; }))
        by_scattering_area_ = Distribution1(scattering_areas_);
}

SitePoint SiteShapes::sample(Start start, float u_choice, Point2f u) const {
    SitePoint point;
    point.member = std::uint32_t(by_area(start).sample(u_choice));
    const Shape& shape = *shapes_[point.member];
    point.hit.shape_idx = point.member;
    if (shape.kind == ShapeKind::mesh) {
        point.hit.primitive_idx = std::uint32_t(triangles_[point.member].sample(u_choice));
        const Point2f b = sample_triangle(u);
        point.hit.u = b.x;
        point.hit.v = b.y;
        const TriangleRecord& t = shape.triangles[point.hit.primitive_idx];
        point.p = t.point(b.x, b.y);
    } else if (shape.kind == ShapeKind::sphere) {
        point.p = shape.round.sphere_point(sample_uniform_sphere(u));
    } else {
        const Point2f d = sample_concentric_disk(u);
        point.hit.u = d.x;
        point.hit.v = d.y;
        point.p = shape.round.disk_point(d.x, d.y);
    }
    point.ng = normal_at(shape, point.hit, point.p);
    return point;
}

Vertex DynamicScene::vertex(const Ray& ray, const Hit& hit) const {
    Vertex v;
    v.at = scene.surface(ray, hit);
    v.here = shading_point(scene, v.at, -ray.d);
    v.hit = hit;
    v.site = site_of[hit.shape_idx];
    v.sided = sided(scene, scene.shapes[hit.shape_idx]);
    return v;
}

void DynamicScene::aim(const Vertex& v, const Vector3f& wo, ShadingPoint& here) const {
    if (v.sided) {
        Hit hit = v.hit;
        hit.t = 0;
        here = shading_point(scene, scene.surface({v.at.p, -wo}, hit), wo);
        return;
    }
    here.wo = wo;
    here.wo_local = here.frame.to_local(wo);
}

Vertex DynamicScene::vertex(const SitePoint& point, std::uint32_t shape, const Vector3f& wo) const {
    Hit hit = point.hit;
    hit.shape_idx = shape;
    hit.t = 0;
    return vertex(Ray{point.p, -wo}, hit);
}

std::uint32_t DynamicScene::cross(const Ray& ray, Crossings& crossings) const {
    if (!ghost_rays) return 0;
    const Vector3f inv_d{1 / ray.d.x, 1 / ray.d.y, 1 / ray.d.z};
    if (std::none_of(ghost_boxes.begin(), ghost_boxes.end(),
                     [&](const Box3f& box) { return box.met_by(ray.o, inv_d, ray.t_min, ray.t_max); }))
        return 0;
    ghost_rays->crossings(ray, crossings.scratch);
    for (const Hit& hit : crossings.scratch) {
        const Point3f p = ray.o + ray.d * hit.t;
        crossings.all.push_back({p, normal_at(ghosts[hit.shape_idx], hit, p), hit.shape_idx, hit.primitive_idx});
    }
    return std::uint32_t(crossings.scratch.size());
}

DynamicScenes::DynamicScenes(const Scene& old_, const Scene& new_, const Edit& edit)
    : new_scene(new_, true), old_scene(old_, false) {
    for (DynamicScene* side : {&old_scene, &new_scene}) {
        const auto& shapes = side->is_new ? edit.new_shapes : edit.old_shapes;
        const auto& emitters = side->is_new ? edit.new_emitters : edit.old_emitters;
        side->site_of.assign(shapes.size(), no_site);
        for (const ShapeEdit& shape : shapes) {
            side->partner_of.push_back(shape.partner_idx);
            side->to_partner.push_back({shape.to_partner});
        }
        for (std::uint32_t i = 0; i < shapes.size(); ++i) {
            const ShapeEdit& shape = shapes[i];
            const bool moves = shape.dynamic(), repainted = (shape.changes & shape_change::repainted) != 0;
            if (!moves && !repainted) continue;
            const Site site = moves ? side->own_site() : Site::repainted;
            side->site_of[i] = std::uint8_t(site);
            if (moves) movers.push_back(geometry_of(side->scene.shapes[i]));
            if (!moves && !side->is_new) continue;
            const bool scatters = !black(side->scene, i) || (!moves && !black(old_, shape.partner_idx));
            sites[std::size_t(site)].add(
                side->scene, i,
                side->is_new ? SiteShapes::Member{i, shape.partner_idx} : SiteShapes::Member{shape.partner_idx, i},
                scatters);
        }
        for (const EmitterEdit& emitter : emitters) {
            side->changed_emitter.push_back(emitter.changed);
            lights_changed |= emitter.changed;
        }
    }
    same_choice_of_lights = old_.emitters.size() == new_.emitters.size();
    for (std::size_t i = 0; same_choice_of_lights && i < new_.emitters.size(); ++i)
        same_choice_of_lights = edit.new_emitters[i].partner_idx == i &&
                                old_.emitters[i].sampling_weight == new_.emitters[i].sampling_weight;
    for (SiteShapes& site : sites) site.finish();
    for (DynamicScene* side : {&old_scene, &new_scene}) {
        const Scene& other = side->is_new ? old_ : new_;
        for (const SiteShapes::Member& m : at(side->ghost_site()).members())
            side->ghosts.push_back(geometry_of(other.shapes[side->is_new ? m.old_shape : m.new_shape]));
        if (!side->ghosts.empty())
            side->ghost_rays = std::make_unique<RayEngine>(side->ghosts, RayEngine::Use::crossings);
        side->ghost_boxes = boxes_around(side->ghosts, 1e-4f * side->scene.radius);
    }
    if (!movers.empty()) mover_rays = std::make_unique<RayEngine>(movers);
}

EditTargets DynamicScenes::targets(const DynamicScene& side) const {
    EditTargets targets;
    targets.passed = mover_rays.get();
    targets.boxes = boxes_around(movers, 1e-4f * side.scene.radius);
    for (const std::uint8_t site : side.site_of) targets.shapes.push_back(site != no_site);
    targets.emitters.assign(side.changed_emitter.begin(), side.changed_emitter.end());
    targets.environment =
        side.scene.environment_idx >= 0 && side.changed_emitter[std::size_t(side.scene.environment_idx)];
    return targets;
}

}  // namespace loom::residual
