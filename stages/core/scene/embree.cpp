// The only file that uses Embree, 3 or 4.
#include "stages/core/scene/embree.h"

#if LOOM_EMBREE >= 4
#include <embree4/rtcore.h>
#else
#include <embree3/rtcore.h>
#endif

#include <algorithm>
#include <stdexcept>
#include <string>

#include "stages/core/compute/parallel.h"
#include "stages/core/scene/scene.h"

namespace loom {
namespace {

void on_error(void*, RTCError code, const char* message) {
    throw std::runtime_error("Embree error " + std::to_string(int(code)) + ": " + (message ? message : ""));
}

struct AnalyticHit {
    double t;
    float u, v;
};

/// Computes the ray parameters at a sphere in double precision: a float quadratic loses the far side of a large sphere.
/// Returns false for a miss.
bool sphere_roots(const Shape& s, const Ray& r, double roots[2]) {
    const Vector3<double> o{double(r.o.x) - s.round.center.x, double(r.o.y) - s.round.center.y,
                            double(r.o.z) - s.round.center.z};
    const Vector3<double> d(r.d);
    const double a = length2(d), half_b = dot(o, d), radius = s.round.radius;
    // Distance of the line from the centre without cancellation.
    const Vector3<double> nearest = o - d * (half_b / a);
    const double discriminant = a * (radius * radius - length2(nearest));
    if (discriminant < 0) return false;
    const double root = std::sqrt(discriminant);
    roots[0] = (-half_b - root) / a;
    roots[1] = (-half_b + root) / a;
    return true;
}

/// Nearest root in (t_min, t_max).
bool intersect_sphere(const Shape& s, const Ray& r, AnalyticHit& hit) {
    double roots[2];
    if (!sphere_roots(s, r, roots)) return false;
    for (double t : roots)
        if (t > r.t_min && t < r.t_max) {
            hit = {t, 0, 0};
            return true;
        }
    return false;
}

bool intersect_disk(const Shape& s, const Ray& r, AnalyticHit& hit) {
    const Vector3<double> u(s.round.u_axis), v(s.round.v_axis), n = cross(u, v), d(r.d);
    const Vector3<double> to_center{double(s.round.center.x) - r.o.x, double(s.round.center.y) - r.o.y,
                                    double(s.round.center.z) - r.o.z};
    const double slope = dot(n, d);
    if (slope == 0) return false;
    const double t = dot(n, to_center) / slope;
    if (!(t > r.t_min && t < r.t_max)) return false;
    // Affine coordinates in the plane of the disk; exact for skewed axes too.
    const Vector3<double> q = d * t - to_center;
    const double n2 = length2(n), x = dot(cross(q, v), n) / n2, y = dot(cross(u, q), n) / n2;
    if (x * x + y * y > 1) return false;
    hit = {t, float(x), float(y)};
    return true;
}

bool intersect_analytic(const Shape& s, const Ray& r, AnalyticHit& hit) {
    return s.kind == ShapeKind::sphere ? intersect_sphere(s, r, hit) : intersect_disk(s, r, hit);
}

void analytic_bounds(const RTCBoundsFunctionArguments* args) {
    const Box3f box = static_cast<const Shape*>(args->geometryUserPtr)->bounds();
    *args->bounds_o = {box.lo.x, box.lo.y, box.lo.z, 0, box.hi.x, box.hi.y, box.hi.z, 0};
}

Ray lane(RTCRayN* rays, unsigned n, unsigned i) {
    return {{RTCRayN_org_x(rays, n, i), RTCRayN_org_y(rays, n, i), RTCRayN_org_z(rays, n, i)},
            {RTCRayN_dir_x(rays, n, i), RTCRayN_dir_y(rays, n, i), RTCRayN_dir_z(rays, n, i)},
            RTCRayN_tnear(rays, n, i),
            RTCRayN_tfar(rays, n, i)};
}

void analytic_intersect(const RTCIntersectFunctionNArguments* args) {
    const unsigned n = args->N;
    RTCRayN* rays = RTCRayHitN_RayN(args->rayhit, n);
    RTCHitN* hits = RTCRayHitN_HitN(args->rayhit, n);
    for (unsigned i = 0; i < n; ++i) {
        AnalyticHit hit;
        if (!args->valid[i] ||
            !intersect_analytic(*static_cast<const Shape*>(args->geometryUserPtr), lane(rays, n, i), hit))
            continue;
        RTCRayN_tfar(rays, n, i) = float(hit.t);
        RTCHitN_u(hits, n, i) = hit.u;
        RTCHitN_v(hits, n, i) = hit.v;
        RTCHitN_primID(hits, n, i) = args->primID;
        RTCHitN_geomID(hits, n, i) = args->geomID;
    }
}

/// Context of a ray query; callbacks receive the address of its first member.
struct QueryContext {
#if RTC_VERSION_MAJOR >= 4
    RTCRayQueryContext rtc;
#else
    RTCIntersectContext rtc;
#endif
    bool coherent = false;
    std::vector<Hit>* crossings = nullptr;  // collects all hits; no hit ends the ray
};

std::vector<Hit>* crossings_of(const auto& args) {
    return reinterpret_cast<QueryContext*>(args.context)->crossings;
}

void collect_triangle(const RTCFilterFunctionNArguments* args) {
    std::vector<Hit>& hits = *crossings_of(*args);
    for (unsigned i = 0; i < args->N; ++i) {
        if (!args->valid[i]) continue;
        args->valid[i] = 0;
        const Hit hit{RTCRayN_tfar(args->ray, args->N, i), RTCHitN_u(args->hit, args->N, i),
                      RTCHitN_v(args->hit, args->N, i), RTCHitN_geomID(args->hit, args->N, i),
                      RTCHitN_primID(args->hit, args->N, i)};
        // A triangle that the builder has split is hit once per piece.
        const auto same = [&](const Hit& h) {
            return h.shape_idx == hit.shape_idx && h.primitive_idx == hit.primitive_idx;
        };
        if (std::none_of(hits.begin(), hits.end(), same)) hits.push_back(hit);
    }
}

void collect_analytic(const Shape& shape, unsigned index, const Ray& ray, std::vector<Hit>& hits) {
    if (shape.kind == ShapeKind::sphere) {
        double roots[2];
        if (!sphere_roots(shape, ray, roots)) return;
        for (double t : roots)
            if (t > ray.t_min && t < ray.t_max) hits.push_back({float(t), 0, 0, index, 0});
    } else if (AnalyticHit hit; intersect_disk(shape, ray, hit)) {
        hits.push_back({float(hit.t), hit.u, hit.v, index, 0});
    }
}

void analytic_occluded(const RTCOccludedFunctionNArguments* args) {
    const unsigned n = args->N;
    if (std::vector<Hit>* hits = crossings_of(*args)) {
        for (unsigned i = 0; i < n; ++i)
            if (args->valid[i])
                collect_analytic(*static_cast<const Shape*>(args->geometryUserPtr), args->geomID, lane(args->ray, n, i),
                                 *hits);
        return;
    }
    for (unsigned i = 0; i < n; ++i) {
        AnalyticHit hit;
        if (args->valid[i] &&
            intersect_analytic(*static_cast<const Shape*>(args->geometryUserPtr), lane(args->ray, n, i), hit))
            RTCRayN_tfar(args->ray, n, i) = -INFINITY;
    }
}

#if RTC_VERSION_MAJOR >= 4

constexpr RTCSceneFlags crossings_flag = RTC_SCENE_FLAG_FILTER_FUNCTION_IN_ARGUMENTS;

/// The default context of Embree 4 is not part of a QueryContext, so every query provides its own.
void init(QueryContext& context) {
    rtcInitRayQueryContext(&context.rtc);
}

RTCIntersectArguments intersect_arguments(QueryContext& context) {
    RTCIntersectArguments args;
    rtcInitIntersectArguments(&args);
    args.context = &context.rtc;
    if (context.coherent) args.flags = RTC_RAY_QUERY_FLAG_COHERENT;
    return args;
}

RTCOccludedArguments occluded_arguments(QueryContext& context) {
    RTCOccludedArguments args;
    rtcInitOccludedArguments(&args);
    args.context = &context.rtc;
    if (context.crossings) {
        args.flags = RTC_RAY_QUERY_FLAG_INVOKE_ARGUMENT_FILTER;
        args.filter = collect_triangle;
    }
    return args;
}

void intersect1(RTCScene scene, QueryContext& context, RTCRayHit& ray) {
    RTCIntersectArguments args = intersect_arguments(context);
    rtcIntersect1(scene, &ray, &args);
}

void intersect16(const int* valid, RTCScene scene, QueryContext& context, RTCRayHit16& rays) {
    RTCIntersectArguments args = intersect_arguments(context);
    rtcIntersect16(valid, scene, &rays, &args);
}

void occluded1(RTCScene scene, QueryContext& context, RTCRay& ray) {
    RTCOccludedArguments args = occluded_arguments(context);
    rtcOccluded1(scene, &ray, &args);
}

void occluded16(const int* valid, RTCScene scene, QueryContext& context, RTCRay16& rays) {
    RTCOccludedArguments args = occluded_arguments(context);
    rtcOccluded16(valid, scene, &rays, &args);
}

#else

constexpr RTCSceneFlags crossings_flag = RTC_SCENE_FLAG_CONTEXT_FILTER_FUNCTION;

void init(QueryContext& context) {
    rtcInitIntersectContext(&context.rtc);
    if (context.coherent) context.rtc.flags = RTC_INTERSECT_CONTEXT_FLAG_COHERENT;
    if (context.crossings) context.rtc.filter = collect_triangle;
}

void intersect1(RTCScene scene, QueryContext& context, RTCRayHit& ray) {
    rtcIntersect1(scene, &context.rtc, &ray);
}

void intersect16(const int* valid, RTCScene scene, QueryContext& context, RTCRayHit16& rays) {
    rtcIntersect16(valid, scene, &context.rtc, &rays);
}

void occluded1(RTCScene scene, QueryContext& context, RTCRay& ray) {
    rtcOccluded1(scene, &context.rtc, &ray);
}

void occluded16(const int* valid, RTCScene scene, QueryContext& context, RTCRay16& rays) {
    rtcOccluded16(valid, scene, &context.rtc, &rays);
}

#endif

QueryContext make_context(bool coherent = false, std::vector<Hit>* crossings = nullptr) {
    QueryContext context;
    context.coherent = coherent;
    context.crossings = crossings;
    init(context);
    return context;
}

RTCRay to_rtc(const Ray& ray) {
    return {ray.o.x, ray.o.y, ray.o.z, ray.t_min, ray.d.x, ray.d.y, ray.d.z, 0, ray.t_max, ~0u, 0, 0};
}

}  // namespace

struct RayEngine::Impl {
    RTCDevice device = nullptr;
    RTCScene scene = nullptr;
    std::shared_ptr<const RayEngine> base;  // null: none
    std::vector<std::uint32_t> of_base;

