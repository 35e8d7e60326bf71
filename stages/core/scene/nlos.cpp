#include "stages/core/scene/nlos.h"

#include <fmt/format.h>

#include "stages/core/description/description.h"
#include "stages/core/sampling/warp.h"
#include "stages/core/scene/delta_light.h"

namespace loom {
namespace {

/// Probability of hidden-geometry sampling without `do_rroulette`. The remaining BSDF samples keep all other paths
/// possible, and the weight of a direction below 8 times its reflectance.
constexpr float mostly_hidden = 0.875f;

/// Finds the point of a mesh with the texture coordinates uv, as triangle and barycentric coordinates.
/// out:     false if there is none
bool point_at_uv(const Mesh& mesh, double u, double v, Hit& hit) {
    for (std::size_t t = 0; t < mesh.n_triangles(); ++t) {
        const std::uint32_t* i = &mesh.indices[3 * t];
        const Point2f &a = mesh.uvs[i[0]], &b = mesh.uvs[i[1]], &c = mesh.uvs[i[2]];
        const double du1 = double(b.x) - a.x, dv1 = double(b.y) - a.y, du2 = double(c.x) - a.x, dv2 = double(c.y) - a.y;
        const double det = du1 * dv2 - dv1 * du2, du = u - a.x, dv = v - a.y;
        if (det == 0) continue;
        const double s = (du * dv2 - dv * du2) / det, r = (du1 * dv - dv1 * du) / det;
        constexpr double rounding = 1e-6;  // tolerance, so that a point on an edge is in one of its triangles
        if (s < -rounding || r < -rounding || s + r > 1 + rounding) continue;
        hit.primitive_idx = std::uint32_t(t);
        hit.u = float(s);
        hit.v = float(r);
        return true;
    }
    return false;
}

NlosCapture::Point describe(const Scene& scene, const Ray& ray, const Hit& hit) {
    NlosCapture::Point at;
    at.ray = ray;
    at.hit = hit;
    if (!hit) return at;
    const SurfacePoint seen = scene.surface(ray, hit);
    at.p = seen.p;
    at.ng = at.flat = seen.ng;
    at.hit_error = seen.hit_error;
    const Shape& shape = scene.shapes[hit.shape_idx];
    if (shape.kind == ShapeKind::mesh) {
        const TriangleRecord& triangle = shape.triangles[hit.primitive_idx];
        at.flat = Normal3f(normalize(cross(triangle.e1, triangle.e2)) * (shape.flip_normals ? -1.0f : 1.0f));
    }
    return at;
}

/// Finds the sensor points on the relay wall. A grid point often lies exactly on the edge of two triangles, where a ray
/// may pass between them, so the ray engine only tests for occluders in front of the wall.
void look_at_grid(const Object& wall, const Object& sensor, const Scene& scene, NlosCapture& capture) {
    const Shape& shape = scene.shapes[capture.relay_wall];
    const NlosCapture::Grid grid = capture.sensor_grid;
    if (shape.kind != ShapeKind::mesh || shape.mesh.uvs.empty())
        fail(sensor.at, "the relay wall must be a rectangle, or a mesh with texture coordinates");
    for (std::uint32_t j = 0; j < grid.height; ++j)
        for (std::uint32_t i = 0; i < grid.width; ++i) {
            const double u = (i + 0.5) / grid.width, v = (j + 0.5) / grid.height;
            Hit target;
            if (!point_at_uv(shape.mesh, u, v, target))
                wall.fail("", fmt::format("the relay wall has no point of texture coordinates ({:.4g}, {:.4g}), where "
                                          "grid point ({}, {}) is",
                                          u, v, i, j));
            target.shape_idx = capture.relay_wall;
            const TrianglePoint point = triangle_point(shape, target, false);
            const Vector3f d = point.p - capture.sensor_origin;
            target.t = length(d);
            const Ray ray{capture.sensor_origin, d / target.t};
            const Hit before =
                scene.intersect(spawn_segment({capture.sensor_origin}, {point.p, point.ng, shape.hit_error}));
            capture.sensor_points.push_back(describe(scene, {ray.o, ray.d}, before ? before : target));
        }
}

/// Returns the axes of a projector turned upright along d.
Framef beam_along(const Vector3f& d) {
    const Vector3f left = cross(Vector3f{0, 1, 0}, d);
    if (!(length2(left) > 1e-12f)) return Framef(Normal3f(d));
    const Vector3f x = normalize(left);
    return {x, cross(d, x), Normal3f(d)};
}

/// Aims the laser at a sensor point; it is lit if visible from the laser.
NlosCapture::LaserPoint aim(const Scene& scene, const Point3f& laser, const NlosCapture::Point& target) {
    NlosCapture::LaserPoint point;
    static_cast<NlosCapture::Point&>(point) = target;
    if (!target.hit) return point;
    point.beam = beam_along(normalize(target.p - laser));
    point.lit = !scene.occluded(spawn_segment(target.end(), {laser}));
    return point;
}

NlosCapture::LaserPoint aim(const Scene& scene, const Point3f& laser, const Framef& beam) {
    NlosCapture::LaserPoint point;
    static_cast<NlosCapture::Point&>(point) = look(scene, laser, Vector3f(beam.n));
    point.beam = beam;
    point.lit = bool(point.hit);
    return point;
}

double triangle_area(const Mesh& mesh, std::size_t t) {
    const std::uint32_t* i = &mesh.indices[3 * t];
    const Point3<double> a(mesh.positions[i[0]]), b(mesh.positions[i[1]]), c(mesh.positions[i[2]]);
    return 0.5 * length(cross(b - a, c - a));
}

/// Lists the primitives of the hidden geometry.
/// in:      wall  excluded shape, or NlosCapture::no_wall
void list_hidden(const Scene& scene, std::uint32_t wall, NlosCapture& capture) {
    std::vector<double> areas;
    capture.is_hidden.assign(scene.shapes.size(), false);
    for (std::uint32_t s = 0; s < scene.shapes.size(); ++s) {
        if (s == wall) continue;
        const Shape& shape = scene.shapes[s];
        capture.is_hidden[s] = true;
        const auto add = [&](std::uint32_t primitive, double area) {
            if (!(area > 0)) return;
            capture.hidden.push_back({s, primitive});
            areas.push_back(area);
        };
        if (shape.kind == ShapeKind::sphere) add(0, 4 * pi_double * sqr(double(shape.round.radius)));
        if (shape.kind == ShapeKind::disk)
            add(0, pi_double * length(cross(Vector3<double>(shape.round.u_axis), Vector3<double>(shape.round.v_axis))));
        for (std::uint32_t t = 0; t < shape.triangles.size(); ++t) add(t, triangle_area(shape.mesh, t));
    }
    if (areas.empty()) return;
    capture.hidden_pmf = Distribution1(areas);
    capture.hidden_area = capture.hidden_pmf.sum();
}

void read_integrator(const Object& o, NlosCapture& c, bool& includes_wall) {
    if (o.get_bool("camera_unwarp", false))
        o.fail("camera_unwarp", "in an NLOS capture account_first_and_last_bounces decides which lengths count");
    const std::string type = o.get_string("capture_type", "single");
    c.type = type == "confocal"     ? CaptureType::confocal
             : type == "exhaustive" ? CaptureType::exhaustive
                                    : CaptureType::single;
    c.laser_sampling = o.get_bool("nlos_laser_sampling", false);
    c.discard_direct = o.get_bool("discard_direct_paths", false);
    c.filter_depth = o.get_int("filter_depth", -1);
    if (const int bounces = o.get_int("filter_bounces", -1); bounces != -1) {
        if (c.filter_depth != -1) o.fail("filter_bounces", "give either filter_depth or filter_bounces, not both");
        c.filter_depth = bounces + 1;
    }
    if (const int depth = o.get_int("max_depth", 6); c.filter_depth != -1 && depth != -1 && c.filter_depth > depth)
        o.fail(o.has("filter_depth") ? "filter_depth" : "filter_bounces",
               fmt::format("paths of {} edges are longer than max_depth {}", c.filter_depth, depth));
    if (o.get_bool("nlos_hidden_geometry_sampling", false))
        c.hidden_probability = o.get_bool("nlos_hidden_geometry_sampling_do_rroulette", false) ? 0.5f : mostly_hidden;
    includes_wall = o.get_bool("nlos_hidden_geometry_sampling_includes_relay_wall", false);
    c.hidden_depth = o.get_int("nlos_hidden_geometry_sampling_max_depth", -1);
    if (c.hidden_depth == 0 || c.hidden_depth < -1)
        o.fail("nlos_hidden_geometry_sampling_max_depth", "must be -1 or positive");
}

/// Sets the laser points of an exhaustive capture: those of the sensor, or a grid over the projector's field of view,
/// at the corners (i / width, j / height) of its cells.
void scan(const Object& integrator, const Object& film, const Emitter& projector, const Scene& scene, NlosCapture& c,
          std::vector<std::string>& notes) {
    if (!film.get_bool("exhaustive_scan", false))
        film.fail("exhaustive_scan", "an exhaustive capture needs a film with exhaustive_scan");
    c.laser_grid = {std::uint32_t(film.get_int("laser_scan_width", 0)),
                    std::uint32_t(film.get_int("laser_scan_height", 0))};
    const auto same = [&] {
        return c.laser_grid.width == c.sensor_grid.width && c.laser_grid.height == c.sensor_grid.height;
    };
    if (c.laser_grid.size() == 0)
        film.fail("laser_scan_width", "laser_scan_width and laser_scan_height must be positive");
    if (integrator.get_bool("force_equal_illumination_scanning", true)) {
        if (!same())
            film.fail(
                "laser_scan_width",
                fmt::format("force_equal_illumination_scanning: {} x {} laser points are not the {} x {} sensor points",
                            c.laser_grid.width, c.laser_grid.height, c.sensor_grid.width, c.sensor_grid.height));
        for (const NlosCapture::Point& at : c.sensor_points)
            c.laser_points.push_back(aim(scene, projector.position, at));
        return;
    }
    const double fov = integrator.get_double("illumination_scan_fov", 20.0);
    if (!(fov > 0 && fov < 180)) integrator.fail("illumination_scan_fov", "must lie between 0 and 180 degrees");
    const float tan_fov = float(std::tan(fov * pi_double / 360));
    std::size_t missing = 0;
    for (std::uint32_t j = 0; j < c.laser_grid.height; ++j)
        for (std::uint32_t i = 0; i < c.laser_grid.width; ++i) {
            const Vector3f d{(1 - 2 * float(i) / float(c.laser_grid.width)) * tan_fov,
                             (1 - 2 * float(j) / float(c.laser_grid.height)) * tan_fov, 1};
            c.laser_points.push_back(
                aim(scene, projector.position, beam_along(normalize(projector.frame.to_world(d)))));
            missing += !c.laser_points.back().hit;
        }
    if (missing == c.laser_points.size())
        integrator.fail("illumination_scan_fov", "no ray of the laser's scan hits the scene");
    if (missing > 0)
        notes.push_back(
            fmt::format("{} of {} laser points miss the scene and contribute nothing", missing, c.laser_points.size()));
}

}  // namespace

NlosCapture::Point look(const Scene& scene, const Point3f& from, const Vector3f& d) {
    // Tests rays beside the direction as well: a laser often aims exactly at the edge of two triangles, where a ray may
    // pass between them.
    constexpr float beside = 1e-6f;
    const Framef frame{Normal3f(d)};
    for (const Vector3f& way : {d, normalize(d + frame.s * beside), normalize(d + frame.t * beside)}) {
        const Ray ray{from, way};
        if (const Hit hit = scene.intersect(ray)) return describe(scene, ray, hit);
    }
    return describe(scene, {from, d}, {});
}

namespace {

/// Whether two points lie in one plane. They receive light from each other only by rounding, which divided by their
/// squared distance can have any value.
bool in_one_plane(const Normal3f& n, const Vector3f& d, const Point3f& p) {
    constexpr double flat = 1e-5;
    const double size = std::max({std::abs(p.x), std::abs(p.y), std::abs(p.z)});
    return std::abs(dot(Vector3<double>(n), Vector3<double>(d))) <
           flat * std::max(length(Vector3<double>(d)), flat * size);
}

}  // namespace

LitSpot lit_spot(const Scene& scene, const NlosCapture::LaserPoint& laser, bool true_area, Point2f u) {
    if (!laser.lit) return {};
    const Emitter& projector = scene.emitters[0];
    if (!true_area)
        return {laser, projected(scene, projector, EmitterPose<float>(projector, laser.beam), laser.p), true};
    const float x = 2 * u.x - 1, y = 2 * u.y - 1;
    const Vector3f local = normalize(Vector3f{x * projector.tan_x, y * projector.tan_y, 1});
    const NlosCapture::Point point = look(scene, projector.position, laser.beam.to_world(local));
    const float cos_surface = std::abs(dot(point.ng, point.ray.d));
    if (!point.hit || !(cos_surface > 0)) return {};
    // Over the beam's section, irradiance times area is constant except for the surface's slant.
    return {point,
            beam_radiance(scene, projector, projector.radiance, x, y) *
                (pi<float> * 4 * projector.tan_x * projector.tan_y / cos_surface),
            true};
}

bool see_spot(const Scene& scene, const LitSpot& spot, const Point3f& from, LightSample& light) {
    const NlosCapture::Point& point = spot.point;
    const Vector3f d = point.p - from;
    if (in_one_plane(point.flat, d, point.p)) return false;
    const float r = length(d);
    light.wi = d / r;
    light.y = point.p;
    Hit hit = point.hit;
    hit.t = r;
    const SurfacePoint at = scene.surface({from, light.wi}, hit);
    const ShadingPoint lit = shading_point(scene, at, -light.wi);
    light.n = at.ng;
    const Vector3f to_laser = normalize(scene.emitters[0].position - point.p);
    const float cos_l = std::abs(dot(at.ng, light.wi));
    light.Li = f_cos_pdf(lit, to_laser).f_cos * spot.power * (cos_l / (r * r));
    return true;
}

HiddenPoint sample_hidden(const Scene& scene, Point2f u) {
    const NlosCapture& c = *scene.nlos;
    HiddenPoint point;
    point.element = c.hidden[c.hidden_pmf.sample(u.x)];
    const Shape& shape = scene.shapes[point.element.shape];
    switch (shape.kind) {
        case ShapeKind::mesh: {
            const Point2f b = sample_triangle(u);
            const TriangleRecord& triangle = shape.triangles[point.element.primitive];
            point.p = triangle.p0 + triangle.e1 * b.x + triangle.e2 * b.y;
            point.n = triangle.ng;
            break;
        }
        case ShapeKind::sphere:
            point.n = Normal3f(sample_uniform_sphere(u));
            point.p = shape.round.sphere_point(Vector3f(point.n));
            break;
        case ShapeKind::disk: {
            const Point2f d = sample_concentric_disk(u);
            point.p = shape.round.disk_point(d.x, d.y);
            point.n = shape.round.disk_normal();
            break;
        }
    }
    return point;
}

float pdf_hidden_w(const Scene& scene, const Point3f& from, const SurfacePoint& at) {
    const NlosCapture& c = *scene.nlos;
    if (!c.is_hidden[at.shape_idx] || c.hidden.empty()) return 0;
    const Vector3f d = at.p - from;
    const float d2 = length2(d), cos_d = std::abs(dot(at.ng, d));
    return cos_d > 0 ? d2 * std::sqrt(d2) / (cos_d * float(c.hidden_area)) : 0.0f;
}

void build_nlos(const Object& root, const Object* wall, std::uint32_t relay_wall, Scene& scene) {
    const ObjectPtr sensor = (wall ? *wall : root).child(Category::sensor),
                    integrator = root.child(Category::integrator);
    auto capture = std::make_shared<NlosCapture>();
    NlosCapture& c = *capture;
    if (wall) c.relay_wall = relay_wall;
    c.sensor_origin = Point3f(sensor->get_point("sensor_origin", {0, 0, 0}));
    bool includes_wall = false;
    read_integrator(*integrator, c, includes_wall);
    const ObjectPtr film = sensor->child(Category::film);
    c.sensor_grid = {scene.sensor.width, scene.sensor.height};
    if (!wall && c.type != CaptureType::single)
        integrator->fail("capture_type", fmt::format("a sensor '{}' takes single captures only; confocal and "
                                                     "exhaustive ones need an nlos_capture_meter inside the relay wall",
                                                     sensor->plugin));
    if (scene.emitters.size() != 1 || scene.emitters[0].kind != EmitterKind::projector)
        fail(sensor->at, "an NLOS capture needs exactly one emitter, a projector");
    const Emitter& projector = scene.emitters[0];

    if (wall) look_at_grid(*wall, *sensor, scene, c);
    if (c.type == CaptureType::single) {
        c.laser_grid = {1, 1};
        c.laser_points.push_back(aim(scene, projector.position, projector.frame));
        if (c.laser_sampling && !c.laser_points[0].hit) root.fail("", "the beam of the projector hits nothing");
    } else if (c.type == CaptureType::confocal) {
        c.laser_grid = c.sensor_grid;
        for (const NlosCapture::Point& at : c.sensor_points)
            c.laser_points.push_back(aim(scene, projector.position, at));
    } else {
        scan(*integrator, *film, projector, scene, c, scene.notes);
        if (c.laser_points.size() * c.sensor_points.size() > std::size_t(1) << 31)
            film->fail("laser_scan_width", "more than 2^31 pairs of a laser and a sensor point");
        scene.sensor.width = std::uint32_t(c.laser_points.size());
        scene.sensor.height = std::uint32_t(c.sensor_points.size());
    }
    if (c.hidden_probability > 0) {
        // For a camera, the wall is the shape that the laser lights.
        const std::uint32_t relay_or_lit = wall                    ? relay_wall
                                           : c.laser_points[0].hit ? c.laser_points[0].hit.shape_idx
                                                                   : NlosCapture::no_wall;
        list_hidden(scene, includes_wall ? NlosCapture::no_wall : relay_or_lit, c);
        if (c.hidden.empty())
            integrator->fail("nlos_hidden_geometry_sampling", "the scene has no geometry but the relay wall");
    }
    scene.nlos = std::move(capture);
}

}  // namespace loom
