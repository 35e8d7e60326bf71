// The only file that includes OpenImageIO; a separate module, which decode_image() loads.
#include <OpenImageIO/imageio.h>
#include <fmt/format.h>

#include <algorithm>
#include <filesystem>
#include <memory>
#include <string_view>

#include "stages/core/assets/colour_channels.h"
#include "stages/core/assets/image_decoder.h"

namespace {

/// Replaces ImageInput::open for names with a ?, whose rest it would read as options.
std::unique_ptr<OIIO::ImageInput> open(const std::string& file, const OIIO::ImageSpec& wanted) {
    if (file.find('?') == std::string::npos) return OIIO::ImageInput::open(file, &wanted);
    const std::string extension = std::filesystem::path(file).extension();
    auto input = OIIO::ImageInput::create(extension.empty() ? file : extension.substr(1));
    OIIO::ImageSpec spec;
    if (input && !input->open(file, spec, wanted)) input.reset();
    return input;
}

using loom::ColourChannels;

/// Chooses colours in formats without channel names: grey, grey and alpha, or red, green, blue and further channels.
ColourChannels by_position(const OIIO::ImageSpec& spec) {
    ColourChannels colour;
    colour.kind = spec.nchannels < 3 ? ColourChannels::Kind::grey : ColourChannels::Kind::rgb;
    colour.at = {0, 1, 2};
    return colour;
}

ColourChannels by_name(OIIO::ImageInput& input) {
    std::vector<std::vector<std::string>> parts;
    for (int part = 0;; ++part) {
        const OIIO::ImageSpec spec = input.spec_dimensions(part);
        if (spec.nchannels < 1) break;
        parts.push_back(input.spec(part).channelnames);
    }
    return loom::choose_colour(parts);
}

/// Converts by R = (RY + 1) Y, B = (BY + 1) Y; Y is the luminance of all three, with the weights of Rec. 709.
/// differs: other chromaticities are not read
void rgb_from_luminance_chroma(std::vector<float>& values) {
    for (std::size_t i = 0; i < values.size(); i += 3) {
        const float y = values[i + 1], r = (values[i] + 1) * y, b = (values[i + 2] + 1) * y;
        values[i] = r;
        values[i + 1] = (y - 0.2126f * r - 0.0722f * b) / 0.7152f;
        values[i + 2] = b;
    }
}

/// Reads the colour channels, interleaved in their order.
template <class T>
std::string read_colour(OIIO::ImageInput& input, const OIIO::ImageSpec& spec, const ColourChannels& colour,
                        std::vector<T>& values) {
    const std::size_t n = std::size_t(colour.count()), n_pixels = std::size_t(spec.width) * std::size_t(spec.height);
    const auto [first, last] = std::minmax_element(colour.at.begin(), colour.at.begin() + std::ptrdiff_t(n));
    const int begin = *first, end = *last + 1;
    const std::size_t width = std::size_t(end - begin);
    std::vector<T> read(n_pixels * width);
    // OpenImageIO maps unsigned integers to [0, 1]; in an EXR file they are plain numbers.
    const bool numbers = std::string_view(input.format_name()) == "openexr";
    if (!input.read_image(int(colour.part), 0, begin, end, OIIO::TypeDesc(OIIO::BaseTypeFromC<T>::value), read.data()))
        return fmt::format("truncated or damaged image: {}", input.geterror());
    values.resize(n_pixels * n);
    for (std::size_t c = 0; c < n; ++c) {
        const bool unsigned_numbers = numbers && spec.channelformat(colour.at[c]) == OIIO::TypeDesc::UINT32;
        const double scale = unsigned_numbers ? 4294967295.0 : 1.0;
        const std::size_t from = std::size_t(colour.at[c] - begin);
        for (std::size_t i = 0; i < n_pixels; ++i)
            values[n * i + c] = unsigned_numbers ? T(double(read[width * i + from]) * scale) : read[width * i + from];
    }
    return {};
}

std::string window_text(int x, int y, int width, int height) {
    return fmt::format("{} x {} at ({}, {})", width, height, x, y);
}

}  // namespace

extern "C" __attribute__((visibility("default"))) std::string loom_image_decoder(const std::string& file,
                                                                                 loom::DecodedImage& image) {
    OIIO::ImageSpec wanted;
    wanted.attribute("oiio:UnassociatedAlpha", 1);  // colours as stored, not multiplied by alpha
    const auto input = open(file, wanted);
    if (!input) {
        const std::string why = OIIO::geterror();
        if (why.find("Subsampled") == std::string::npos) return fmt::format("not a readable image: {}", why);
        return fmt::format(
            "its colour is luminance with subsampled chroma (channels Y, RY, BY), which is not supported; store R, G, "
            "B: {}",
            why);
    }
    const bool named = std::string_view(input->format_name()) == "openexr";
    const ColourChannels colour = named ? by_name(*input) : by_position(input->spec());
    if (colour.kind == ColourChannels::Kind::none) return colour.problem;
    const OIIO::ImageSpec spec = input->spec(int(colour.part));
    constexpr std::int64_t most_pixels = std::int64_t(1) << 30;
    if (spec.width < 1 || spec.height < 1 || spec.nchannels < 1 || spec.depth > 1 || spec.deep ||
        std::int64_t(spec.width) * spec.height > most_pixels)
        return fmt::format("{} x {} pixels with {} channels{} cannot be used as a texture", spec.width, spec.height,
                           spec.nchannels, spec.deep ? ", a deep image," : "");
    image.width = spec.width;
    image.height = spec.height;
    image.n_channels = colour.count();
    if (spec.x != spec.full_x || spec.y != spec.full_y || spec.width != spec.full_width ||
        spec.height != spec.full_height)
        image.note = fmt::format("the texture is the stored pixels ({}), not the display window ({})",
                                 window_text(spec.x, spec.y, spec.width, spec.height),
                                 window_text(spec.full_x, spec.full_y, spec.full_width, spec.full_height));
    const bool eight_bit = spec.format == OIIO::TypeDesc::UINT8;
    image.integers = eight_bit || spec.format == OIIO::TypeDesc::UINT16;
    std::string problem =
        eight_bit ? read_colour(*input, spec, colour, image.bytes) : read_colour(*input, spec, colour, image.floats);
    if (problem.empty() && colour.kind == ColourChannels::Kind::luminance_chroma)
        rgb_from_luminance_chroma(image.floats);
    return problem;
}

static_assert(std::is_same_v<loom::ImageDecoder, decltype(loom_image_decoder)>);
