// Rays leave and reach surfaces at every scale without a hit of the surface itself, and hit geometry next to it.
// Detected mutation: rounding_bound a quarter of its value (self-hits).

#include <gtest/gtest.h>

#include <random>

#include "stages/core/scene/embree.h"
#include "stages/core/scene/scene.h"
#include "stages/core/tracing/path_tracer.h"
#include "tests/traced_graph.h"

namespace loom::test {
namespace {

class Numbers {
  public:
    double uniform() { return u_(engine_); }
    /// Between 10^low and 10^high, evenly by its logarithm.
    double size(double low, double high) { return std::pow(10.0, low + (high - low) * uniform()); }
    Vector3<double> direction() {
        const Vector3<double> v{normal_(engine_), normal_(engine_), normal_(engine_)};
        return v / length(v);
    }
    /// Leaves to one side of n or the other, at a sine of 1e-4 or more, three times the rounding of stored normals; at
    /// grazing angles every second time.
    Vector3f leaving(const Normal3f& n) {
        const Vector3<double> m = normalize(Vector3<double>(n)), d = direction(), along = d - m * dot(d, m);
        if (uniform() < 0.5 && std::abs(dot(d, m)) > 1e-4) return Vector3f(d);
        const double cosine = (uniform() < 0.5 ? 1 : -1) * size(-4, -1);
        return Vector3f(along * (std::sqrt(1 - cosine * cosine) / length(along)) + m * cosine);
    }

