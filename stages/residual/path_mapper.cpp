#include "stages/residual/path_mapper.h"

namespace loom::residual {

PathMapper::PathMapper(const DynamicScenes& scenes, bool from_new, const MappingLimits& limits)
    : scenes_(scenes), from_(from_new ? scenes.new_scene : scenes.old_scene), to_(from_new ? scenes.old_scene : scenes.new_scene), limits_(limits) {
    mapped_.path.crossings = &crossings_.all;
}

bool PathMapper::smooth_enough(const Vertex& v) const {
    const Bsdf<float>& b = v.here.bsdf;
    switch (b.model->kind) {
        case BsdfKind::diffuse:
        case BsdfKind::rough_diffuse: return b.opacity == 1;
        case BsdfKind::rough_conductor:
        case BsdfKind::rough_dielectric:
        case BsdfKind::rough_plastic:
        case BsdfKind::ward: return b.opacity == 1 && std::min(b.alpha_u, b.alpha_v) >= limits_.alpha_min;
        case BsdfKind::phong: return std::sqrt(2 / (2 + b.model->exponent)) >= limits_.alpha_min;
        case BsdfKind::plastic: return b.opacity == 1;  // joined by its diffuse part
        default: return false;
    }
}

const MappedPath* PathMapper::map(const FullPath& path, const Found& found, Rejection& why) {
    why = Rejection::none;
    const std::size_t m = path.m();
    if (m == 0 || path.light.changed) return reject(why, Rejection::light);
    // Which vertex moves; from 0, m: none.
    std::size_t j = m;
    if (found.technique == Technique::dynamic_from_emitter || found.technique == Technique::dynamic_two_ends) j = found.place - 1;
    if (j < m && path.vertices[j].site == std::uint8_t(Site::repainted)) j = m;
    for (std::size_t i = 0; i < m; ++i)
        if (i != j && path.vertices[i].site != no_site && path.vertices[i].site != std::uint8_t(Site::repainted)) return reject(why, Rejection::moved);
    if (j == 0) return reject(why, Rejection::moved);  // it would be seen in another pixel
    for (std::size_t i = 0; i <= m; ++i)
        if (path.segments[i].n > 0 && (j == m || (i != j && i != j + 1))) return reject(why, Rejection::crossed);
    if (!scenes_.same_choice_of_lights) return reject(why, Rejection::light);

    FullPath& q = mapped_.path;
    q.sensor = path.sensor;
    q.light = path.light;
    q.vertices = path.vertices;
    q.places = path.places;
    q.segments = path.segments;
    for (Segment& s : q.segments) s.first = s.n = 0;
    mapped_.density_ratio = 1;
    crossings_.all.clear();
    places_.clear();
    places_.reserve(m);
    const auto to_light_of = [&](const FullPath& p, std::size_t i) {
        return i + 1 < m ? normalize(p.places[i + 1]->at.p - p.places[i]->at.p) : direction_to(p.light, p.places[i]->at.p);
    };
    const Sensor& sensor = from_.scene.sensor;
    const auto to_sensor_of = [&](const FullPath& p, std::size_t i) {
        if (i > 0) return normalize(p.places[i - 1]->at.p - p.places[i]->at.p);
        const std::optional<FilmPoint> film = sensor.project(p.places[0]->at.p);
        return film ? -film->d : Vector3f{};
    };

    if (j < m) {
        const Vertex& base = *path.places[j];
        const std::uint32_t shape = from_.partner_of[base.hit.shape];
        if (shape == ShapeEdit::none) return reject(why, Rejection::moved);
        const bool has_next = j + 1 < m;
        if (path.vertices[j].specular || path.vertices[j - 1].specular || (has_next && path.vertices[j + 1].specular)) return reject(why, Rejection::specular);
        // What is smooth enough in one scene may not be in the other.
        if (path.vertices[j - 1].site != no_site || (has_next && path.vertices[j + 1].site != no_site)) return reject(why, Rejection::moved);
        SitePoint point;
        point.hit = base.hit;
        point.p = from_.to_partner[base.hit.shape](base.at.p);
        places_.push_back(to_.vertex(point, shape, Vector3f(normalize(path.places[j - 1]->at.p - point.p))));
        const Vertex& moved = places_.back();
        q.places[j] = &moved;
        if (!smooth_enough(base) || !smooth_enough(moved) || !smooth_enough(*path.places[j - 1]) || (has_next && !smooth_enough(*path.places[j + 1])))
            return reject(why, Rejection::specular);
        const auto distance2 = [](const Point3f& a, const Point3f& b) { return double(length2(a - b)); };
        const double d_min2 = sqr(double(limits_.d_min));
        const auto reconnect = [&](const Point3f& neighbour, double cos_before, double cos_after) {
            const double before = distance2(base.at.p, neighbour), after = distance2(moved.at.p, neighbour);
            mapped_.density_ratio *= (cos_after / after) / (cos_before / before);
            return std::min(before, after) >= d_min2;
        };
        const auto join = [&](const Vertex& s, const Vertex& l, Segment& segment) {
            ++n_rays;
            if (to_.scene.occluded(spawn_segment(s.at.p, s.at.ng, l.at.p))) return false;
            segment = segment_between(to_, s, l, crossings_);
            return true;
        };
        // Towards the sensor.
        const Vertex& before = *path.places[j - 1];
        if (!join(before, moved, q.segments[j])) return reject(why, Rejection::blocked);
        if (!reconnect(before.at.p, path.segments[j].cos_light, q.segments[j].cos_light)) return reject(why, Rejection::near);
        // Towards the light.
        if (has_next) {
            const Vertex& next = *path.places[j + 1];
            if (!join(moved, next, q.segments[j + 1])) return reject(why, Rejection::blocked);
            if (!reconnect(next.at.p, path.segments[j + 1].cos_light, q.segments[j + 1].cos_light)) return reject(why, Rejection::near);
        } else {
            LightEnd& light = q.light;
            ++n_rays;
            if (to_.scene.occluded(shadow_ray(moved, light))) return reject(why, Rejection::blocked);
            q.segments[m] = segment_to_light(to_, moved, light, crossings_);
            if (light.delta) {
                LightQuery query;
                query.point.emitter = light.emitter;
                query.point.pmf = to_.scene.emitters.size() > 1 ? to_.scene.emitter_pmf.pmf(light.emitter) : 1.0f;
                const LightSample s = sample_light(to_.scene, moved.at.p, query);
                if (!(s.pdf_w > 0)) return reject(why, Rejection::light);
                light.Le = Radiance(s.Li);
            } else if (!light.at_infinity) {
                const double cos_before = -dot(light.n, to_light_of(path, j)), cos_after = -dot(light.n, to_light_of(q, j));
                if (!(cos_before * cos_after > 0)) return reject(why, Rejection::light);
                if (!reconnect(light.y, cos_before, cos_after)) return reject(why, Rejection::near);
            }
            light.pdf = light_pdf(to_.scene, light, moved.at.p);
        }
        q.vertices[j] = interact(to_, moved, to_sensor_of(q, j), to_light_of(q, j), Lobe::none);
        q.vertices[j - 1] = interact(from_, before, to_sensor_of(q, j - 1), to_light_of(q, j - 1), Lobe::none);
        if (has_next) q.vertices[j + 1] = interact(from_, *path.places[j + 1], to_sensor_of(q, j + 1), to_light_of(q, j + 1), Lobe::none);
    }
    // Vertices that look otherwise there.
    for (std::size_t i = 0; i < m; ++i) {
        if (path.vertices[i].site != std::uint8_t(Site::repainted)) continue;
        const Vertex& base = *path.places[i];
        if (path.vertices[i].specular) return reject(why, Rejection::specular);
        SitePoint point;
        point.hit = base.hit;
        point.p = base.at.p;
        const Vector3f s = to_sensor_of(q, i), l = to_light_of(q, i);
        places_.push_back(to_.vertex(point, from_.partner_of[base.hit.shape], s));
        q.places[i] = &places_.back();
        q.vertices[i] = interact(to_, places_.back(), s, l, Lobe::none);
    }
    for (const Interaction& x : q.vertices)
        if (!(max_channel(x.f_cos) > 0)) return reject(why, Rejection::black);
    return &mapped_;
}

}  // namespace loom::residual
