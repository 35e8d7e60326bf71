#pragma once
// image: one picture with named layers, an OpenEXR file.
//
//   R, G, B                mean radiance                         W m^-2 sr^-1
//   VarMean.R/G/B          variance of that mean, per channel    (W m^-2 sr^-1)^2
//   Albedo.R/G/B           reflectance at the first hit          1
//   N.X/Y/Z                shading normal at the first hit       unit, world space
//   Depth.Z                distance of the first hit             m
//
//   Emitted.R/G/B          part that is seen directly            W m^-2 sr^-1
//   DirectOwn.R/G/B, DirectCluster.R/G/B
//   IndirectPath.R/G/B, IndirectOwn.R/G/B, IndirectCluster.R/G/B
//                          the other parts, each estimated by the pixel's own paths, by its own sample of refined
//                          light, and by the clusters of its vertices; to be blended   W m^-2 sr^-1
//
// Only the layers that a stage has are there, R, G, B always. Channels are float32 in memory and when
// written; row 0 is on top. The root attributes of all formats are text attributes of the header, `samples`
// (per pixel) too. Optional: `scene`, content hash and name of the scene that the picture shows (a residual shows
// none); `ledger`, what a sum of a picture and residuals consists of (formats/ledger.h).

#include <array>
#include <cstdint>
#include <filesystem>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "formats/io/field.h"
#include "formats/io/output_file.h"
#include "formats/io/provenance.h"
#include "formats/ledger.h"

namespace loom {

/// The layers that a blend is made of.
inline constexpr std::array<const char*, 6> estimate_layers{"Emitted",      "DirectOwn",   "DirectCluster",
                                                            "IndirectPath", "IndirectOwn", "IndirectCluster"};

struct Image {
    static constexpr FormatId format{"image", 1, 1};

    struct Channel {
        std::string name;           // "R", "Albedo.R", "VarMean.B", …
        std::vector<float> values;  // [y, x]
    };

    std::uint32_t width = 0, height = 0;
    std::uint64_t samples = 0;  // samples per pixel; 0: the file does not say
    std::vector<Channel> channels;
    Provenance provenance;
    InputId scene;                   // that it shows; no hash: the file does not say
    Ledger ledger;                   // of a sum, and of a residual; else empty
    std::string filetype = "image";  // empty for a picture of another program

    std::size_t n_pixels() const { return std::size_t{width} * height; }
    /// Values of a channel; empty when there is none of this name.
    std::span<const float> find(std::string_view name) const;
    /// A new channel of zeros, or the one of this name.
    std::span<float> add(const std::string& name);
    /// R, G, B of a layer ("" is the picture itself), interleaved [y, x, rgb].
    /// throws:  InputError when one is missing
    std::vector<float> interleaved(std::string_view layer) const;
    /// Sets R, G, B (or X, Y, Z) of a layer from interleaved triples; `axes` is "RGB" or "XYZ".
    void set_layer(std::string_view layer, std::string_view axes, std::span<const float> triples);
};

enum class Compression { none, zip };

/// Equal images give equal bytes.
/// needs:   R, G, B, and as many values as pixels in each channel (else std::logic_error)
/// throws:  NonfiniteError when a value is NaN or infinite
void write_image(const Image& image, const std::filesystem::path& path, Compression compression = Compression::none,
                 Sync sync = Sync::yes);

/// Reads any flat EXR with full-resolution channels R, G and B, half, float or integer, whatever its windows.
/// The picture is the data window.
/// throws:  InputError naming the file, and the channel where one is missing
Image read_image(const std::filesystem::path& path);
/// The same for a file that need not have R, G and B.
Image read_any_exr(const std::filesystem::path& path);

/// Attributes of the header in words, (name, value): texts, numbers, windows and compression.
std::vector<std::pair<std::string, std::string>> exr_attributes(const std::filesystem::path& path);

/// Number of values that are NaN or infinite.
std::size_t count_nonfinite(const Image& image);
/// Throws an InputError with file, channels, counts and first pixel where R, G or B of these layers hold NaN or
/// infinity.
void require_finite(const Image& image, std::initializer_list<std::string_view> layers,
                    const std::filesystem::path& file);

/// Mean of VarMean over pixels and R, G, B; those that are not finite are left out. 0 without VarMean.
double mean_var_mean(const Image& image);

/// What a display shows of a linear value, clamped to [0, 1].                [IEC 61966-2-1]
double srgb_from_linear(double linear);

/// Writes an 8-bit sRGB preview of R, G, B times 2^exposure_ev. NaN shows as black.
/// out:     number of pixels that held a NaN or an infinity
std::size_t write_png(const Image& image, const std::filesystem::path& path, double exposure_ev = 0,
                      Sync sync = Sync::yes);

/// What the format holds, as Markdown.
std::string image_markdown();

}  // namespace loom