  private:
    std::mt19937 engine_{3};
    std::uniform_real_distribution<double> u_;
    std::normal_distribution<double> normal_;
};

/// One shape alone, in a scene.
struct Alone {
    Scene scene;
    double size = 1;
    void finish() {
        scene.materials.resize(1);
        Shape& shape = scene.shapes[0];
        if (shape.kind == ShapeKind::mesh) {
            const auto& p = shape.mesh.positions;
            const Vector3f e1 = p[1] - p[0], e2 = p[2] - p[0];
            const Vector3<double> n = normalize(cross(Vector3<double>(e1), Vector3<double>(e2)));
            shape.triangles.push_back({{p[0], e1, e2}, as_stored(Normal3f(n))});
        }
        shape.hit_error = hit_error(shape);
        scene.rays = std::make_shared<RayEngine>(scene.shapes);
    }
    Point3<double> point(Numbers& r) const {
        const Shape& shape = scene.shapes[0];
        if (shape.kind == ShapeKind::sphere)
            return Point3<double>(shape.round.center) + r.direction() * double(shape.round.radius);
        const double u = r.uniform(), v = r.uniform();
        if (shape.kind == ShapeKind::disk)
            return Point3<double>(shape.round.center) + Vector3<double>(shape.round.u_axis) * (u - 0.5) +
                   Vector3<double>(shape.round.v_axis) * (v - 0.5);
        const bool beyond = u + v > 1;
        const TriangleRecord& t = shape.triangles[0];
        return Point3<double>(t.p0) + Vector3<double>(t.e1) * (beyond ? 1 - u : u) +
               Vector3<double>(t.e2) * (beyond ? 1 - v : v);
    }
};

enum class Kind { triangle, sliver, far_triangle, sphere, disk };
constexpr Kind kinds[] = {Kind::triangle, Kind::sliver, Kind::far_triangle, Kind::sphere, Kind::disk};

/// A shape of 1e-4 to 1e4 m, up to three of its sizes from the origin, or ten thousand.
std::unique_ptr<Alone> random_shape(Kind kind, Numbers& r) {
    auto alone = std::make_unique<Alone>();
    alone->size = r.size(-4, 4);
    Shape& shape = alone->scene.shapes.emplace_back();
    const Vector3<double> a = r.direction() * alone->size, b = r.direction() * (alone->size * r.uniform());
    const Vector3<double> c =
        r.direction() *
        (alone->size * (kind == Kind::far_triangle || r.uniform() < 0.3 ? r.size(0, 4) : 3 * r.uniform()));
    if (kind == Kind::sphere) {
        shape.kind = ShapeKind::sphere;
        shape.round.center = Point3f(c);
        shape.round.radius = float(alone->size);
        shape.round.u_axis = {1, 0, 0}, shape.round.v_axis = {0, 1, 0}, shape.round.w_axis = {0, 0, 1};
    } else if (kind == Kind::disk) {
        shape.kind = ShapeKind::disk;
        shape.round.center = Point3f(c);
        shape.round.u_axis = Vector3f(a);
        shape.round.v_axis = Vector3f(b - a * (0.7 * dot(a, b) / dot(a, a)));
    } else {
        const Vector3<double> e2 =
            kind == Kind::sliver ? a * (2 * r.uniform()) + r.direction() * (alone->size * r.size(-3, -1)) : b;
        for (const Vector3<double>& p : {c, c + a, c + e2}) shape.mesh.positions.push_back(Point3f(p));
        shape.mesh.indices = {0, 1, 2};
    }
    alone->finish();
    return alone;
}

TEST(RayOffset, NoShapeIsHitByARayThatLeavesIt) {
    Numbers r;
    for (const Kind kind : kinds) {
        std::size_t n = 0, met = 0;
        for (int i = 0; i < 2000; ++i) {
            const auto alone = random_shape(kind, r);
            for (int k = 0; k < 40; ++k) {
                const Point3f from = Point3f(alone->point(r) + r.direction() * (alone->size * r.size(-1, 3)));
                const Ray ray{from, normalize(Vector3f(alone->point(r) - Point3<double>(from)))};
                const Hit hit = alone->scene.intersect(ray);
                if (!hit) continue;
                const SurfacePoint at = alone->scene.surface(ray, hit);
                const Vector3f d = r.leaving(at.ng);
                // A ray that starts inside a sphere hits its other side.
                const bool inside = kind == Kind::sphere && dot(at.ng, d) < 0;
                const Hit next = alone->scene.intersect(spawn_ray(at.end(), d));
                ++n;
                met += inside ? !next || next.t < alone->size * -dot(at.ng, d) : bool(next);
            }
        }
        EXPECT_GT(n, 50000u) << int(kind);
        EXPECT_EQ(met, 0u) << int(kind) << ": of " << n;
    }
}

TEST(RayOffset, NoShapeHidesItsOwnPoints) {
    Numbers r;
    for (const Kind kind : kinds) {
        std::size_t n = 0, hidden = 0;
        for (int i = 0; i < 1000; ++i) {
            const auto alone = random_shape(kind, r);
            for (int k = 0; k < 40; ++k) {
                const Point3f near = Point3f(alone->point(r) + r.direction() * (alone->size * r.size(-1, 1)));
                const Ray ray{near, normalize(Vector3f(alone->point(r) - Point3<double>(near)))};
                const Hit hit = alone->scene.intersect(ray);
                if (!hit) continue;
                const SurfacePoint at = alone->scene.surface(ray, hit);
                // From the same side, at any angle.
                Vector3f d = r.leaving(at.ng);
                if (dot(at.ng, d) * dot(at.ng, ray.d) > 0) d = -d;
                const Point3f viewer = at.p + d * float(alone->size * r.size(-1, 3));
                if (kind == Kind::sphere && dot(at.ng, d) < 0) continue;
                // The side of a viewer within rounding of the plane is undefined.
                if (std::abs(dot(at.ng, viewer - at.p)) < 4 * surface_offset(at.p, at.ng, at.hit_error)) continue;
                ++n;
                hidden += alone->scene.occluded(spawn_segment({viewer}, at.end()));
            }
        }
        EXPECT_GT(n, 20000u) << int(kind);
        EXPECT_EQ(hidden, 0u) << int(kind) << ": of " << n;
    }
}

/// A square of 20 m at height y.
std::string square(double y, const char* more = "", double half = 10) {
    return fmt::format(
        R"(<shape type="rectangle"><transform name="to_world"><scale value="{}"/><rotate x="1" angle="-90"/><rotate x="1" y="2" z="3" angle="40"/>
<translate x="3" y="{}" z="5"/></transform>{}</shape>)",
        half, y, more);
}

TEST(RayOffset, SurfacesAHundredThousandthApartHideEachOther) {
    const auto scene = testing::load_inline({.sensor = R"(type="perspective">)", .body = square(0) + square(2e-4)});
    const Shape &below = scene->shapes[0], &above = scene->shapes[1];
    Numbers r;
    for (int k = 0; k < 2000; ++k) {
        const Hit at{0, float(0.9 * r.uniform()), 0.05f, 0, 0}, facing{0, at.u, at.v, 1, 0};
        const RayEnd from{triangle_point(below, at, false).p, below.triangles[0].ng, below.hit_error};
        const RayEnd to{triangle_point(above, facing, false).p, above.triangles[0].ng, above.hit_error};
        const Vector3f up(from.n);
        EXPECT_EQ(scene->intersect(spawn_ray(from, up)).shape_idx, 1u);
        // A light visible through the gap, and one that the upper square occludes from afar.
        EXPECT_FALSE(scene->occluded(spawn_segment(from, to)));
        EXPECT_TRUE(scene->occluded(spawn_segment({to.p + up * 10.0f}, from)));
        EXPECT_FALSE(scene->occluded(spawn_segment({to.p + up * 10.0f}, to)));
    }
}

/// A floor, a cube, a glass ball and a light above, of `unit` metres, moved along x.
std::unique_ptr<Scene> still_life(double unit, double away = 0) {
    const std::string place = fmt::format(R"(<scale value="{}"/><translate x="{}"/>)", unit, away);
    return testing::load_inline(
        {.sensor = fmt::format(
             R"(type="perspective"><float name="fov" value="45"/><float name="near_clip" value="{}"/><float name="far_clip" value="{}"/>
<transform name="to_world"><lookat origin="{},{},{}" target="{},{},0" up="0,1,0"/></transform>)",
             unit * 0.01, unit * 100, away, 3 * unit, 5 * unit, away, 0.3 * unit),
         .body = fmt::format(
             R"(<shape type="rectangle"><transform name="to_world"><scale value="4"/><rotate x="1" angle="-90"/>{0}</transform></shape>
<shape type="cube"><transform name="to_world"><scale value="0.5"/><rotate y="1" angle="30"/><translate x="0.7" y="0.5"/>{0}</transform></shape>
<shape type="sphere"><transform name="to_world"><scale value="0.5"/><translate x="-0.7" y="0.5"/>{0}</transform><bsdf type="dielectric"/></shape>
<shape type="rectangle"><transform name="to_world"><scale value="0.5"/><rotate x="1" angle="90"/><translate y="2.5"/>{0}</transform>
<bsdf type="diffuse"><rgb name="reflectance" value="0"/></bsdf><emitter type="area"><rgb name="radiance" value="10"/></emitter></shape>)",
             place),
         .width = 16,
         .height = 16,
         .max_depth = 6});
}

