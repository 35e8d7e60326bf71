#include "stages/core/scattering/gradient.h"

#include "stages/core/scattering/bsdf.h"

namespace loom {
namespace {

template <int N>
Vector3<Dual<N>> variable(const Vector3f& v, int first) {
    using T = Dual<N>;
    return {T::variable(v.x, first), T::variable(v.y, first + 1), T::variable(v.z, first + 2)};
}

template <int N>
Spectrum value_of(const Rgb<Dual<N>>& v) {
    return {v.r.value, v.g.value, v.b.value};
}

template <int N>
std::array<Spectrum, 3> derivatives(const Rgb<Dual<N>>& v, int first) {
    std::array<Spectrum, 3> by;
    for (int k = 0; k < 3; ++k) by[k] = {v.r.d[first + k], v.g.d[first + k], v.b.d[first + k]};
    return by;
}

}  // namespace

DirectionGradient f_cos_gradient(const Bsdf<float>& bsdf, const Vector3f& wo, const Vector3f& wi) {
    using T = Dual<6>;
    const Rgb<T> f_cos = f_cos_pdf(Bsdf<T>(bsdf), variable<6>(wo, 0), variable<6>(wi, 3)).f_cos;
    return {value_of(f_cos), derivatives(f_cos, 0), derivatives(f_cos, 3)};
}

DeltaGradient delta_value_gradient(const Bsdf<float>& bsdf, const Vector3f& wo, Lobe lobe) {
    using T = Dual<3>;
    const Rgb<T> value = delta_value(Bsdf<T>(bsdf), variable<3>(wo, 0), lobe);
    return {value_of(value), derivatives(value, 0)};
}

}  // namespace loom
