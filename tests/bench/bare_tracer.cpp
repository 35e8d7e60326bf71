#include "tests/bench/bare_tracer.h"

#if LOOM_EMBREE >= 4
#include <embree4/rtcore.h>
#else
#include <embree3/rtcore.h>
#endif

#include <mutex>
#include <stdexcept>
#include <vector>

#include "stages/core/compute/parallel.h"
#include "stages/core/sampling/distribution.h"
#include "stages/core/sampling/warp.h"

namespace loom::bench {
namespace {

/// A few instructions per number; it needs no other quality.
class Random {
  public:
    explicit Random(std::uint64_t seed) : state_(seed * 0x9e3779b97f4a7c15ull + 1) {}
    float next() {
        state_ ^= state_ << 13;
        state_ ^= state_ >> 7;
        state_ ^= state_ << 17;
        return float(state_ >> 40) * 0x1p-24f;
    }
    Point2f pair() {
        const float x = next();
        return {x, next()};
    }

  private:
    std::uint64_t state_;
};

Mesh grid_mesh(int columns, int rows, const auto& point) {
    Mesh mesh;
    for (int j = 0; j <= rows; ++j)
        for (int i = 0; i <= columns; ++i) mesh.positions.push_back(point(float(i) / columns, float(j) / rows));
    for (int j = 0; j < rows; ++j)
        for (int i = 0; i < columns; ++i) {
            const auto a = std::uint32_t(j * (columns + 1) + i), b = a + std::uint32_t(columns) + 1;
            mesh.indices.insert(mesh.indices.end(), {a, a + 1, b + 1, a, b + 1, b});
        }
    return mesh;
}

Mesh triangles_of(const Shape& s) {
    if (s.kind == ShapeKind::mesh) return s.mesh;
    const bool sphere = s.kind == ShapeKind::sphere;
    const Vector3f axis = cross(s.round.u_axis, s.round.v_axis);
    return grid_mesh(64, sphere ? 32 : 1, [&](float u, float v) {
        const SinCos phi = sin_cos_turn(u);
        const Vector3f around = s.round.u_axis * phi.cos + s.round.v_axis * phi.sin;
        if (!sphere) return s.round.center + around * v;
        const float theta = v * pi<float>;
        return s.round.center + (around * std::sin(theta) + axis * std::cos(theta)) * s.round.radius;
    });
}

float grey_albedo(const Scene& scene, const Material& m) {
    Bsdf<float> b(m.model);
    if (m.diffuse_idx >= 0) b.diffuse = scene.textures[m.diffuse_idx].mean();
    if (m.specular_idx >= 0) b.specular = scene.textures[m.specular_idx].mean();
    return max_channel(albedo(b, Vector3f{0, 0, 1}));
}

#if RTC_VERSION_MAJOR >= 4
void intersect1(RTCScene scene, RTCRayHit& ray) {
    rtcIntersect1(scene, &ray);
}

void occluded1(RTCScene scene, RTCRay& ray) {
    rtcOccluded1(scene, &ray);
}
#else
void intersect1(RTCScene scene, RTCRayHit& ray) {
    RTCIntersectContext context;
    rtcInitIntersectContext(&context);
    rtcIntersect1(scene, &context, &ray);
}

void occluded1(RTCScene scene, RTCRay& ray) {
    RTCIntersectContext context;
    rtcInitIntersectContext(&context);
    rtcOccluded1(scene, &context, &ray);
}
#endif

struct Lamp {
    Point3f p;
    Vector3f e1, e2;
    Normal3f n;
};

}  // namespace

struct BareTracer::Impl {
    const Scene& loom_scene;
    RTCDevice device = rtcNewDevice(nullptr);
    RTCScene scene = nullptr;
    std::vector<float> albedos, emission;  // by shape
    std::vector<Lamp> lamps;
    Distribution1 lamp_pmf;
    float lamp_area = 0, lamp_radiance = 0;
    Point3f point_light;  // used where no surface emits and there is no environment

    explicit Impl(const Scene& s) : loom_scene(s) {
        if (!device) throw std::runtime_error("Embree cannot make a device");
        scene = rtcNewScene(device);
        rtcSetSceneBuildQuality(scene, RTC_BUILD_QUALITY_HIGH);
        std::vector<double> areas;
        for (std::size_t i = 0; i < s.shapes.size(); ++i) {
            const Shape& shape = s.shapes[i];
            const Mesh mesh = triangles_of(shape);
            RTCGeometry geometry = rtcNewGeometry(device, RTC_GEOMETRY_TYPE_TRIANGLE);
            auto* p = static_cast<Point3f*>(rtcSetNewGeometryBuffer(
                geometry, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3, sizeof(Point3f), mesh.positions.size()));
            std::copy(mesh.positions.begin(), mesh.positions.end(), p);
            auto* indices = static_cast<std::uint32_t*>(rtcSetNewGeometryBuffer(
                geometry, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3, 12, mesh.indices.size() / 3));
            std::copy(mesh.indices.begin(), mesh.indices.end(), indices);
            rtcCommitGeometry(geometry);
            rtcAttachGeometryByID(scene, geometry, unsigned(i));
            rtcReleaseGeometry(geometry);
            albedos.push_back(grey_albedo(s, s.materials[shape.material_idx]));
            emission.push_back(shape.emitter_idx < 0 ? 0.0f : mean_channel(s.emitters[shape.emitter_idx].radiance));
            if (shape.emitter_idx < 0) continue;
            lamp_radiance = emission.back();
            for (std::size_t t = 0; t < mesh.indices.size(); t += 3) {
                const Point3f &a = mesh.positions[mesh.indices[t]], &b = mesh.positions[mesh.indices[t + 1]],
                              &c = mesh.positions[mesh.indices[t + 2]];
                const Vector3f n = cross(b - a, c - a);
                if (!(length2(n) > 0)) continue;
                lamps.push_back({a, b - a, c - a, Normal3f(normalize(n))});
                areas.push_back(0.5 * length(n));
            }
        }
        rtcCommitScene(scene);
        if (!areas.empty()) lamp_pmf = Distribution1(areas);
        lamp_area = float(lamp_pmf.sum());
        for (const Emitter& e : s.emitters)
            if (e.kind == EmitterKind::point || e.kind == EmitterKind::spot) point_light = e.position;
    }
    ~Impl() {
        if (scene) rtcReleaseScene(scene);
        rtcReleaseDevice(device);
    }

