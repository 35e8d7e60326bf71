#pragma once
// Light of emitters without area, as templates over the number T: float for the tracer, Dual where an emitter or the
// surface point depends on a parameter.

#include "stages/core/scene/scene.h"

namespace loom {

/// Position, axes and radiance of an emitter that may depend on a parameter; all other values are Emitter's.
template <class T>
struct EmitterPose {
    Rgb<T> radiance;
    Point3<T> position;
    Frame<T> frame;

    explicit EmitterPose(const Emitter& e) : EmitterPose(e, e.frame) {}
    EmitterPose(const Emitter& e, const Framef& axes)
        : radiance(e.radiance),
          position(e.position),
          frame(Vector3<T>(axes.s), Vector3<T>(axes.t), Normal3<T>(axes.n)) {}
};

/// Fraction of its intensity that a spot emits in a local direction: 1 inside the beam, falling linearly with the angle
/// to 0 at the cutoff; times the texture.
template <class T>
Rgb<T> spot_falloff(const Scene& scene, const Emitter& e, const Vector3<T>& local) {
    using std::acos;
    const T angle = acos(clamp(local.z, T(-1), T(1)));
    if (angle >= T(e.cutoff_rad)) return Rgb<T>(T(0));
    const T falloff = angle <= T(e.beam_rad) ? T(1) : (T(e.cutoff_rad) - angle) / T(e.cutoff_rad - e.beam_rad);
    if (e.texture_idx < 0) return Rgb<T>(falloff);
    const T scale = T(0.5f) / (local.z * T(std::tan(e.cutoff_rad)));
    return scene.textures[e.texture_idx].eval(Point2<T>{T(0.5f) + local.x * scale, T(0.5f) + local.y * scale}) *
           falloff;
}

/// Radiance of a projector's beam at x and y, in units of half its width and height. The image is upright for a viewer
/// who looks along the beam, like that of a camera at the projector's position.
template <class T>
Rgb<T> beam_radiance(const Scene& scene, const Emitter& projector, const Rgb<T>& radiance, const T& x, const T& y) {
    if (projector.texture_idx < 0) return radiance;
    return radiance *
           scene.textures[projector.texture_idx].eval(Point2<T>{T(0.5f) - T(0.5f) * x, T(0.5f) - T(0.5f) * y});
}

/// Irradiance of a plane at p that faces the projector, whose beam goes along z of pose.frame.
///   pi irradiance r / z^3 within the beam: intensity pi irradiance / cos^3        [Mitsuba 3, "projector"]
template <class T>
Rgb<T> projected(const Scene& scene, const Emitter& projector, const EmitterPose<T>& pose, const Point3<T>& p) {
    using std::fabs;
    const Vector3<T> local = pose.frame.to_local(p - pose.position);
    const T tan_x(projector.tan_x), tan_y(projector.tan_y);
    if (!(local.z > T(0) && fabs(local.x) <= tan_x * local.z && fabs(local.y) <= tan_y * local.z)) return Rgb<T>(T(0));
    const Rgb<T> radiance =
        beam_radiance(scene, projector, pose.radiance, local.x / (local.z * tan_x), local.y / (local.z * tan_y));
    return radiance * (pi<T> * length(local) / (local.z * local.z * local.z));
}

/// Returns the light sample of a delta emitter at a surface point; pmf is 1.
/// needs:   e.is_delta()
template <class T>
LightSampleOf<T> delta_light(const Scene& scene, const Emitter& e, const EmitterPose<T>& pose, const Point3<T>& from) {
    using std::sqrt;
    LightSampleOf<T> s;
    s.delta = true;
    s.pmf = T(1);
    if (e.kind == EmitterKind::directional) {
        s.at_infinity = true;
        s.wi = -Vector3<T>(pose.frame.n);
        s.y = Point3<T>(s.wi);
        s.Li = pose.radiance;
        return s;
    }
    const Vector3<T> d = pose.position - from;
    const T d2 = length2(d);
    s.y = pose.position;
    s.wi = d / sqrt(d2);
    s.Li = e.kind == EmitterKind::projector ? projected(scene, e, pose, from) : pose.radiance / d2;
    if (e.kind == EmitterKind::spot) s.Li *= spot_falloff(scene, e, pose.frame.to_local(-s.wi));
    return s;
}

}  // namespace loom
