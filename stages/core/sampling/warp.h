#pragma once
// Warps of the unit square. sample_x(u) maps uniform samples to x; pdf_x(x) is the density of the result. A density by
// solid angle is in sr^-1. Directions are local; z is the axis of the warp.

#include <bit>
#include <cmath>
#include <cstdint>

#include "stages/core/math/vector.h"

namespace loom {

struct SinCos {
    float sin, cos;
};

/// Returns sin(x) and cos(x) for |x| <= π/4, by minimax polynomials; error below 1 ulp of 1. Cheaper than the library's
/// functions, vectorises, and gives the same bits on every machine.
inline SinCos sin_cos_octant(float x) {
    const float x2 = x * x;
    return {x + x * x2 * (-1.6666654611e-1f + x2 * (8.3321608736e-3f - x2 * 1.9515295891e-4f)),
            1.0f - 0.5f * x2 +
                x2 * x2 * (4.166664568298827e-2f + x2 * (-1.388731625493765e-3f + x2 * 2.443315711809948e-5f))};
}

/// Selects on bits, for masks as random as the samples behind them, where a branch would be mispredicted half of the
/// time.
inline float blend(bool mask, float a, float b) {
    const std::uint32_t m = -static_cast<std::uint32_t>(mask);
    return std::bit_cast<float>((std::bit_cast<std::uint32_t>(a) & m) | (std::bit_cast<std::uint32_t>(b) & ~m));
}

/// Returns sin(2πu) and cos(2πu), u in [0, 1].
inline SinCos sin_cos_turn(float u) {
    const auto quarter = static_cast<std::uint32_t>(static_cast<std::int32_t>(4.0f * u + 0.5f));
    const SinCos r =
        sin_cos_octant((u - 0.25f * static_cast<float>(static_cast<std::int32_t>(quarter))) * (2.0f * pi<float>));
    const bool odd = quarter & 1;
    const std::uint32_t sin_sign = (quarter & 2) << 30, cos_sign = ((quarter + 1) & 2) << 30;
    return {std::bit_cast<float>(std::bit_cast<std::uint32_t>(blend(odd, r.cos, r.sin)) ^ sin_sign),
            std::bit_cast<float>(std::bit_cast<std::uint32_t>(blend(odd, r.sin, r.cos)) ^ cos_sign)};
}

/// Samples the unit disk uniformly; neighbours stay neighbours.   [ShirleyChiu1997] concentric map
inline Point2f sample_concentric_disk(Point2f u) {
    const float a = 2.0f * u.x - 1.0f, b = 2.0f * u.y - 1.0f;
    const bool wide = std::fabs(a) > std::fabs(b);
    const float r = blend(wide, a, b);
    const float ratio = blend(wide, b, a) / select(r == 0.0f, 1.0f, r);
    const SinCos phi = sin_cos_octant(0.25f * pi<float> * ratio);
    return {r * blend(wide, phi.cos, phi.sin), r * blend(wide, phi.sin, phi.cos)};
}
inline float pdf_concentric_disk() {
    return inv_pi<float>;
}

/// Samples the upper hemisphere by cosine.                        [Malley] disk lifted to the sphere
inline Vector3f sample_cosine_hemisphere(Point2f u) {
    const Point2f p = sample_concentric_disk(u);
    // The rim of the disk has cosine 0 and density 0: stay off it, so that no sample has density 0.
    const float z2 = 1.0f - p.x * p.x - p.y * p.y;
    return {p.x, p.y, std::sqrt(select(z2 > 1e-12f, z2, 1e-12f))};
}
template <class T>
T pdf_cosine_hemisphere(const Vector3<T>& w) {
    return select(w.z > T(0), w.z * inv_pi<T>, T(0));
}

inline Vector3f sample_uniform_hemisphere(Point2f u) {
    const float z = u.y;
    const float r = safe_sqrt(1.0f - z * z);
    const SinCos phi = sin_cos_turn(u.x);
    return {r * phi.cos, r * phi.sin, z};
}
inline float pdf_uniform_hemisphere(const Vector3f& w) {
    return w.z >= 0.0f ? 0.5f * inv_pi<float> : 0.0f;
}

inline Vector3f sample_uniform_sphere(Point2f u) {
    const float z = 1.0f - 2.0f * u.y;
    const float r = 2.0f * safe_sqrt(u.y * (1.0f - u.y));
    const SinCos phi = sin_cos_turn(u.x);
    return {r * phi.cos, r * phi.sin, z};
}
inline float pdf_uniform_sphere() {
    return 0.25f * inv_pi<float>;
}

/// Samples directions uniformly in a cone around z. The parameter is 1 - cos(theta_max), for precision in narrow cones.
inline Vector3f sample_uniform_cone(Point2f u, float one_minus_cos_max) {
    const float h = u.y * one_minus_cos_max;  // 1 - cos(theta)
    const float r = safe_sqrt(h * (2.0f - h));
    const SinCos phi = sin_cos_turn(u.x);
    return {r * phi.cos, r * phi.sin, 1.0f - h};
}
inline float pdf_uniform_cone(const Vector3f& w, float one_minus_cos_max) {
    return 1.0f - w.z <= one_minus_cos_max ? 0.5f * inv_pi<float> / one_minus_cos_max : 0.0f;
}

/// Samples barycentric coordinates (b1, b2) uniformly over a triangle; b0 = 1 - b1 - b2.
///                                          [Heitz2019] "A Low-Distortion Map Between Triangle and Square"
inline Point2f sample_triangle(Point2f u) {
    const bool upper = u.y > u.x;
    const float half = 0.5f * (upper ? u.x : u.y);
    return upper ? Point2f{half, u.y - half} : Point2f{u.x - half, half};
}
/// Density per unit area of the barycentric plane; per unit area of the triangle it is 1 / area.
inline float pdf_triangle() {
    return 2.0f;
}

/// Samples the tent 1 - |x| / radius, the reconstruction filter of that shape.
inline float sample_tent(float u, float radius) {
    const float v = 2.0f * u - 1.0f;
    const float t = 1.0f - std::sqrt(1.0f - std::fabs(v));
    return radius * std::copysign(t, v);
}
inline float pdf_tent(float x, float radius) {
    return select(std::fabs(x) < radius, (1.0f - std::fabs(x) / radius) / radius, 0.0f);
}

}  // namespace loom
