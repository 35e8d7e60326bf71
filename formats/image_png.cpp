#include <fmt/format.h>
#include <png.h>

#include <algorithm>
#include <cmath>
#include <stdexcept>

#include "formats/image.h"

namespace loom {
double srgb_from_linear(double linear) {
    const double x = std::clamp(linear, 0.0, 1.0);
    return x <= 0.0031308 ? 12.92 * x : 1.055 * std::pow(x, 1.0 / 2.4) - 0.055;
}

std::size_t write_png(const Image& image, const std::filesystem::path& path, double exposure_ev, Sync sync) {
    const std::vector<float> rgb = image.interleaved("");
    const double gain = std::exp2(exposure_ev);
    std::vector<std::uint8_t> bytes(rgb.size());
    std::size_t n_bad = 0;
    for (std::size_t i = 0; i < rgb.size(); i += 3) {
        bool finite = true;
        for (std::size_t c = 0; c < 3; ++c) {
            finite = finite && std::isfinite(rgb[i + c]);
            bytes[i + c] = std::isnan(rgb[i + c])
                               ? 0
                               : static_cast<std::uint8_t>(std::lround(255.0 * srgb_from_linear(gain * rgb[i + c])));
        }
        n_bad += finite ? 0 : 1;
    }
    OutputFile output(path);
    png_image png{};
    png.version = PNG_IMAGE_VERSION;
    png.width = image.width;
    png.height = image.height;
    png.format = PNG_FORMAT_RGB;  // 8 bits, marked as sRGB
    OutputStream stream(output);
    if (png_image_write_to_stdio(&png, stream.get(), 0, bytes.data(), 0, nullptr) == 0)
        throw std::runtime_error(fmt::format("{}: cannot write: {}", path.native(), png.message));
    stream.close();
    output.commit(sync);
    return n_bad;
}

}  // namespace loom
