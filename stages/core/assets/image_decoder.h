#pragma once
#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

namespace loom {

/// Colours of an image file: grey or RGB interleaved, row 0 on top, not multiplied by alpha.
struct DecodedImage {
    int width = 0, height = 0, n_channels = 0;  // 1 or 3 channels
    bool integers = false;                      // stored as 8 or 16 bits; their floats are in [0, 1]
    std::vector<std::uint8_t> bytes;            // 8-bit images
    std::vector<float> floats;                  // all others
    std::string note;                           // the parts of the file without effect; empty: none
};

/// Reads any format that OpenImageIO supports, channels of EXR files by name (colour_channels.h). The first call loads
/// that library with its 150 dependencies, so that a scene without textures does not pay for it.
/// throws:  InputError naming the file; std::runtime_error when the library is missing
DecodedImage decode_image(const std::filesystem::path& file);

/// The only function of the loadable module. Returns the problem with the file; empty when there is none.
using ImageDecoder = std::string(const std::string& file, DecodedImage& image);
inline constexpr char image_decoder_module[] = "loom-image-decoder.so";
inline constexpr char image_decoder_symbol[] = "loom_image_decoder";

}  // namespace loom
