// CIE 1931 2-degree colour matching functions and the CIE standard illuminant D65.
#include "stages/core/description/spectrum.h"

#include <algorithm>
#include <array>
#include <cmath>

namespace loom {
namespace {

struct CieRow {
    double x, y, z, d65;  // d65 divided by 98.997417, so that its luminance equals that of a constant 1
};
constexpr double first_nm = 360, step_nm = 5, last_nm = 830;
// clang-format off
constexpr CieRow cie_table[] = {
    {0.0001299, 3.917e-06, 0.0006061, 0.471106}, {0.0002321, 6.965e-06, 0.001086, 0.498636},
    {0.0004149, 1.239e-05, 0.001946, 0.526166}, {0.0007416, 2.202e-05, 0.003486, 0.515491},
    {0.001368, 3.9e-05, 0.00645, 0.504816}, {0.002236, 6.4e-05, 0.01055, 0.528416},
    {0.004243, 0.00012, 0.02005, 0.552016}, {0.00765, 0.000217, 0.03621, 0.693973},
    {0.01431, 0.000396, 0.06785, 0.83593}, {0.02319, 0.00064, 0.1102, 0.880027},
    {0.04351, 0.00121, 0.2074, 0.924125}, {0.07763, 0.00218, 0.3713, 0.933953},
    {0.13438, 0.004, 0.6456, 0.94378}, {0.21477, 0.0073, 1.03905, 0.90969},
    {0.2839, 0.0116, 1.3856, 0.875602}, {0.3285, 0.01684, 1.62296, 0.967435},
    {0.34828, 0.023, 1.74706, 1.05927}, {0.34806, 0.0298, 1.7826, 1.1206},
    {0.3362, 0.038, 1.77211, 1.18193}, {0.3187, 0.048, 1.7441, 1.18599}, {0.2908, 0.06, 1.6692, 1.19005},
    {0.2511, 0.0739, 1.5281, 1.17514}, {0.19536, 0.09098, 1.28764, 1.16024},
    {0.1421, 0.1126, 1.0419, 1.16561}, {0.09564, 0.13902, 0.81295, 1.17097},
    {0.05795, 0.1693, 0.6162, 1.13505}, {0.03201, 0.20802, 0.46518, 1.09913},
    {0.0147, 0.2586, 0.3533, 1.10187}, {0.0049, 0.323, 0.272, 1.10461}, {0.0024, 0.4073, 0.2123, 1.09678},
    {0.0093, 0.503, 0.1582, 1.08894}, {0.0291, 0.6082, 0.1117, 1.07373}, {0.06327, 0.71, 0.07825, 1.05851},
    {0.1096, 0.7932, 0.05725, 1.07315}, {0.1655, 0.862, 0.04216, 1.0878},
    {0.22575, 0.91485, 0.02984, 1.07121}, {0.2904, 0.954, 0.0203, 1.05462},
    {0.3597, 0.9803, 0.0134, 1.0528}, {0.43345, 0.99495, 0.00875, 1.051}, {0.51205, 1, 0.00575, 1.03056},
    {0.5945, 0.995, 0.0039, 1.01013}, {0.6784, 0.9786, 0.00275, 0.991613},
    {0.7621, 0.952, 0.0021, 0.973098}, {0.8425, 0.9154, 0.0018, 0.970339},
    {0.9163, 0.87, 0.00165, 0.967581}, {0.9786, 0.8163, 0.0014, 0.931709},
    {1.0263, 0.757, 0.0011, 0.895837}, {1.0567, 0.6949, 0.001, 0.902507}, {1.0622, 0.631, 0.0008, 0.909177},
    {1.0456, 0.5668, 0.0006, 0.907121}, {1.0026, 0.503, 0.00034, 0.905065},
    {0.9384, 0.4412, 0.00024, 0.895467}, {0.85445, 0.381, 0.00019, 0.885868},
    {0.7514, 0.321, 0.0001, 0.863594}, {0.6424, 0.265, 5e-05, 0.841321}, {0.5419, 0.217, 3e-05, 0.843395},
    {0.4479, 0.175, 2e-05, 0.845469}, {0.3608, 0.1382, 1e-05, 0.826921}, {0.2835, 0.107, 0, 0.808373},
    {0.2187, 0.0816, 0, 0.809321}, {0.1649, 0.061, 0, 0.81027}, {0.1212, 0.04458, 0, 0.82069},
    {0.0874, 0.032, 0, 0.831111}, {0.0636, 0.0232, 0, 0.81094}, {0.04677, 0.017, 0, 0.79077},
    {0.0329, 0.01192, 0, 0.747521}, {0.0227, 0.00821, 0, 0.704274}, {0.01584, 0.005723, 0, 0.713808},
    {0.0113592, 0.004102, 0, 0.723343}, {0.00811092, 0.002929, 0, 0.737181},
    {0.00579035, 0.002091, 0, 0.75102}, {0.00410946, 0.001484, 0, 0.686649},
    {0.00289933, 0.001047, 0, 0.622279}, {0.00204919, 0.00074, 0, 0.664106},
    {0.00143997, 0.00052, 0, 0.705934}, {0.000999949, 0.0003611, 0, 0.732204},
    {0.000690079, 0.0002492, 0, 0.758474}, {0.000476021, 0.0001719, 0, 0.70042},
    {0.000332301, 0.00012, 0, 0.642367}, {0.000234826, 8.48e-05, 0, 0.555625},
    {0.00016615, 6e-05, 0, 0.468883}, {0.000117413, 4.24e-05, 0, 0.571851},
    {8.30753e-05, 3e-05, 0, 0.67482}, {5.87065e-05, 2.12e-05, 0, 0.657533},
    {4.15099e-05, 1.499e-05, 0, 0.640247}, {2.93533e-05, 1.06e-05, 0, 0.6449},
    {2.06738e-05, 7.4657e-06, 0, 0.649552}, {1.45598e-05, 5.2578e-06, 0, 0.625046},
    {1.0254e-05, 3.7029e-06, 0, 0.60054}, {7.22146e-06, 2.6078e-06, 0, 0.562696},
    {5.08587e-06, 1.8366e-06, 0, 0.524852}, {3.58165e-06, 1.2934e-06, 0, 0.552538},
    {2.52252e-06, 9.1093e-07, 0, 0.580223}, {1.77651e-06, 6.4153e-07, 0, 0.594728},
    {1.25114e-06, 4.5181e-07, 0, 0.609233},
};
// clang-format on
constexpr int n_cie_rows = int(std::size(cie_table));
static_assert(first_nm + (n_cie_rows - 1) * step_nm == last_nm);

constexpr double observer_integral_nm = 106.75026;  // of y over the table's range

CieRow observer(double nm) {
    const double position = (nm - first_nm) / step_nm;
    const int row = std::clamp(int(position), 0, n_cie_rows - 2);
    const double t = position - row;
    const CieRow& a = cie_table[row];
    const CieRow& b = cie_table[row + 1];
    return {std::lerp(a.x, b.x, t), std::lerp(a.y, b.y, t), std::lerp(a.z, b.z, t), std::lerp(a.d65, b.d65, t)};
}

double sample_at(const SampledSpectrum& samples, double nm) {
    if (nm < samples.front().first || nm > samples.back().first) return 0;
    const auto above = std::upper_bound(samples.begin(), samples.end(), nm,
                                        [](double l, const auto& sample) { return l < sample.first; });
    if (above == samples.end()) return samples.back().second;
    const auto below = above - 1;
    return std::lerp(below->second, above->second, (nm - below->first) / (above->first - below->first));
}

/// Converts XYZ to linear sRGB (Rec. 709 primaries, white D65).
std::array<double, 3> rgb_from_xyz(const std::array<double, 3>& xyz) {
    constexpr double m[3][3] = {
        {3.240479, -1.537150, -0.498535}, {-0.969256, 1.875991, 0.041556}, {0.055648, -0.204043, 1.057311}};
    std::array<double, 3> rgb{};
    for (std::size_t i = 0; i < 3; ++i) rgb[i] = m[i][0] * xyz[0] + m[i][1] * xyz[1] + m[i][2] * xyz[2];
    return rgb;
}

}  // namespace

Spectrum rgb_from_spectrum(const SampledSpectrum& samples, SpectrumUse use) {
    constexpr int n_steps = 1000;
    std::array<double, 3> xyz{};
    for (int i = 0; i < n_steps; ++i) {
        const double nm = std::lerp(first_nm, last_nm, i / double(n_steps - 1));
        const CieRow cie = observer(nm);
        const double value = sample_at(samples, nm) * (use == SpectrumUse::emission ? 1.0 : cie.d65);
        xyz[0] += value * cie.x;
        xyz[1] += value * cie.y;
        xyz[2] += value * cie.z;
    }
    for (double& c : xyz) c *= (last_nm - first_nm) / (n_steps * observer_integral_nm);
    Spectrum rgb;
    const std::array<double, 3> linear = rgb_from_xyz(xyz);
    for (int i = 0; i < 3; ++i) {
        const double c = linear[std::size_t(i)];
        rgb[i] = float(use == SpectrumUse::index      ? c
                       : use == SpectrumUse::emission ? std::max(c, 0.0)
                                                      : std::clamp(c, 0.0, 1.0));
    }
    return rgb;
}

Spectrum rgb_from_constant_spectrum(float value, SpectrumUse use) {
    if (use != SpectrumUse::emission) return Spectrum(value);
    const std::array<double, 3> white = rgb_from_xyz({1, 1, 1});
    return Spectrum(float(white[0]), float(white[1]), float(white[2])) * value;
}

float linear_from_srgb(float encoded) {
    if (encoded <= 0.04045f) return encoded / 12.92f;
    return float(std::pow((double(encoded) + 0.055) / 1.055, 2.4));
}

}  // namespace loom
