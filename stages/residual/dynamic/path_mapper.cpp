#include "stages/residual/dynamic/path_mapper.h"

namespace loom::residual {

PathMapper::PathMapper(const DynamicScenes& scenes, bool from_new, const MappingLimits& limits)
    : scenes_(scenes),
      from_(from_new ? scenes.new_scene : scenes.old_scene),
      to_(from_new ? scenes.old_scene : scenes.new_scene),
      limits_(limits) {
    mapped_.path.crossings = &crossings_.all;
}

bool PathMapper::smooth_enough(const Vertex& v) const {
    const Bsdf<float>& b = v.here.bsdf;
    switch (b.model->kind) {
        case BsdfKind::diffuse:
        case BsdfKind::rough_diffuse:
            return b.opacity == 1;
        case BsdfKind::rough_conductor:
        case BsdfKind::rough_dielectric:
        case BsdfKind::rough_plastic:
        case BsdfKind::ward:
            return b.opacity == 1 && std::min(b.alpha_u, b.alpha_v) >= limits_.alpha_min;
        case BsdfKind::phong:
            return std::sqrt(2 / (2 + b.exponent)) >= limits_.alpha_min;
        case BsdfKind::plastic:
            return b.opacity == 1;  // connected by its diffuse component
        default:
            return false;
    }
}

void PathMapper::reconnect(const FullPath& path, std::size_t j) {
    const std::size_t m = path.m();
    const Vertex &base = *path.places[j], &before = *path.places[j - 1];
    const Vertex* const next = j + 1 < m ? path.places[j + 1] : nullptr;
    Reconnected& r = reconnected_;
    if (r.base == &base && r.before == &before && r.next == next) return;
    r.base = &base;
    r.before = &before;
    r.next = next;
    crossings_.all.clear();
    r.why = [&] {
        const std::uint32_t shape = from_.partner_of[base.hit.shape_idx];
        if (shape == ShapeEdit::none) return Rejection::moved;
        // A vertex that is smooth enough in one scene may not be in the other.
        if (before.site != no_site || (next && next->site != no_site)) return Rejection::moved;
        SitePoint point;
        point.hit = base.hit;
        point.p = from_.to_partner[base.hit.shape_idx](base.at.p);
        const Vector3f to_before = normalize(before.at.p - point.p);
        r.moved = to_.vertex(point, shape, to_before);
        if (!smooth_enough(base) || !smooth_enough(r.moved) || !smooth_enough(before) ||
            (next && !smooth_enough(*next)))
            return Rejection::specular;
        const auto distance2 = [](const Point3f& a, const Point3f& b) { return double(length2(a - b)); };
        r.density_ratio = 1;
        const auto far_enough = [&](const Point3f& neighbour, double cos_before, double cos_after) {
            const double was = distance2(base.at.p, neighbour), is = distance2(r.moved.at.p, neighbour);
            r.density_ratio *= (cos_after / is) / (cos_before / was);
            return std::min(was, is) >= sqr(double(limits_.d_min));
        };
        const auto join = [&](const Vertex& s, const Vertex& l, Segment& segment) {
            ++n_rays;
            if (to_.scene.occluded(spawn_segment(s.at.end(), l.at.end()))) return false;
            segment = segment_between(to_, s, l, crossings_);
            return true;
        };
        if (!join(before, r.moved, r.towards_sensor)) return Rejection::blocked;
        if (!far_enough(before.at.p, path.segments[j].cos_light, r.towards_sensor.cos_light)) return Rejection::near;
        Vector3f to_light;
        if (next) {
            if (!join(r.moved, *next, r.towards_light)) return Rejection::blocked;
            if (!far_enough(next->at.p, path.segments[j + 1].cos_light, r.towards_light.cos_light))
                return Rejection::near;
            to_light = normalize(next->at.p - r.moved.at.p);
        } else {
            LightEnd& light = r.light = path.light;
            ++n_rays;
            if (to_.scene.occluded(shadow_ray(r.moved, light))) return Rejection::blocked;
            r.towards_light = segment_to_light(to_, r.moved, light, crossings_);
            to_light = direction_to(light, r.moved.at.p);
            if (light.delta) {
                LightQuery query;
                query.point.emitter_idx = light.emitter;
                query.point.pmf = to_.scene.emitters.size() > 1 ? to_.scene.emitter_pmf.pmf(light.emitter) : 1.0f;
                const LightSample s = sample_light(to_.scene, r.moved.at.p, query);
                if (!(s.density() > 0)) return Rejection::light;
                light.Le = Radiance(s.Li);
            } else if (!light.at_infinity) {
                const double cos_before = -dot(light.n, direction_to(path.light, base.at.p)),
                             cos_after = -dot(light.n, to_light);
                if (!(cos_before * cos_after > 0)) return Rejection::light;
                if (!far_enough(light.y, cos_before, cos_after)) return Rejection::near;
            }
            light.pdf = light_pdf(to_.scene, light, r.moved.at.p);
        }
        r.at_start = interact(to_, r.moved, to_before, to_light, Lobe::none);
        return max_channel(r.at_start.f_cos) > 0 ? Rejection::none : Rejection::black;
    }();
}

const MappedPath* PathMapper::map(const FullPath& path, const Found& found, Rejection& why) {
    why = Rejection::none;
    const std::size_t m = path.m();
    if (m == 0 || path.light.changed) return reject(why, Rejection::light);
    // Index of the vertex that moves, from 0; m: none.
    std::size_t j = m;
    if (found.technique == Technique::dynamic_from_emitter || found.technique == Technique::dynamic_two_ends)
        j = found.place - 1;
    if (j < m && path.vertices[j].site == std::uint8_t(Site::repainted)) j = m;
    for (std::size_t i = 0; i < m; ++i)
        if (i != j && path.vertices[i].site != no_site && path.vertices[i].site != std::uint8_t(Site::repainted))
            return reject(why, Rejection::moved);
    if (j == 0) return reject(why, Rejection::moved);  // it would project into another pixel
    for (std::size_t i = 0; i <= m; ++i)
        if (path.segments[i].n > 0 && (j == m || (i != j && i != j + 1))) return reject(why, Rejection::crossed);
    if (!scenes_.same_choice_of_lights) return reject(why, Rejection::light);
    const bool has_next = j + 1 < m;
    if (j < m) {
        if (path.vertices[j].specular || path.vertices[j - 1].specular || (has_next && path.vertices[j + 1].specular))
            return reject(why, Rejection::specular);
        reconnect(path, j);
        if (reconnected_.why != Rejection::none) return reject(why, reconnected_.why);
    }

    FullPath& q = mapped_.path;
    q.sensor = path.sensor;
    q.light = path.light;
    q.vertices = path.vertices;
    q.places = path.places;
    q.segments = path.segments;
    for (Segment& s : q.segments) s.first = s.n = 0;
    mapped_.density_ratio = 1;
    places_.clear();
    places_.reserve(m);
    const auto to_light_of = [&](std::size_t i) {
        return i + 1 < m ? normalize(q.places[i + 1]->at.p - q.places[i]->at.p)
                         : direction_to(q.light, q.places[i]->at.p);
    };
    const Sensor& sensor = from_.scene.sensor;
    const auto to_sensor_of = [&](std::size_t i) {
        if (i > 0) return normalize(q.places[i - 1]->at.p - q.places[i]->at.p);
        const std::optional<FilmPoint> film = sensor.project(q.places[0]->at.p);
        return film ? -film->d : Vector3f{};
    };
    if (j < m) {
        q.places[j] = &reconnected_.moved;
        q.vertices[j] = reconnected_.at_start;
        q.segments[j] = reconnected_.towards_sensor;
        q.segments[j + 1] = reconnected_.towards_light;
        mapped_.density_ratio = reconnected_.density_ratio;
        if (!has_next) q.light = reconnected_.light;
        q.vertices[j - 1] = interact(from_, *path.places[j - 1], to_sensor_of(j - 1), to_light_of(j - 1), Lobe::none);
        if (has_next)
            q.vertices[j + 1] =
                interact(from_, *path.places[j + 1], to_sensor_of(j + 1), to_light_of(j + 1), Lobe::none);
    }
    // Replace vertices that differ in the other scene.
    for (std::size_t i = 0; i < m; ++i) {
        if (path.vertices[i].site != std::uint8_t(Site::repainted)) continue;
        const Vertex& base = *path.places[i];
        if (path.vertices[i].specular) return reject(why, Rejection::specular);
        SitePoint point;
        point.hit = base.hit;
        point.p = base.at.p;
        const Vector3f s = to_sensor_of(i), l = to_light_of(i);
        places_.push_back(to_.vertex(point, from_.partner_of[base.hit.shape_idx], s));
        q.places[i] = &places_.back();
        q.vertices[i] = interact(to_, places_.back(), s, l, Lobe::none);
    }
    for (const Interaction& x : q.vertices)
        if (!(max_channel(x.f_cos) > 0)) return reject(why, Rejection::black);
    return &mapped_;
}

}  // namespace loom::residual