    bool occluded(const Point3f& p, const Vector3f& d, float t_max) const {
        RTCRay ray{p.x, p.y, p.z, 0, d.x, d.y, d.z, 0, t_max, ~0u, 0, 0};
        occluded1(scene, ray);
        return ray.tfar < 0;
    }

    /// Light that one shadow ray finds, times cosine over density.
    float direct(const Point3f& p, const Normal3f& n, Random& random) const {
        if (!lamps.empty()) {
            Point2f u = random.pair();
            const Lamp& lamp = lamps[lamp_pmf.sample(u.x)];
            const Point2f b = sample_triangle(u);
            const Vector3f d = lamp.p + lamp.e1 * b.x + lamp.e2 * b.y - p;
            const float d2 = length2(d), cos_here = dot(n, d), cos_there = std::abs(dot(lamp.n, d));
            if (!(cos_here > 0) || occluded(p, d, 0.999f)) return 0;
            return lamp_radiance * cos_here * cos_there * lamp_area / (d2 * d2);
        }
        if (loom_scene.environment_idx >= 0) {
            const Framef frame(n);
            return occluded(p, frame.to_world(sample_cosine_hemisphere(random.pair())), INFINITY) ? 0.0f : pi<float>;
        }
        const Vector3f d = point_light - p;
        const float d2 = length2(d), cos_here = dot(n, d);
        return cos_here > 0 && !occluded(p, d, 0.999f) ? cos_here / (d2 * std::sqrt(d2)) : 0.0f;
    }

    /// out: radiance of one path, its vertices added to n
    float path(std::uint32_t x, std::uint32_t y, Random& random, std::uint64_t& n) const {
        const Ray camera = loom_scene.sensor.sample_ray(x, y, random.pair());
        RTCRayHit rh;
        rh.ray = {camera.o.x, camera.o.y, camera.o.z,   camera.t_min, camera.d.x, camera.d.y,
                  camera.d.z, 0,          camera.t_max, ~0u,          0,          0};
        float radiance = 0, beta = 1;
        for (int depth = 1;; ++depth) {
            rh.hit.geomID = RTC_INVALID_GEOMETRY_ID;
            intersect1(scene, rh);
            if (rh.hit.geomID == RTC_INVALID_GEOMETRY_ID) return radiance;
            ++n;
            if (depth == 1) radiance += emission[rh.hit.geomID];
            if (loom_scene.max_depth >= 0 && depth >= loom_scene.max_depth) return radiance;
            const Vector3f d{rh.ray.dir_x, rh.ray.dir_y, rh.ray.dir_z};
            Normal3f ng = normalize(Normal3f(rh.hit.Ng_x, rh.hit.Ng_y, rh.hit.Ng_z));
            if (dot(ng, d) > 0) ng = -ng;
            const Point3f p = offset_origin(Point3f(rh.ray.org_x, rh.ray.org_y, rh.ray.org_z) + d * rh.ray.tfar, ng,
                                            1e-5f * loom_scene.radius, Vector3f(ng));
            const float reflectance = albedos[rh.hit.geomID];
            radiance += beta * reflectance * inv_pi<float> * direct(p, ng, random);
            if (depth >= 5) {
                const float q = std::min(reflectance, 0.95f);
                if (random.next() >= q) return radiance;
                beta /= q;
            }
            beta *= reflectance;
            if (beta == 0) return radiance;
            const Vector3f wi = Framef(ng).to_world(sample_cosine_hemisphere(random.pair()));
            rh.ray = {p.x, p.y, p.z, 0, wi.x, wi.y, wi.z, 0, INFINITY, ~0u, 0, 0};
        }
    }
};

BareTracer::BareTracer(const Scene& scene) : impl_(std::make_unique<Impl>(scene)) {}
BareTracer::~BareTracer() = default;

BareTracer::Result BareTracer::render(std::uint64_t spp, int threads) const {
    const auto [width, height] = std::pair(impl_->loom_scene.sensor.width, impl_->loom_scene.sensor.height);
    const std::uint64_t n_paths = std::uint64_t(width) * height * spp;
    Result result;
    std::mutex mutex;
    parallel_chunks(n_paths, 4096, threads, [&](std::uint64_t chunk, std::uint64_t begin, std::uint64_t end) {
        Random random(chunk + 1);
        std::uint64_t vertices = 0;
        double sum = 0;
        for (std::uint64_t i = begin; i < end; ++i) {
            const std::uint64_t pixel = i % (std::uint64_t(width) * height);
            sum += impl_->path(std::uint32_t(pixel % width), std::uint32_t(pixel / width), random, vertices);
        }
        const std::lock_guard lock(mutex);
        result.vertices += vertices;
        result.mean_radiance += sum / double(n_paths);
    });
    return result;
}

}  // namespace loom::bench
