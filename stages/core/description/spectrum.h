#pragma once
#include <span>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "stages/core/math/vector.h"

namespace loom {

/// Meaning of a colour; decides how a spectrum becomes RGB.
enum class SpectrumUse : std::uint8_t {
    reflectance,  // under D65, in [0, 1]
    emission,     // unscaled, not negative
    index         // index of refraction: like a reflectance, but without bounds
};

/// Samples (wavelength in nm, value), wavelengths increasing.
using SampledSpectrum = std::vector<std::pair<double, double>>;

/// Returns linear sRGB of a piecewise linear spectrum that is zero outside its samples.
///   XYZ = 470 nm / (1000 K) sum_i f(l_i) w(l_i) (x, y, z)(l_i),  l_i evenly over 360...830 nm,
///   K = 106.75026 nm (integral of the observer's y), w = D65 / 98.997417 for reflectances, 1 for emission
Spectrum rgb_from_spectrum(const SampledSpectrum& samples, SpectrumUse use);

/// Returns RGB of a constant spectrum: grey for a reflectance; for emission the colour of XYZ = (1, 1, 1), which is not
/// white in sRGB.
Spectrum rgb_from_constant_spectrum(float value, SpectrumUse use);

/// Decodes one sRGB-encoded channel in [0, 1] to a linear value.
float linear_from_srgb(float encoded);

}  // namespace loom
