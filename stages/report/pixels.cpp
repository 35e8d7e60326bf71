#include "stages/report/pixels.h"

#include <algorithm>
#include <cmath>
#include <vector>

#include "formats/io/half.h"
#include "stages/report/html.h"

namespace loom::report {

Pixels pixels_of(const Image& image, std::size_t longest_side) {
    constexpr double largest = 65504;
    const std::size_t w = image.width, h = image.height;
    Pixels pixels;
    pixels.factor = (std::max(w, h) + longest_side - 1) / longest_side;
    pixels.width = (w + pixels.factor - 1) / pixels.factor;
    pixels.height = (h + pixels.factor - 1) / pixels.factor;
    const std::vector<float> rgb = image.interleaved("");
    std::vector<std::uint8_t> bytes;
    bytes.reserve(6 * pixels.width * pixels.height);
    for (std::size_t y = 0; y < pixels.height; ++y) {
        for (std::size_t x = 0; x < pixels.width; ++x) {
            // Cells at the right and lower edge may be smaller.
            const std::size_t x1 = std::min(w, (x + 1) * pixels.factor), y1 = std::min(h, (y + 1) * pixels.factor);
            for (std::size_t c = 0; c < 3; ++c) {
                double sum = 0, n = 0;
                for (std::size_t v = y * pixels.factor; v < y1; ++v)
                    for (std::size_t u = x * pixels.factor; u < x1; ++u) sum += double(rgb[3 * (v * w + u) + c]), ++n;
                const double mean = sum / n;
                if (std::abs(mean) > largest) ++pixels.n_clipped;
                const double held = std::isnan(mean) ? mean : std::clamp(mean, -largest, largest);
                const std::uint16_t bits = half_from_float(float(held)).bits;
                bytes.push_back(std::uint8_t(bits & 0xff));
                bytes.push_back(std::uint8_t(bits >> 8));
            }
        }
    }
    pixels.data = base64(bytes);
    return pixels;
}

}  // namespace loom::report
