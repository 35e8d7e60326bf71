#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <set>

#include "formats/io/error.h"
#include "stages/core/math/vector.h"
#include "stages/frames/frames.h"

namespace loom::frames {
namespace {

/// Number of bytes of the UTF-8 character at text[i]; 0: none that is valid.
std::size_t utf8_length(const std::string& text, std::size_t i) {
    const auto byte = [&](std::size_t at) { return at < text.size() ? static_cast<unsigned char>(text[at]) : 0u; };
    const auto follows = [&](std::size_t at) { return (byte(at) & 0xc0) == 0x80; };
    const unsigned first = byte(i), second = byte(i + 1);
    if (first < 0x80) return 1;
    if (first >= 0xc2 && first < 0xe0) return follows(i + 1) ? 2 : 0;
    if (first >= 0xe0 && first < 0xf0) {
        const bool overlong = first == 0xe0 && second < 0xa0, surrogate = first == 0xed && second >= 0xa0;
        return follows(i + 1) && follows(i + 2) && !overlong && !surrogate ? 3 : 0;
    }
    if (first >= 0xf0 && first < 0xf5) {
        const bool overlong = first == 0xf0 && second < 0x90, beyond = first == 0xf4 && second >= 0x90;
        return follows(i + 1) && follows(i + 2) && follows(i + 3) && !overlong && !beyond ? 4 : 0;
    }
    return 0;
}

}  // namespace

double quantile_of(std::vector<float>& values, double share) {
    if (values.empty()) return 0;
    const auto at = values.begin() + std::ptrdiff_t(share * double(values.size() - 1));
    std::nth_element(values.begin(), at, values.end());
    return double(*at);
}

DerivativeView derivative_view(const TransientCube& cube, std::size_t parameter_idx) {
    const std::size_t pixels = 3 * cube.n_pixels(), bins = pixels * cube.time.n_bins;
    DerivativeView view;
    view.values = std::span<const float>(cube.derivative.bins.data() + parameter_idx * bins, bins);
    view.var_mean = std::span<const float>(cube.derivative.var_mean.data() + parameter_idx * bins, bins);
    view.steady = std::span<const float>(cube.derivative.steady.data() + parameter_idx * pixels, pixels);
    view.name = label_of(cube.parameters.name[parameter_idx]);
    view.unit = label_of(cube.parameters.unit[parameter_idx]);
    return view;
}

void require_derivatives(const TransientCube& cube, const std::string& file) {
    if (cube.n_parameters() == 0)
        throw InputError(
            fmt::format("{}: has no derivatives; loom-derive and loom-transient --derivative make them", file));
}

std::size_t parameter_of(const TransientCube& cube, const std::string& name, const std::string& file) {
    require_derivatives(cube, file);
    const auto& names = cube.parameters.name;
    const auto found = std::find(names.begin(), names.end(), name);
    if (found == names.end()) {
        std::string all;
        for (std::size_t i = 0; i < std::min<std::size_t>(names.size(), 20); ++i)
            all += (i == 0 ? "" : ", ") + label_of(names[i], 80);
        throw InputError(fmt::format("--parameter {}: {} has {}{}", name, file, all, names.size() > 20 ? ", ..." : ""));
    }
    return std::size_t(found - names.begin());
}

std::vector<std::string> derivative_folders(const std::vector<std::string>& names) {
    std::vector<std::string> folders;
    std::set<std::string> taken;
    for (const std::string& name : names) {
        std::string safe = "derivative-";
        for (const char c : name.substr(0, 80)) {
            const bool plain = (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9');
            safe += plain || c == '-' || c == '_' || c == '.' ? c : '_';
        }
        std::string folder = safe;
        for (int n = 2; !taken.insert(folder).second; ++n) folder = fmt::format("{}-{}", safe, n);
        folders.push_back(folder);
    }
    return folders;
}

std::string label_of(const std::string& text, std::size_t longest) {
    std::string label;
    std::size_t n_characters = 0;
    for (std::size_t i = 0; i < text.size();) {
        if (++n_characters > longest) return label + "…";
        const std::size_t length = utf8_length(text, i);
        const auto c = static_cast<unsigned char>(text[i]);
        const bool control = c < 0x20 || c == 0x7f || (c == 0xc2 && static_cast<unsigned char>(text[i + 1]) < 0xa0);
        label += length == 0 || control ? "?" : text.substr(i, length);
        i += std::max<std::size_t>(length, 1);
    }
    return label;
}

double luminance_of(std::span<const float> values, std::size_t n_bins, std::size_t pixel, std::size_t bin) {
    const float* rgb = values.data() + 3 * (pixel * n_bins + bin);
    return luminance(Rgb<double>(rgb[0], rgb[1], rgb[2]));
}

double luminance_of(const TransientCube& cube, std::size_t pixel, std::size_t bin) {
    return luminance_of(std::span<const float>(cube.radiance.data(), cube.radiance.size()), cube.time.n_bins, pixel,
                        bin);
}

double time_of(const TransientCube& cube, double bin) {
    return cube.in_unit(cube.time.start_opl + bin * cube.time.bin_width_opl + cube.time.gate_opl / 2);
}

std::string time_unit(const TransientCubeHeader& header) {
    return header.time.unit == "ns" ? "ns" : header.time.metres_per_unit == 1 ? "m" : "units of the scene";
}

std::string time_words(const TransientCubeHeader& header) {
    return (header.time.unit == "ns" ? "time of flight (" : "optical path length (") + time_unit(header) + ")";
}

double luminance_quantile(const TransientCube& cube, double share) {
    std::vector<float> lit;
    for (std::size_t pixel = 0; pixel < cube.n_pixels(); ++pixel)
        for (std::size_t bin = 0; bin < cube.time.n_bins; ++bin)
            if (const double Y = luminance_of(cube, pixel, bin); Y > 0 && std::isfinite(Y)) lit.push_back(float(Y));
    return quantile_of(lit, share);
}

double derivative_quantile(const TransientCube& cube, const DerivativeView& derivative, double share) {
    std::vector<float> sizes;
    for (std::size_t pixel = 0; pixel < cube.n_pixels(); ++pixel)
        for (std::size_t bin = 0; bin < cube.time.n_bins; ++bin)
            if (const double d = std::abs(luminance_of(derivative.values, cube.time.n_bins, pixel, bin));
                d > 0 && std::isfinite(d))
                sizes.push_back(float(d));
    return quantile_of(sizes, share);
}

std::vector<float> peak_times(const TransientCube& cube) {
    const std::size_t n = cube.n_pixels(), bins = cube.time.n_bins;
    std::vector<float> times(n, std::numeric_limits<float>::quiet_NaN());
    std::vector<double> sums(n);
    constexpr std::array<double, 5> weights{1, 4, 6, 4, 1};
    for (std::size_t pixel = 0; pixel < n; ++pixel) {
        double most = 0;
        for (std::size_t bin = 0; bin < bins; ++bin) {
            sums[pixel] += luminance_of(cube, pixel, bin);
            double smooth = 0;
            for (std::size_t k = 0; k < weights.size(); ++k)
                if (bin + k >= 2 && bin + k < bins + 2) smooth += weights[k] * luminance_of(cube, pixel, bin + k - 2);
            if (smooth > most) {
                most = smooth;
                times[pixel] = float(time_of(cube, double(bin)));
            }
        }
    }
    std::vector<double> lit;
    for (double sum : sums)
        if (sum > 0) lit.push_back(sum);
    if (lit.empty()) return times;
    const auto median = lit.begin() + std::ptrdiff_t(lit.size() / 2);
    std::nth_element(lit.begin(), median, lit.end());
    for (std::size_t pixel = 0; pixel < n; ++pixel)
        if (!(sums[pixel] > 0.01 * *median)) times[pixel] = std::numeric_limits<float>::quiet_NaN();
    return times;
}

std::vector<std::size_t> strip_bins(const TransientCube& cube, std::size_t count) {
    const std::size_t bins = cube.time.n_bins;
    std::vector<double> light(bins);
    for (std::size_t pixel = 0; pixel < cube.n_pixels(); ++pixel) {
        double sum = 0;
        for (std::size_t bin = 0; bin < bins; ++bin) sum += luminance_of(cube, pixel, bin);
        if (!(sum > 0) || !std::isfinite(sum)) continue;
        for (std::size_t bin = 0; bin < bins; ++bin) light[bin] += luminance_of(cube, pixel, bin) / sum;
    }
    double all = 0;
    for (double l : light) all += l;
    std::size_t first = 0, last = bins - 1;
    double seen = 0;
    for (std::size_t bin = 0; bin < bins && all > 0; ++bin) {
        if (seen < 0.005 * all) first = bin;
        if (seen < 0.9 * all) last = bin;
        seen += light[bin];
    }
    count = std::clamp<std::size_t>(count, 1, last - first + 1);
    std::vector<std::size_t> chosen;
    for (std::size_t i = 0; i < count; ++i)
        chosen.push_back(first + (count == 1 ? 0 : (i * (last - first) + (count - 1) / 2) / (count - 1)));
    return chosen;
}

}  // namespace loom::frames
