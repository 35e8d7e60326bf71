#pragma once
// Values as the path graph stores them: unit vectors in 2 x 16 bits, texture-evaluated BSDF parameters as halves. The
// tracer rounds here and nowhere else, and goes on with the rounded values, so that every later stage computes with
// exactly what the tracer had. Geometry and formulas (surface_geometry.h, scattering/) are exact.

#include <algorithm>

#include "formats/io/half.h"
#include "formats/io/octahedral.h"
#include "stages/core/math/vector.h"

namespace loom {

/// A unit vector or normal after a round trip through its octahedral code.
template <class Kind>
inline Triple<float, Kind> as_stored(const Triple<float, Kind>& unit) {
    const auto code = octahedral_from_unit(unit.x, unit.y, unit.z);
    const auto back = unit_from_octahedral(code[0], code[1]);
    return {back[0], back[1], back[2]};
}

/// A BSDF parameter after a round trip through a half.
inline float as_stored(float value) {
    constexpr float largest_half = 65504;
    return float_from_half(half_from_float(std::min(value, largest_half)));
}
inline Spectrum as_stored(const Spectrum& s) {
    return {as_stored(s.r), as_stored(s.g), as_stored(s.b)};
}

}  // namespace loom
