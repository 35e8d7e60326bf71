#include "stages/core/assets/texture.h"

#include <cmath>

#include "formats/io/error.h"
#include "stages/core/description/description.h"

namespace loom {
namespace {

constexpr float below_one = 0x1.fffffep-1f;

/// Maps a coordinate to the range of wrapped(): [0, 1], or [0, 2) for mirror. Non-finite values become 0, so that no
/// pixel outside the image is ever read.
float folded(float u, WrapMode mode) {
    if (mode == WrapMode::clamp) return u > 0 ? std::min(u, 1.0f) : 0.0f;
    const float period = mode == WrapMode::mirror ? 2.0f : 1.0f, inverse = mode == WrapMode::mirror ? 0.5f : 1.0f;
    const float t = u - period * std::floor(u * inverse);
    return t >= 0 ? std::min(t, period * below_one) : 0.0f;
}

/// Returns the pixel index of i in [-1, n] (mirror: [-1, 2 n]).
int wrapped(int i, int n, WrapMode mode) {
    switch (mode) {
        case WrapMode::repeat:
            return i < 0 ? n - 1 : i >= n ? 0 : i;
        case WrapMode::clamp:
            return i < 0 ? 0 : i >= n ? n - 1 : i;
        case WrapMode::mirror:
            if (i < 0) i = -1 - i;
            if (i >= n) i = 2 * n - 1 - i;
            return i < 0 ? 0 : i;
    }
    return 0;
}

/// The four pixels around a point and its position between them.
struct Footprint {
    std::size_t p00, p10, p01, p11;
    float x, y;
};

Footprint footprint(const TextureImage& image, Point2f uv, WrapMode mode) {
    const float px = folded(uv.x, mode) * float(image.width) - 0.5f;
    const float py = folded(uv.y, mode) * float(image.height) - 0.5f;
    const float fx = std::floor(px), fy = std::floor(py);
    const int ix = int(fx), iy = int(fy);
    const auto x0 = std::size_t(wrapped(ix, image.width, mode)), x1 = std::size_t(wrapped(ix + 1, image.width, mode));
    const std::size_t row0 = std::size_t(wrapped(iy, image.height, mode)) * std::size_t(image.width);
    const std::size_t row1 = std::size_t(wrapped(iy + 1, image.height, mode)) * std::size_t(image.width);
    return {row0 + x0, row0 + x1, row1 + x0, row1 + x1, px - fx, py - fy};
}

std::size_t nearest_pixel(const TextureImage& image, Point2f uv, WrapMode mode) {
    const int x = wrapped(int(folded(uv.x, mode) * float(image.width)), image.width, mode);
    const int y = wrapped(int(folded(uv.y, mode) * float(image.height)), image.height, mode);
    return std::size_t(y) * std::size_t(image.width) + std::size_t(x);
}

/// Calls use(fetch) with the function pixel -> value (float for grey, Spectrum for colour), so that the layout is
/// chosen once per look-up.
template <class Use>
auto with_pixels(const TextureImage& image, const Use& use) {
    const float* decode = image.decode.data();
    if (!image.bytes.empty()) {
        const std::uint8_t* bytes = image.bytes.data();
        if (image.grey) return use([=](std::size_t p) { return decode[bytes[p]]; });
        return use([=](std::size_t p) {
            const std::uint8_t* b = bytes + 4 * p;
            return Spectrum(decode[b[0]], decode[b[1]], decode[b[2]]);
        });
    }
    const float* floats = image.floats.data();
    if (image.grey) return use([=](std::size_t p) { return floats[p]; });
    return use([=](std::size_t p) { return Spectrum(floats[3 * p], floats[3 * p + 1], floats[3 * p + 2]); });
}

Spectrum as_spectrum(float v) {
    return Spectrum(v);
}
Spectrum as_spectrum(const Spectrum& v) {
    return v;
}
float as_float(float v) {
    return v;
}
/// Returns the luminance; exact for grey.
float as_grey(const Spectrum& v) {
    return v.r == v.g && v.g == v.b ? v.r : luminance(v);
}
float as_float(const Spectrum& v) {
    return luminance(v);
}

template <class Result, class Convert>
Result look_up(const Texture& texture, Point2f uv, const Convert& convert) {
    const TextureImage& image = *texture.image;
    return with_pixels(image, [&](const auto& fetch) -> Result {
        if (texture.nearest) return convert(fetch(nearest_pixel(image, uv, texture.wrap)));
        const Footprint f = footprint(image, uv, texture.wrap);
        const float w11 = f.x * f.y, w10 = f.x - w11, w01 = f.y - w11, w00 = 1.0f - f.x - w01;
        return convert(fetch(f.p00) * w00 + fetch(f.p10) * w10 + fetch(f.p01) * w01 + fetch(f.p11) * w11);
    });
}

Point2f transformed(const std::array<float, 6>& m, Point2f uv) {
    return {m[0] * uv.x + m[1] * uv.y + m[2], m[3] * uv.x + m[4] * uv.y + m[5]};
}

const Spectrum& checker(const Texture& texture, Point2f uv, bool swapped = false) {
    const bool right = uv.x - std::floor(uv.x) > 0.5f, low = uv.y - std::floor(uv.y) > 0.5f;
    return (right == low) != swapped ? texture.color0 : texture.color1;
}

}  // namespace

Spectrum Texture::eval(Point2f uv) const {
    uv = transformed(to_uv, uv);
    if (kind == TextureKind::constant) return color0;
    if (kind == TextureKind::checkerboard) return checker(*this, uv);
    return look_up<Spectrum>(*this, uv, [](const auto& v) { return as_spectrum(v); });
}

Texture::Texels Texture::texels(Point2f uv) const {
    uv = transformed(to_uv, uv);
    if (nearest) return {{nearest_pixel(*image, uv, wrap)}, {1}};
    const Footprint f = footprint(*image, uv, wrap);
    const float w11 = f.x * f.y, w10 = f.x - w11, w01 = f.y - w11, w00 = 1.0f - f.x - w01;
    return {{f.p00, f.p10, f.p01, f.p11}, {w00, w10, w01, w11}};
}

void Texture::prefetch(Point2f uv) const {
    if (kind != TextureKind::bitmap) return;
    const Footprint f = footprint(*image, transformed(to_uv, uv), wrap);
    const auto ask = [&](const auto* pixels, std::size_t width) {
        __builtin_prefetch(pixels + width * f.p00);
        __builtin_prefetch(pixels + width * f.p01);
    };
    if (!image->bytes.empty())
        ask(image->bytes.data(), image->grey ? 1 : 4);
    else
        ask(image->floats.data(), image->grey ? 1 : 3);
}

float Texture::eval_float(Point2f uv) const {
    uv = transformed(to_uv, uv);
    if (kind == TextureKind::constant) return as_grey(color0);
    if (kind == TextureKind::checkerboard) return luminance(checker(*this, uv, swaps_numbers));
    return look_up<float>(*this, uv, [](const auto& v) { return as_float(v); });
}

namespace {

/// Computes the derivatives of the bilinear interpolant with respect to (u, v).
/// in:      convert  from a pixel to the value
template <class Value, class Convert>
std::pair<Value, Value> gradient(const Texture& texture, Point2f uv, const Convert& convert) {
    if (texture.kind != TextureKind::bitmap || texture.nearest) return {};
    const auto& m = texture.to_uv;
    const TextureImage& image = *texture.image;
    const Footprint f = footprint(image, transformed(m, uv), texture.wrap);
    return with_pixels(image, [&](const auto& fetch) -> std::pair<Value, Value> {
        const Value f00 = convert(fetch(f.p00)), f10 = convert(fetch(f.p10));
        const Value f01 = convert(fetch(f.p01)), f11 = convert(fetch(f.p11));
        const Value du = lerp(f.y, f10 - f00, f11 - f01) * float(image.width);
        const Value dv = lerp(f.x, f01 - f00, f11 - f10) * float(image.height);
        return {m[0] * du + m[3] * dv, m[1] * du + m[4] * dv};
    });
}

}  // namespace

Texture::ColourGradient Texture::eval_colour_gradient(Point2f uv) const {
    const auto [by_u, by_v] = gradient<Spectrum>(*this, uv, [](const auto& v) { return as_spectrum(v); });
    return {by_u, by_v};
}

Point2f Texture::eval_gradient(Point2f uv) const {
    const auto [by_u, by_v] = gradient<float>(*this, uv, [](const auto& v) { return as_float(v); });
    return {by_u, by_v};
}

/// Calls use(value, grey) for every value that the texture is interpolated between.
template <class Use>
void for_each_value(const Texture& texture, const Use& use) {
    if (texture.kind == TextureKind::bitmap) {
        const TextureImage& image = *texture.image;
        for (int y = 0; y < image.height; ++y)
            for (int x = 0; x < image.width; ++x) use(image.texel(x, y), image.grey);
        return;
    }
    use(texture.color0, false);
    if (texture.kind == TextureKind::checkerboard) use(texture.color1, false);
}

Spectrum Texture::maximum() const {
    Spectrum most(0);
    for_each_value(*this, [&](const Spectrum& v, bool) {
        for (int c = 0; c < 3; ++c) most[c] = std::max(most[c], v[c]);
    });
    return most;
}

std::pair<float, float> Texture::float_range() const {
    std::pair<float, float> range{INFINITY, -INFINITY};
    for_each_value(*this, [&](const Spectrum& v, bool grey) {
        const float value = grey ? v.r : as_grey(v);
        range = {std::min(range.first, value), std::max(range.second, value)};
    });
    return range;
}

Spectrum Texture::mean() const {
    if (kind == TextureKind::constant) return color0;
    return kind == TextureKind::checkerboard ? (color0 + color1) * 0.5f : image->mean;
}

Decode decode_of(const Object& o) {
    return {o.get_bool("raw", false), o.get_float("gamma", 0.0f)};
}

std::shared_ptr<const TextureImage> image_of(const Object& object, Decode decode, TextureCache& cache) {
    try {
        return cache.image(object.get_path("filename"), decode);
    } catch (const InputError& error) {
        object.fail("filename", error.what());
    }
}

Texture make_texture(const Object& o, TextureCache& cache) {
    Texture texture;
    texture.id = o.id;
    const Matrix4d m = o.get_transform("to_uv");
    // The third coordinate of the scene file's transform has no effect on (u, v).
    texture.to_uv = {float(m(0, 0)), float(m(0, 1)), float(m(0, 3)), float(m(1, 0)), float(m(1, 1)), float(m(1, 3))};
    if (o.plugin == "checkerboard") {
        texture.kind = TextureKind::checkerboard;
        texture.color0 = o.get_rgb("color0", texture.color0);
        texture.color1 = o.get_rgb("color1", texture.color1);
        texture.swaps_numbers = !o.legacy;
        return texture;
    }
    if (o.plugin == "rawconstant") {
        texture.kind = TextureKind::constant;
        texture.color0 = o.get_rgb("value");
        return texture;
    }
    const std::string wrap = o.get_string("wrap_mode", "repeat");
    texture.wrap = wrap == "mirror" ? WrapMode::mirror : wrap == "clamp" ? WrapMode::clamp : WrapMode::repeat;
    texture.nearest = o.get_string("filter_type", "bilinear") == "nearest";
    texture.image = image_of(o, decode_of(o), cache);
    return texture;
}

}  // namespace loom