    RTCScene base_scene() const { return base->impl_->scene; }
    /// Turns the index of a shape of the base that was hit into that of all shapes.
    void rename(unsigned& geom_id) const {
        if (geom_id != RTC_INVALID_GEOMETRY_ID) geom_id = of_base[geom_id];
    }
    ~Impl() {
        if (scene) rtcReleaseScene(scene);
        if (device) rtcReleaseDevice(device);
    }
};

RayEngine::RayEngine(const std::vector<Shape>& shapes, Use use) : impl_(std::make_unique<Impl>()) {
    build(shapes, use, std::vector<bool>(shapes.size()));
}

RayEngine::RayEngine(const std::vector<Shape>& shapes, std::shared_ptr<const RayEngine> base,
                     std::vector<std::uint32_t> of_base, Use use)
    : impl_(std::make_unique<Impl>()) {
    std::vector<bool> left_out(shapes.size());
    for (const std::uint32_t shape_idx : of_base) left_out[shape_idx] = true;
    if (base->impl_->base) throw std::logic_error("a ray engine beside one that lies beside another");
    impl_->base = std::move(base);
    impl_->of_base = std::move(of_base);
    build(shapes, use, left_out);
}

void RayEngine::build(const std::vector<Shape>& shapes, Use use, const std::vector<bool>& left_out) {
    flush_small_numbers();
    impl_->device = rtcNewDevice(nullptr);
    if (!impl_->device) throw std::runtime_error("Embree cannot make a device");
    rtcSetDeviceErrorFunction(impl_->device, on_error, nullptr);
    impl_->scene = rtcNewScene(impl_->device);
    if (use == Use::crossings) rtcSetSceneFlags(impl_->scene, crossings_flag);
    rtcSetSceneBuildQuality(impl_->scene, RTC_BUILD_QUALITY_HIGH);
    for (std::size_t i = 0; i < shapes.size(); ++i) {
        const Shape& shape = shapes[i];
        if (left_out[i] || (use == Use::camera_rays && shape.emitter_idx >= 0)) continue;
        RTCGeometry geometry;
        if (shape.kind == ShapeKind::mesh) {
            geometry = rtcNewGeometry(impl_->device, RTC_GEOMETRY_TYPE_TRIANGLE);
            // Embree reads 16 bytes from the last vertex, so it needs a padded copy.
            const auto& p = shape.mesh.positions;
            auto* vertices = static_cast<float*>(
                rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3, 12, p.size()));
            for (std::size_t k = 0; k < p.size(); ++k)
                for (int axis = 0; axis < 3; ++axis) vertices[3 * k + axis] = p[k][axis];
            auto* indices = static_cast<std::uint32_t*>(rtcSetNewGeometryBuffer(
                geometry, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3, 12, shape.mesh.indices.size() / 3));
            std::copy(shape.mesh.indices.begin(), shape.mesh.indices.end(), indices);
        } else {
            geometry = rtcNewGeometry(impl_->device, RTC_GEOMETRY_TYPE_USER);
            rtcSetGeometryUserPrimitiveCount(geometry, 1);
            rtcSetGeometryUserData(geometry, const_cast<Shape*>(&shape));
            rtcSetGeometryBoundsFunction(geometry, analytic_bounds, nullptr);
            rtcSetGeometryIntersectFunction(geometry, analytic_intersect);
            rtcSetGeometryOccludedFunction(geometry, analytic_occluded);
        }
        rtcCommitGeometry(geometry);
        rtcAttachGeometryByID(impl_->scene, geometry, unsigned(i));
        rtcReleaseGeometry(geometry);
    }
    rtcCommitScene(impl_->scene);
}

