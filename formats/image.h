#pragma once
// image: an image with named layers, stored as an OpenEXR file.
//
//   R, G, B                mean radiance                         W m^-2 sr^-1
//   VarMean.R/G/B          variance of that mean, per channel    (W m^-2 sr^-1)^2
//   Albedo.R/G/B           reflectance at the first hit          1
//   N.X/Y/Z                shading normal at the first hit       unit, world space
//   Depth.Z                distance of the first hit             m
//   Weight.R/G/B           of a new image from a graph: weight of the old image in it; 1 without the layer    1
//
//   Emitted.R/G/B          emission visible directly             W m^-2 sr^-1
//   DirectOwn.R/G/B, DirectCluster.R/G/B
//   IndirectPath.R/G/B, IndirectOwn.R/G/B, IndirectCluster.R/G/B
//                          the other components, estimated by the pixel's own paths (Path), by its own sample of
//                          refined radiance (Own), and by the clusters of its vertices (Cluster); input of a blend
//                                                                W m^-2 sr^-1
//
//   Plus.R/G/B, Minus.R/G/B
//                          of a residual: what paths of the new and of the old scene bring that the edit touches;
//                          R, G, B are Plus - Minus              W m^-2 sr^-1
//   Coverage.A             share of the pixel whose first hits an edit changes    1
//
// A file has only the layers that its stage computes; R, G, B are always present. Channels are float32 in memory and on
// disk; row 0 is on top. The root attributes of all formats are text attributes of the header, including `samples` (per
// pixel). Two are optional. `scene` is the content hash and name of the rendered scene; a residual has none. `ledger`
// lists the terms of a sum of an image and residuals (formats/ledger.h).

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

/// Layers that a blend combines.
inline constexpr std::array<const char*, 6> estimate_layers{"Emitted",      "DirectOwn",   "DirectCluster",
                                                            "IndirectPath", "IndirectOwn", "IndirectCluster"};

/// Layer with the weight of the old image in a new one.
inline constexpr const char* weight_layer = "Weight";

struct Image {
    static constexpr FormatId format{"image", 1, 2};

    struct Channel {
        std::string name;           // "R", "Albedo.R", "VarMean.B", …
        std::vector<float> values;  // [y, x]
    };

    std::uint32_t width = 0, height = 0;
    std::uint64_t samples = 0;  // samples per pixel; 0: not stored in the file
    std::vector<Channel> channels;
    Provenance provenance;
    InputId scene;                   // the rendered scene; empty hash: not stored in the file
    Ledger ledger;                   // of a sum of an image and residuals, or of one residual; else empty
    std::string filetype = "image";  // empty for an image of another program

    std::size_t n_pixels() const { return std::size_t{width} * height; }
    /// Returns the values of a channel; empty when no channel has this name.
    std::span<const float> find(std::string_view name) const;
    /// Returns the channel of this name; creates it with zeros when there is none.
    std::span<float> add(const std::string& name);
    /// Returns R, G, B of a layer ("" is the image itself), interleaved [y, x, rgb].
    /// throws:  InputError when a channel is missing
    std::vector<float> interleaved(std::string_view layer) const;
    /// Sets R, G, B (or X, Y, Z) of a layer from interleaved triples; `axes` is "RGB" or "XYZ".
    void set_layer(std::string_view layer, std::string_view axes, std::span<const float> triples);
};

enum class Compression { none, zip };

/// Writes an image; equal images give equal bytes.
/// needs:   R, G, B, and one value per pixel in each channel (else std::logic_error)
/// throws:  NonfiniteError when a value is NaN or infinite
void write_image(const Image& image, const std::filesystem::path& path, Compression compression = Compression::none,
                 Sync sync = Sync::yes);

/// Reads any flat EXR with full-resolution channels R, G and B of type half, float or integer. The data window is the
/// image; the display window is ignored.
/// throws:  InputError naming the file, and the channel where one is missing
Image read_image(const std::filesystem::path& path);
/// Reads an EXR as read_image() does; R, G and B may be missing.
Image read_any_exr(const std::filesystem::path& path);

/// Returns the header's attributes as text, (name, value): texts, numbers, windows and compression.
std::vector<std::pair<std::string, std::string>> exr_attributes(const std::filesystem::path& path);

/// Counts the values that are NaN or infinite.
std::size_t count_nonfinite(const Image& image);
/// Refuses an image whose R, G or B of these layers are NaN or infinite.
/// throws:  InputError with file, channels, counts and first pixel
void require_finite(const Image& image, std::initializer_list<std::string_view> layers,
                    const std::filesystem::path& file);

/// Returns the mean of VarMean over pixels and R, G, B, without non-finite values; 0 without VarMean.
double mean_var_mean(const Image& image);

/// Encodes a linear value as sRGB, clamped to [0, 1].                        [IEC 61966-2-1]
double srgb_from_linear(double linear);

/// Writes an 8-bit sRGB preview of R, G, B times 2^exposure_ev. NaN is written as black.
/// out:     number of pixels with a NaN or an infinity
std::size_t write_png(const Image& image, const std::filesystem::path& path, double exposure_ev = 0,
                      Sync sync = Sync::yes);

/// Returns the documentation of the format as Markdown.
std::string image_markdown();

}  // namespace loom