/// Mean radiance of the same paths.
double mean(const Scene& scene) {
    PathBatch batch(scene, testing::path_options(scene, 1));
    double sum = 0;
    std::size_t n = 0;
    for (std::uint64_t sample = 0; sample < 64; ++sample) {
        std::vector<PathId> ids;
        for (std::uint64_t pixel = 0; pixel < scene.sensor.n_pixels(); ++pixel) ids.push_back({pixel, sample});
        std::vector<PathResult> results(ids.size());
        batch.trace(ids, results);
        for (const PathResult& result : results) sum += result.L.g;
        n += results.size();
    }
    return sum / double(n);
}

TEST(RayOffset, RadianceDoesNotDependOnTheUnitOfLength) {
    const double metre = mean(*still_life(1));
    EXPECT_NEAR(metre, 0.0625, 0.003);
    EXPECT_EQ(mean(*still_life(0x1p-20)), metre);
    EXPECT_EQ(mean(*still_life(0x1p20)), metre);
    for (const double unit : {1e-3, 1e-4, 1e3}) EXPECT_NEAR(mean(*still_life(unit)) / metre, 1, 1e-3) << unit;
    EXPECT_NEAR(mean(*still_life(1, 1e4)) / metre, 1, 3e-3);
}

}  // namespace
}  // namespace loom::test