RayEngine::~RayEngine() = default;

Hit RayEngine::intersect(const Ray& ray) const {
    RTCRayHit rh;
    rh.ray = to_rtc(ray);
    rh.hit.geomID = RTC_INVALID_GEOMETRY_ID;
    rh.hit.instID[0] = RTC_INVALID_GEOMETRY_ID;
    QueryContext context = make_context();
    if (impl_->base) {
        intersect1(impl_->base_scene(), context, rh);
        impl_->rename(rh.hit.geomID);
    }
    intersect1(impl_->scene, context, rh);
    Hit hit;
    if (rh.hit.geomID == RTC_INVALID_GEOMETRY_ID) return hit;
    hit.t = rh.ray.tfar;
    hit.u = rh.hit.u;
    hit.v = rh.hit.v;
    hit.shape_idx = rh.hit.geomID;
    hit.primitive_idx = rh.hit.primID;
    return hit;
}

bool RayEngine::occluded(const Ray& ray) const {
    RTCRay r = to_rtc(ray);
    QueryContext context = make_context();
    if (impl_->base) occluded1(impl_->base_scene(), context, r);
    if (!(r.tfar < 0)) occluded1(impl_->scene, context, r);
    return r.tfar < 0;
}

void RayEngine::crossings(const Ray& ray, std::vector<Hit>& hits) const {
    hits.clear();
    RTCRay r = to_rtc(ray);
    QueryContext context = make_context(false, &hits);
    std::vector<Hit> of_base;
    if (impl_->base) {
        impl_->base->crossings(ray, of_base);
        for (Hit& hit : of_base) hit.shape_idx = impl_->of_base[hit.shape_idx];
    }
    occluded1(impl_->scene, context, r);
    hits.insert(hits.end(), of_base.begin(), of_base.end());
}

