#include "stages/core/scene/emitter.h"

#include "stages/core/sampling/warp.h"
#include "stages/core/scene/delta_light.h"

namespace loom {
namespace {

constexpr float two_pi = 2 * pi<float>;

/// Converts to the cells of EnvironmentMap::density, which start half a column after the map's.
Point2f cell_point(const EnvironmentMap& map, Point2f uv) {
    float s = uv.x - 0.5f / float(map.width);
    return {s - std::floor(s), uv.y};
}

/// Density (sr^-1) of a local direction from one over the unit square of latitude and longitude.
float solid_angle_density(float density, const Vector3f& local) {
    // Computed without the cosine: near the poles 1 - cos^2 cancels.
    const float sin_theta = std::sqrt(sqr(local.x) + sqr(local.z));
    return sin_theta > 0 ? density / (two_pi * pi<float> * sin_theta) : 0.0f;
}

/// Samples a point on an area light, uniform by area. The normal is turned to the emitting side, which is that of the
/// shading normal (as in Mitsuba).
/// out:     y, geometric normal n, uv
void sample_area(const Scene& scene, const Emitter& e, Point2f u, Point3f& y, Normal3f& n, Point2f& uv) {
    const Shape& shape = scene.shapes[e.shape_idx];
    if (shape.kind == ShapeKind::disk) {
        const Point2f d = sample_concentric_disk(u);
        y = shape.round.disk_point(d.x, d.y);
        n = shape.flip_normals ? -shape.round.disk_normal() : shape.round.disk_normal();
        const float phi = std::atan2(d.y, d.x) / two_pi;
        uv = {std::sqrt(d.x * d.x + d.y * d.y), phi < 0 ? phi + 1 : phi};
        return;
    }
    if (shape.kind == ShapeKind::sphere) {
        n = Normal3f(sample_uniform_sphere(u));
        y = shape.round.sphere_point(Vector3f(n));
        if (e.texture_idx >= 0) uv = shape.round.sphere_uv(Vector3f(n));
        if (shape.flip_normals) n = -n;
        return;
    }
    if (e.parallelogram) {
        // The first triangle spans the edges from its middle vertex.
        const TriangleRecord& record = shape.triangles[0];
        y = record.p0 + record.e1 * u.x + (record.e2 - record.e1) * u.y;
        n = e.normals[0];
        uv = u;
        return;
    }
    const Mesh& mesh = shape.mesh;
    const std::size_t triangle = e.triangles.sample(u.x);
    const std::uint32_t* i = &mesh.indices[3 * triangle];
    const Point2f b = sample_triangle(u);
    const TriangleRecord& record = shape.triangles[triangle];
    y = record.p0 + record.e1 * b.x + record.e2 * b.y;
    n = e.normals[triangle];
    if (!mesh.normals.empty()) {
        const Vector3f ns = Vector3f(mesh.normals[i[0]]) * (1 - b.x - b.y) + Vector3f(mesh.normals[i[1]]) * b.x +
                            Vector3f(mesh.normals[i[2]]) * b.y;
        if ((dot(ns, n) < 0) != shape.flip_normals) n = -n;
    }
    if (e.texture_idx >= 0 && !mesh.uvs.empty()) {
        const Point2f &t0 = mesh.uvs[i[0]], &t1 = mesh.uvs[i[1]], &t2 = mesh.uvs[i[2]];
        uv = {t0.x + (t1.x - t0.x) * b.x + (t2.x - t0.x) * b.y, t0.y + (t1.y - t0.y) * b.x + (t2.y - t0.y) * b.y};
    } else {
        uv = b;
    }
}

/// Cone that a sphere subtends from an outside point; used to sample it.
struct Cone {
    Vector3f axis;
    float distance = 0, cos_max = -1;
    bool valid = false;
};
Cone sphere_cone(const Shape& shape, const Point3f& from) {
    Cone cone;
    const Vector3f to_center = shape.round.center - from;
    cone.distance = length(to_center);
    const float sin_max = shape.round.radius / cone.distance;
    cone.valid = !shape.flip_normals && sin_max < 0.9999f;
    if (cone.valid) {
        cone.axis = to_center / cone.distance;
        cone.cos_max = safe_sqrt(1 - sqr(sin_max));
    }
    return cone;
}
/// 1 - cos_max without cancellation for far spheres.
float one_minus_cos(const Cone& cone, float radius) {
    return sqr(radius / cone.distance) / (1 + cone.cos_max);
}

/// Radiance of an area light at its texture coordinates, on its emitting side.
Spectrum radiance_at(const Scene& scene, const Emitter& e, Point2f uv) {
    return e.texture_idx < 0 ? e.radiance : e.radiance * scene.textures[e.texture_idx].eval(uv);
}

}  // namespace

void sample_area_point(const Scene& scene, const Emitter& e, Point2f u, LightPoint& point) {
    Point2f uv;
    sample_area(scene, e, u, point.y, point.n, uv);
    point.hit_error = scene.shapes[e.shape_idx].hit_error;
    point.area = float(e.area);
    point.Li = radiance_at(scene, e, uv);
}

namespace {

void sample_sphere_light(const Scene& scene, const Emitter& e, const Point3f& from, Point2f u, LightSample& s) {
    const Shape& shape = scene.shapes[e.shape_idx];
    const Cone cone = sphere_cone(shape, from);
    if (!cone.valid) {
        LightPoint point;
        sample_area_point(scene, e, u, point);
        s = seen_from(point, from);
        return;
    }
    const float omc = one_minus_cos(cone, shape.round.radius);
    const float cos_a = 1 - u.x * omc, sin_a = safe_sqrt(u.x * omc * (2 - u.x * omc));
    const float phi = two_pi * u.y;
    const Frame<float> frame{Normal3f(cone.axis)};
    s.wi = frame.to_world({std::cos(phi) * sin_a, std::sin(phi) * sin_a, cos_a});
    // Nearer intersection of the ray with the sphere.
    const float half = cone.distance * cos_a;
    const float t = half - safe_sqrt(sqr(shape.round.radius) - sqr(cone.distance * sin_a));
    const Point3f on_ray = from + s.wi * t;
    s.n = Normal3f(normalize(on_ray - shape.round.center));
    s.y = shape.round.sphere_point(Vector3f(s.n));
    s.hit_error = shape.hit_error;
    s.wi = normalize(s.y - from);  // as computed by a reader of the stored point
    s.pdf_w = 1.0f / (two_pi * omc);
    s.Li = e.texture_idx < 0 ? e.radiance : radiance_at(scene, e, shape.round.sphere_uv(Vector3f(s.n)));
}

/// Map and axes of the density of a sky's light samples.
const EnvironmentMap& sampled_map(const Emitter& e) {
    return e.proposals ? e.proposals->map : *e.map;
}
const Frame<float>& sampled_frame(const Emitter& e) {
    return e.proposals ? e.proposals->frame : e.frame;
}

/// Fills a light point with a direction sampled from the density of a sky.
/// out:     its point on the sampled map
Point2f place_in_sky(const Emitter& e, Point2f st, float density, LightPoint& point) {
    const Point2f uv{st.x + 0.5f / float(sampled_map(e).width), st.y};
    const Vector3f local = EnvironmentMap::direction(uv);
    point.at_infinity = true;
    point.y = Point3f(sampled_frame(e).to_world(local));
    point.pdf_w = solid_angle_density(density, local);
    return {uv.x - std::floor(uv.x), uv.y};
}
/// The same, of a map.
/// out:     position of its radiance on the map
EnvironmentMap::Place place_on_map(const Emitter& e, Point2f st, float density, LightPoint& point) {
    const Point2f uv = place_in_sky(e, st, density, point);
    return e.map->place(e.proposals ? EnvironmentMap::point(e.frame.to_local(Vector3f(point.y))) : uv);
}

/// Samples a point on a chosen emitter.
bool sample_point_on(const Scene& scene, const Emitter& e, Point2f u, LightPoint& point) {
    switch (e.kind) {
        case EmitterKind::area:
            if (scene.shapes[e.shape_idx].kind == ShapeKind::sphere) return false;
            sample_area_point(scene, e, u, point);
            return true;
        case EmitterKind::constant:
            point.Li = e.radiance;
            if (e.proposals) {
                float density = 0;
                const Point2f st = e.proposals->map.density.sample(u, density);
                place_in_sky(e, st, density, point);
                return true;
            }
            point.at_infinity = true;
            point.y = Point3f(sample_uniform_sphere(u));
            point.pdf_w = 1.0f / (2 * two_pi);
            return true;
        case EmitterKind::envmap: {
            float density = 0;
            const Point2f st = sampled_map(e).density.sample(u, density);
            point.Li = e.map->at(place_on_map(e, st, density, point));
            return true;
        }
        default:
            return false;
    }
}

/// Chooses an emitter by its weight.
/// in, out: u  rescaled, uniform again
std::size_t choose_emitter(const Scene& scene, float& u, float& pmf) {
    pmf = 1;
    if (scene.emitters.size() == 1) return 0;
    const std::size_t index = scene.emitter_pmf.sample(u);
    pmf = scene.emitter_pmf.pmf(index);
    return index;
}

}  // namespace

void look_up_light(const Scene& scene, LightQuery& query) {
    if (query.kind == LightQuery::Kind::environment) {
        query.Le = environment(scene, query.d);
        query.pdf_w = scene.environment_idx < 0 ? 0.0f : pdf_environment_w(scene, query.d);
    } else if (query.kind == LightQuery::Kind::point && !scene.emitters.empty()) {
        const std::size_t index = choose_emitter(scene, query.u.x, query.point.pmf);
        query.point.emitter_idx = std::uint16_t(index);
        query.placed = sample_point_on(scene, scene.emitters[index], query.u, query.point);
    }
}

void look_up_lights(const Scene& scene, std::span<LightQuery> queries) {
    using Kind = LightQuery::Kind;
    const bool has_map =
        scene.environment_idx >= 0 && scene.emitters[scene.environment_idx].kind == EmitterKind::envmap;
    if (!has_map) {
        for (LightQuery& query : queries) look_up_light(scene, query);
        return;
    }
    const Emitter& e = scene.emitters[scene.environment_idx];
    const EnvironmentMap &map = *e.map, &sampled = sampled_map(e);
    const float pmf = scene.emitters.size() > 1 ? scene.emitter_pmf.pmf(scene.environment_idx) : 1.0f;
    constexpr std::size_t block = 64;
    Distribution2::Search searches[block];
    EnvironmentMap::Place places[block];
    std::uint8_t asking[block];
    for (std::size_t begin = 0; begin < queries.size(); begin += block) {
        LightQuery* const q = queries.data() + begin;
        const std::size_t n = std::min(block, queries.size() - begin);
        std::size_t n_asking = 0;
        for (std::size_t k = 0; k < n; ++k) {
            if (q[k].kind == Kind::nothing) continue;
            if (q[k].kind == Kind::point) {
                const std::size_t index = choose_emitter(scene, q[k].u.x, q[k].point.pmf);
                q[k].point.emitter_idx = std::uint16_t(index);
                if (int(index) != scene.environment_idx) {
                    q[k].placed = sample_point_on(scene, scene.emitters[index], q[k].u, q[k].point);
                    continue;
                }
                searches[k] = sampled.density.begin(q[k].u);
            } else {
                const Vector3f local = sampled_frame(e).to_local(q[k].d);
                const Point2f uv = EnvironmentMap::point(local);
                places[k] = map.place(e.proposals ? EnvironmentMap::point(e.frame.to_local(q[k].d)) : uv);
                q[k].d = local;
                searches[k] = sampled.density.cell(cell_point(sampled, uv));
            }
            asking[n_asking++] = std::uint8_t(k);
        }
        const auto each = [&](auto&& step) {
            for (std::size_t i = 0; i < n_asking; ++i) step(q[asking[i]], searches[asking[i]], places[asking[i]]);
        };
        each([&](const LightQuery& query, Distribution2::Search& search, EnvironmentMap::Place&) {
            if (query.kind == Kind::point) sampled.density.guess(search);
        });
        each([&](LightQuery& query, Distribution2::Search& search, EnvironmentMap::Place& place) {
            if (query.kind == Kind::environment) {
                query.pdf_w = pmf * solid_angle_density(sampled.density.pdf(search), query.d);
                return;
            }
            float density = 0;
            const Point2f st = sampled.density.finish(search, density);
            place = place_on_map(e, st, density, query.point);
            query.placed = true;
        });
        each([&](LightQuery& query, const Distribution2::Search&, const EnvironmentMap::Place& place) {
            (query.kind == Kind::point ? query.point.Li : query.Le) = map.at(place);
        });
    }
}

LightSample sample_light(const Scene& scene, const Point3f& from, Point2f u) {
    LightQuery query;
    query.u = u;
    look_up_light(scene, query);
    return sample_light(scene, from, query);
}

LightSample sample_light(const Scene& scene, const Point3f& from, const LightQuery& query) {
    if (scene.emitters.empty()) return {};
    if (query.placed) return seen_from(query.point, from);
    const std::size_t index = query.point.emitter_idx;
    const Emitter& e = scene.emitters[index];
    const Point2f u = query.u;
    LightSample s;
    if (e.kind == EmitterKind::area)
        sample_sphere_light(scene, e, from, u, s);
    else
        s = delta_light(scene, e, EmitterPose<float>(e), from);
    s.emitter_idx = std::uint16_t(index);
    s.pdf_w *= query.point.pmf;
    s.pmf *= query.point.pmf;
    if (is_black(s.Li)) s.pdf_w = s.pmf = 0;
    return s;
}

float pdf_light_w(const Scene& scene, const Point3f& from, const SurfacePoint& at) {
    const Shape& shape = scene.shapes[at.shape_idx];
    const Emitter& e = scene.emitters[shape.emitter_idx];
    const float pmf = scene.emitters.size() > 1 ? scene.emitter_pmf.pmf(shape.emitter_idx) : 1.0f;
    if (shape.kind == ShapeKind::sphere) {
        if (const Cone cone = sphere_cone(shape, from); cone.valid)
            return pmf / (two_pi * one_minus_cos(cone, shape.round.radius));
    }
    const Vector3f d = at.p - from;
    const float d2 = length2(d);
    const float cos_light = std::abs(dot(at.ng, d)) / std::sqrt(d2);
    return cos_light > 0 ? pmf * d2 / (cos_light * float(e.area)) : 0.0f;
}

float pdf_environment_w(const Scene& scene, const Vector3f& d) {
    const Emitter& e = scene.emitters[scene.environment_idx];
    const float pmf = scene.emitters.size() > 1 ? scene.emitter_pmf.pmf(scene.environment_idx) : 1.0f;
    if (e.kind == EmitterKind::constant && !e.proposals) return pmf / (2 * two_pi);
    const EnvironmentMap& map = sampled_map(e);
    const Vector3f local = sampled_frame(e).to_local(d);
    return pmf * solid_angle_density(map.density.pdf(cell_point(map, EnvironmentMap::point(local))), local);
}

Spectrum emitted(const Scene& scene, const SurfacePoint& at, const Vector3f& wo) {
    const Shape& shape = scene.shapes[at.shape_idx];
    if (shape.emitter_idx < 0 || !(dot(at.ns_smooth, wo) > 0)) return Spectrum(0);
    const Emitter& e = scene.emitters[shape.emitter_idx];
    return radiance_at(scene, e, at.uv);
}

Spectrum environment(const Scene& scene, const Vector3f& d) {
    if (scene.environment_idx < 0) return Spectrum(0);
    const Emitter& e = scene.emitters[scene.environment_idx];
    return e.kind == EmitterKind::constant ? e.radiance : e.map->eval(EnvironmentMap::point(e.frame.to_local(d)));
}

}  // namespace loom
