#pragma once
#include "stages/core/math/vector.h"

namespace loom {

/// Orthonormal shading frame; in local coordinates z is the shading normal.
template <class T>
struct Frame {
    Vector3<T> s, t;
    Normal3<T> n;

    Frame() = default;
    Frame(const Vector3<T>& s_, const Vector3<T>& t_, const Normal3<T>& n_) : s(s_), t(t_), n(n_) {}

    /// Makes a frame from a normal alone, as every stage does: a stored normal then suffices for any isotropic BSDF.
    ///                                     [Duff2017] "Building an Orthonormal Basis, Revisited", listing 3
    explicit Frame(const Normal3<T>& normal) : n(normal) {
        const T sign = select(n.z >= T(0), T(1), T(-1));
        const T a = T(-1) / (sign + n.z);
        const T b = n.x * n.y * a;
        s = {T(1) + sign * n.x * n.x * a, sign * b, -sign * n.x};
        t = {b, sign + n.y * n.y * a, -n.y};
    }

    Vector3<T> to_local(const Vector3<T>& v) const { return {dot(v, s), dot(v, t), dot(v, n)}; }
    Vector3<T> to_world(const Vector3<T>& v) const {
        return {s.x * v.x + t.x * v.y + n.x * v.z, s.y * v.x + t.y * v.y + n.y * v.z,
                s.z * v.x + t.z * v.y + n.z * v.z};
    }
};
using Framef = Frame<float>;

/// Frame whose x follows dp/du, so that maps and anisotropy have a direction.
template <class T>
inline Frame<T> frame_along(const Normal3<T>& n, const Vector3<T>& dp_du) {
    using std::sqrt;
    const Vector3<T> s = dp_du - Vector3<T>(n) * dot(n, dp_du);
    const T len2 = length2(s);
    // Without a branch, for loops over columns.
    const bool known = len2 > T(0);
    const Frame<T> any(n);
    const Vector3<T> unit = select(known, s / sqrt(select(known, len2, T(1))), any.s);
    return {unit, select(known, cross(n, unit), any.t), n};
}

// Trigonometry of a direction in its local frame.
template <class T>
T cos_theta(const Vector3<T>& w) {
    return w.z;
}
template <class T>
T sin2_theta(const Vector3<T>& w) {
    return w.x * w.x + w.y * w.y;
}
/// Returns the mirror direction about z.
template <class T>
Vector3<T> reflect(const Vector3<T>& w) {
    return {-w.x, -w.y, w.z};
}

}  // namespace loom