namespace {

constexpr std::size_t packet = 16;

/// Fills one lane of a packet of rays (RTCRay16 has the same members as columns).
void set_lane(RTCRay16& p, std::size_t i, const Ray& ray) {
    p.org_x[i] = ray.o.x;
    p.org_y[i] = ray.o.y;
    p.org_z[i] = ray.o.z;
    p.dir_x[i] = ray.d.x;
    p.dir_y[i] = ray.d.y;
    p.dir_z[i] = ray.d.z;
    p.tnear[i] = ray.t_min;
    p.tfar[i] = ray.t_max;
    p.time[i] = 0;
    p.mask[i] = ~0u;
    p.id[i] = 0;
    p.flags[i] = 0;
}

}  // namespace

void RayEngine::intersect(const Ray* const* rays, std::size_t n, Hit* hits, bool coherent) const {
    QueryContext context = make_context(coherent);
    for (std::size_t begin = 0; begin < n; begin += packet) {
        const std::size_t count = std::min(packet, n - begin);
        alignas(64) int valid[packet];
        RTCRayHit16 p;
        for (std::size_t i = 0; i < packet; ++i) {
            valid[i] = i < count ? -1 : 0;
            set_lane(p.ray, i, *rays[begin + std::min(i, count - 1)]);
            p.hit.geomID[i] = RTC_INVALID_GEOMETRY_ID;
            p.hit.instID[0][i] = RTC_INVALID_GEOMETRY_ID;
        }
        if (impl_->base) {
            intersect16(valid, impl_->base_scene(), context, p);
            for (std::size_t i = 0; i < count; ++i) impl_->rename(p.hit.geomID[i]);
        }
        intersect16(valid, impl_->scene, context, p);
        for (std::size_t i = 0; i < count; ++i)
            hits[begin + i] = p.hit.geomID[i] == RTC_INVALID_GEOMETRY_ID
                                  ? Hit{}
                                  : Hit{p.ray.tfar[i], p.hit.u[i], p.hit.v[i], p.hit.geomID[i], p.hit.primID[i]};
    }
}

void RayEngine::occluded(const Ray* const* rays, std::size_t n, bool* blocked) const {
    QueryContext context = make_context();
    for (std::size_t begin = 0; begin < n; begin += packet) {
        const std::size_t count = std::min(packet, n - begin);
        alignas(64) int valid[packet];
        RTCRay16 p;
        for (std::size_t i = 0; i < packet; ++i) {
            valid[i] = i < count ? -1 : 0;
            set_lane(p, i, *rays[begin + std::min(i, count - 1)]);
        }
        if (impl_->base) {
            occluded16(valid, impl_->base_scene(), context, p);
            for (std::size_t i = 0; i < count; ++i) valid[i] = p.tfar[i] < 0 ? 0 : -1;
        }
        occluded16(valid, impl_->scene, context, p);
        for (std::size_t i = 0; i < count; ++i) blocked[begin + i] = p.tfar[i] < 0;
    }
}

}  // namespace loom
