#include "stages/core/plot/false_colours.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <string>
#include <vector>

namespace loom {
namespace {

using Colour = std::array<float, 3>;  // linear RGB

/// A character of the legend, 5 x 7 dots, one row per byte, leftmost dot in bit 4.
struct Glyph {
    char character;
    std::array<std::uint8_t, 7> rows;
};
constexpr std::array<Glyph, 14> glyphs{{
    {'0', {0x0e, 0x11, 0x13, 0x15, 0x19, 0x11, 0x0e}},
    {'1', {0x04, 0x0c, 0x04, 0x04, 0x04, 0x04, 0x0e}},
    {'2', {0x0e, 0x11, 0x01, 0x02, 0x04, 0x08, 0x1f}},
    {'3', {0x0e, 0x11, 0x01, 0x06, 0x01, 0x11, 0x0e}},
    {'4', {0x02, 0x06, 0x0a, 0x12, 0x1f, 0x02, 0x02}},
    {'5', {0x1f, 0x10, 0x1e, 0x01, 0x01, 0x11, 0x0e}},
    {'6', {0x06, 0x08, 0x10, 0x1e, 0x11, 0x11, 0x0e}},
    {'7', {0x1f, 0x01, 0x02, 0x04, 0x08, 0x08, 0x08}},
    {'8', {0x0e, 0x11, 0x11, 0x0e, 0x11, 0x11, 0x0e}},
    {'9', {0x0e, 0x11, 0x11, 0x0f, 0x01, 0x02, 0x0c}},
    {'.', {0x00, 0x00, 0x00, 0x00, 0x00, 0x0c, 0x0c}},
    {'-', {0x00, 0x00, 0x00, 0x0e, 0x00, 0x00, 0x00}},
    {'+', {0x00, 0x04, 0x04, 0x1f, 0x04, 0x04, 0x00}},
    {'e', {0x00, 0x00, 0x0e, 0x11, 0x1f, 0x10, 0x0e}},
}};
constexpr std::size_t glyph_width = 6, glyph_height = 7;  // one dot of space to the right

/// An image to draw on, initially white.
class Canvas {
  public:
    Canvas(std::size_t width, std::size_t height) : width_(width), rgb_(3 * width * height, 1.0f) {}
    void set(std::size_t x, std::size_t y, const Colour& colour) {
        for (std::size_t c = 0; c < 3; ++c) rgb_[3 * (y * width_ + x) + c] = colour[c];
    }
    void text(std::size_t x, std::size_t y, std::string_view word) {
        for (char character : word) {
            const auto glyph =
                std::find_if(glyphs.begin(), glyphs.end(), [&](const Glyph& g) { return g.character == character; });
            for (std::size_t row = 0; row < glyph_height; ++row)
                for (std::size_t dot = 0; dot + 1 < glyph_width; ++dot)
                    if (glyph->rows[row] >> (4 - dot) & 1) set(x + dot, y + row, {0, 0, 0});
            x += glyph_width;
        }
    }
    Image finish(std::size_t height) const {
        Image image;
        image.width = std::uint32_t(width_);
        image.height = std::uint32_t(height);
        image.set_layer("", "RGB", rgb_);
        return image;
    }

  private:
    std::size_t width_;
    std::vector<float> rgb_;
};

double percentile_99(const std::vector<double>& values) {
    std::vector<double> sizes;
    for (double value : values)
        if (std::isfinite(value)) sizes.push_back(std::abs(value));
    if (sizes.empty()) return 0;
    const auto at = sizes.begin() + std::ptrdiff_t(0.99 * double(sizes.size() - 1));
    std::nth_element(sizes.begin(), at, sizes.end());
    return *at;
}

}  // namespace

Colour signed_colour(double t) {
    if (std::isnan(t)) return {0, 0, 0};
    // Linear values of dark blue, light blue, white, orange and dark red.
    constexpr std::array<std::array<double, 3>, 5> stops{
        {{0.005, 0.03, 0.22}, {0.12, 0.38, 0.72}, {1, 1, 1}, {0.90, 0.29, 0.10}, {0.24, 0.005, 0.015}}};
    const double at = 2 * std::clamp(t, -1.0, 1.0) + 2;
    const std::size_t k = std::min<std::size_t>(3, std::size_t(at));
    const double f = at - double(k);
    Colour colour;
    for (std::size_t c = 0; c < 3; ++c) colour[c] = float((1 - f) * stops[k][c] + f * stops[k + 1][c]);
    return colour;
}

Image false_colours(const Image& image, std::string_view layer, double reach) {
    const std::vector<float> rgb = image.interleaved(layer);
    std::vector<double> values(image.n_pixels());
    for (std::size_t i = 0; i < values.size(); ++i)
        values[i] = double(0.212671f * rgb[3 * i] + 0.715160f * rgb[3 * i + 1] + 0.072169f * rgb[3 * i + 2]);
    if (reach <= 0) reach = std::stod(fmt::format("{:.1e}", percentile_99(values)));
    if (reach <= 0) reach = 1;  // all differences are zero

    constexpr std::size_t least_width = 240, bar_height = 10, margin = 4;
    const std::size_t zoom = (least_width + image.width - 1) / image.width;
    const std::size_t width = zoom * image.width, picture_height = zoom * image.height;
    const std::size_t height = picture_height + margin + bar_height + margin + glyph_height + margin;
    Canvas canvas(width, height);
    for (std::size_t y = 0; y < picture_height; ++y)
        for (std::size_t x = 0; x < width; ++x)
            canvas.set(x, y, signed_colour(values[y / zoom * image.width + x / zoom] / reach));
    for (std::size_t x = margin; x < width - margin; ++x) {
        const double t = 2 * double(x - margin) / double(width - 2 * margin - 1) - 1;
        for (std::size_t y = 0; y < bar_height; ++y) canvas.set(x, picture_height + margin + y, signed_colour(t));
    }
    const std::size_t line = picture_height + margin + bar_height + margin;
    const std::string low = fmt::format("{:.2g}", -reach), high = fmt::format("+{:.2g}", reach);
    canvas.text(margin, line, low);
    canvas.text((width - glyph_width) / 2, line, "0");
    canvas.text(width - margin - high.size() * glyph_width, line, high);
    return canvas.finish(height);
}

}  // namespace loom
