#pragma once
#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

namespace loom {

/// The colour of an image file: grey or red, green, blue interleaved, row 0 on top, not multiplied by alpha.
struct DecodedImage {
    int width = 0, height = 0, n_channels = 0;  // 1 or 3 channels
    bool integers = false;                      // stored as 8 or 16 bits; as floats they are in [0, 1]
    std::vector<std::uint8_t> bytes;            // 8-bit images
    std::vector<float> floats;                  // all others
    std::string note;                           // what of the file has no effect; empty: nothing
};

/// Reads any format that OpenImageIO knows, the channels of EXR files by name (colour_channels.h). That library, with
/// the 150 that it needs in turn, is loaded by the first call, so that a scene without textures does not wait for it.
/// throws:  InputError naming the file; std::runtime_error when the library is not there
DecodedImage decode_image(const std::filesystem::path& file);

/// The one function of the loadable module. Returns what is wrong with the file, empty when nothing is.
using ImageDecoder = std::string(const std::string& file, DecodedImage& image);
inline constexpr char image_decoder_module[] = "loom-image-decoder.so";
inline constexpr char image_decoder_symbol[] = "loom_image_decoder";

}  // namespace loom
