#pragma once
// Values as stored in the path graph: unit vectors in 2 x 16 bits, texture-evaluated BSDF parameters as halves. The
// tracer rounds only here and continues with the rounded values, so that every later stage computes with the tracer's
// exact values. Geometry and formulas (surface_geometry.h, scattering/) do not round.

#include <algorithm>

#include "formats/io/half.h"
#include "formats/io/octahedral.h"
#include "stages/core/math/vector.h"

namespace loom {

/// Rounds a unit vector or normal to its octahedral code.
template <class Kind>
inline Triple<float, Kind> as_stored(const Triple<float, Kind>& unit) {
    const auto code = octahedral_from_unit(unit.x, unit.y, unit.z);
    const auto back = unit_from_octahedral(code[0], code[1]);
    return {back[0], back[1], back[2]};
}

/// Rounds a BSDF parameter to half precision.
inline float as_stored(float value) {
    constexpr float largest_half = 65504;
    return float_from_half(half_from_float(std::min(value, largest_half)));
}
inline Spectrum as_stored(const Spectrum& s) {
    return {as_stored(s.r), as_stored(s.g), as_stored(s.b)};
}

}  // namespace loom
