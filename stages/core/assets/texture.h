#pragma once
#include <array>
#include <cstdint>
#include <filesystem>
#include <map>
#include <memory>
#include <mutex>
#include <string>
#include <utility>
#include <vector>

#include "stages/core/math/dual.h"
#include "stages/core/math/vector.h"

namespace loom {

class Object;

/// Conversion from the numbers of an image file to linear values.
struct Decode {
    bool raw = false;  // numbers are linear already
    float gamma = 0;   // 0: by type (integers: sRGB, floating point: linear); below 0: sRGB; else value^gamma
    bool operator<(const Decode& o) const { return std::pair(raw, gamma) < std::pair(o.raw, o.gamma); }
};

/// Pixels of an image file, row 0 on top, colour or grey, without alpha. Eight-bit files stay eight-bit and are decoded
/// through a table at look-up.
struct TextureImage {
    int width = 0, height = 0;
    bool grey = false;
    std::vector<std::uint8_t> bytes;  // 1 (grey) or 4 (red, green, blue, unused) per pixel
    std::vector<float> floats;        // 1 or 3 per pixel; one of the two arrays is empty
    std::array<float, 256> decode{};  // linear value of a byte

    Spectrum mean{0.0f};  // over all pixels
    std::string note;     // the parts of the file without effect; empty: none

    Spectrum texel(int x, int y) const;
};

enum class TextureKind : std::uint8_t { bitmap, checkerboard, constant };
enum class WrapMode : std::uint8_t { repeat, mirror, clamp };

/// A function of (u, v), evaluated in the tracer's inner loop: plain data, no virtual call. Conventions of Mitsuba 3: v
/// = 0 is the upper edge of an image, (0.5, 0.5) / size the centre of the first pixel.
struct Texture {
    TextureKind kind = TextureKind::bitmap;
    WrapMode wrap = WrapMode::repeat;
    bool nearest = false;
    std::array<float, 6> to_uv{1, 0, 0, 0, 1, 0};  // rows of the 2x3 matrix applied to (u, v, 1)
    std::shared_ptr<const TextureImage> image;     // bitmap
    Spectrum color0{0.4f}, color1{0.2f};           // checkerboard; color0: the constant
    bool swaps_numbers = false;                    // checkerboard: eval_float() has color1 where eval() has color0
    std::string id;

    Spectrum eval(Point2f uv) const;
    /// eval() with derivatives, by the chain rule, with respect to the parameters of uv.
    template <int N, class Real>
    Rgb<Dual<N, Real>> eval(const Point2<Dual<N, Real>>& uv) const;
    /// Prefetches the pixels that eval() reads.
    void prefetch(Point2f uv) const;
    /// Returns the luminance of a colour texture, the value of a grey one.
    ///                                             [Mitsuba 3.8, checkerboard: eval_1 swaps the colours]
    float eval_float(Point2f uv) const;
    /// d eval / d(u, v), defined as in eval_gradient().
    struct ColourGradient {
        Spectrum by_u, by_v;
    };
    ColourGradient eval_colour_gradient(Point2f uv) const;
    /// d eval_float / d(u, v) of the bilinear interpolant; 0 for `nearest`, checkerboard and constant.
    /// differs: Mitsuba 3.8 scales by the image size after a rotation in to_uv, this function before it
    Point2f eval_gradient(Point2f uv) const;
    /// The pixels that eval() reads and their weights: eval() is linear in them.
    struct Texels {
        std::array<std::size_t, 4> pixel{};  // row-major
        std::array<float, 4> weight{};
    };
    /// needs:   a bitmap
    Texels texels(Point2f uv) const;
    /// Returns the mean over the unit square of the untransformed texture.
    Spectrum mean() const;
    /// Return the largest value of each channel, and the smallest and largest value of eval_float(), over all (u, v).
    Spectrum maximum() const;
    std::pair<float, float> float_range() const;
};

template <int N, class Real>
Rgb<Dual<N, Real>> Texture::eval(const Point2<Dual<N, Real>>& uv) const {
    const Point2f at{float(uv.x.value), float(uv.y.value)};
    const Spectrum value = eval(at);
    const ColourGradient gradient = eval_colour_gradient(at);
    Rgb<Dual<N, Real>> result;
    for (int c = 0; c < 3; ++c)
        result[c] = Dual<N, Real>::chain(uv.x, uv.y, value[c], gradient.by_u[c], gradient.by_v[c]);
    return result;
}

/// Decodes each (file, decoding) once, however many textures use it. Safe from several threads.
class TextureCache {
  public:
    /// throws:  InputError naming the file: missing, not an image, empty, too large
    std::shared_ptr<const TextureImage> image(const std::filesystem::path& file, Decode decode);
    /// Returns the notes of the images, by file name. Must be called after all reading.
    std::vector<std::string> notes() const;

  private:
    struct Entry {
        std::once_flag once;
        std::shared_ptr<const TextureImage> image;
    };
    std::mutex mutex_;
    std::map<std::pair<std::string, Decode>, std::shared_ptr<Entry>> entries_;
};

/// Returns the decoding of a bitmap or an envmap: `raw`, and in 0.x files `gamma`.
Decode decode_of(const Object& description);

/// Returns the image of an object's `filename`.
/// throws:  InputError at that parameter
std::shared_ptr<const TextureImage> image_of(const Object& object, Decode decode, TextureCache& cache);

/// Makes the texture of a description.
Texture make_texture(const Object& description, TextureCache& cache);

}  // namespace loom
