#pragma once
// The parts of a residual by force: each scene's paths are traced by themselves, ray by ray, and every ray is tested
// against the shapes of the other scene that are not here. No two paths are compared.

#include <vector>

#include "stages/core/edit/edit_reach.h"
#include "stages/core/scene/embree.h"
#include "stages/core/tracing/path_step.h"

namespace loom::testing {

/// One scene of an edit, and what of it the other one lacks.
struct EditedSide {
    const Scene& scene;
    std::vector<bool> changed;          // [shape] touches a path that has a vertex on it
    std::vector<bool> changed_emitter;  // [emitter]
    std::vector<Shape> absent;          // shapes of the other scene that are not here, or elsewhere
    RayEngine in_the_way{absent};

    EditedSide(const Scene& scene_, std::vector<Shape> absent_) : scene(scene_), absent(std::move(absent_)) {}
};

/// in:      is_old  of the two scenes
inline std::unique_ptr<EditedSide> edited_side(const Scene& old_scene, const Scene& new_scene, const Edit& edit,
                                               const EditReach& reach, bool is_old) {
    const auto& mine = is_old ? edit.old_shapes : edit.new_shapes;
    const auto& theirs = is_old ? edit.new_shapes : edit.old_shapes;
    const Scene &scene = is_old ? old_scene : new_scene, &other = is_old ? new_scene : old_scene;
    std::vector<Shape> absent;
    for (std::size_t i = 0; i < other.shapes.size(); ++i) {
        const auto partner = theirs[i].partner_idx;
        const auto in_place = [&] {
            const Box3f a = other.shapes[i].bounds(), b = scene.shapes[partner].bounds();
            return a.lo == b.lo && a.hi == b.hi &&
                   other.shapes[i].mesh.positions == scene.shapes[partner].mesh.positions;
        };
        if (partner == ShapeEdit::none || theirs[i].dynamic() || !in_place()) absent.push_back(other.shapes[i]);
    }
    auto side = std::make_unique<EditedSide>(scene, std::move(absent));
    for (std::size_t i = 0; i < mine.size(); ++i) {
        const auto old = is_old ? std::uint32_t(i) : mine[i].partner_idx;
        side->changed.push_back(old == ShapeEdit::none || reach.shapes[old] != 0);
    }
    for (const EmitterEdit& emitter : is_old ? edit.old_emitters : edit.new_emitters)
        side->changed_emitter.push_back(emitter.changed);
    return side;
}

/// Returns what a path brings from where it first touches the edit on, and by light samples of changed emitters or across
/// a changed shape before that.
inline Spectrum touched_part(const EditedSide& side, const PathOptions& options, PathId id) {
    using namespace tracing;
    const Scene& scene = side.scene;
    const Sampler sampler(options.sampler, options.seed, id.pixel, id.sample);
    PathState path(scene, sampler, id, sampler.pair(film_pair));
    Spectrum part;
    bool touched = false;
    const auto crosses = [&](const Ray& ray, float t_max) {
        Ray until = ray;
        until.t_max = t_max;
        return side.in_the_way.occluded(until);
    };
    for (int depth = 1;; ++depth) {
        // Arrive at a vertex, at a light or nowhere.
        const Ray ray = path.ray;
        const Hit hit = depth == 1 ? scene.intersect_from_camera(ray) : scene.intersect(ray);
        LightQuery lights;
        lights.kind = !hit                         ? LightQuery::Kind::environment
                      : depth == options.max_depth ? LightQuery::Kind::nothing
                                                   : LightQuery::Kind::point;
        lights.u = sampler.pair(dimension(depth, Dimension::light));
        lights.d = ray.d;
        look_up_light(scene, lights);
        touched |= crosses(ray, hit ? hit.t : ray.t_max);
        const int emitter = hit ? scene.shapes[hit.shape_idx].emitter_idx : scene.environment_idx;
        const bool of_changed_light = emitter >= 0 && side.changed_emitter[std::size_t(emitter)];
        path.result.L = Spectrum(0);
        ShadowRequest shadow;
        const Step step = arrive<false>(scene, options, depth, hit, lights,
                                        sampler.pair(dimension(depth, Dimension::direction)), path, shadow, {});
        if (touched || of_changed_light) part += path.result.L;
        touched |= hit && side.changed[hit.shape_idx];

        // Sample a light.
        if (has(step, Step::needs_shadow_ray) && !scene.occluded(shadow.ray)) {
            const bool changed_light = side.changed_emitter[lights.point.emitter_idx];
            if (touched || changed_light || side.in_the_way.occluded(shadow.ray)) part += shadow.contribution;
        }
        if (!has(step, Step::goes_on)) return part;
    }
}

}  // namespace loom::testing
