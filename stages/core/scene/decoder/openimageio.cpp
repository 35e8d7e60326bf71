// The only file that knows OpenImageIO; a module of its own, which decode_image() loads.
#include <OpenImageIO/imageio.h>
#include <fmt/format.h>

#include <filesystem>
#include <memory>

#include "stages/core/scene/image_decoder.h"

namespace {

/// ImageInput::open, which takes what follows a ? in a name for options.
std::unique_ptr<OIIO::ImageInput> open(const std::string& file, const OIIO::ImageSpec& wanted) {
    if (file.find('?') == std::string::npos) return OIIO::ImageInput::open(file, &wanted);
    const std::string extension = std::filesystem::path(file).extension();
    auto input = OIIO::ImageInput::create(extension.empty() ? file : extension.substr(1));
    OIIO::ImageSpec spec;
    if (input && !input->open(file, spec, wanted)) input.reset();
    return input;
}

}  // namespace

extern "C" __attribute__((visibility("default"))) std::string loom_image_decoder(const std::string& file,
                                                                                 loom::DecodedImage& image) {
    OIIO::ImageSpec wanted;
    wanted.attribute("oiio:UnassociatedAlpha", 1);  // colours as stored, not multiplied by alpha
    const auto input = open(file, wanted);
    if (!input) return fmt::format("not a readable image: {}", OIIO::geterror());
    const OIIO::ImageSpec& spec = input->spec();
    constexpr std::int64_t most_pixels = std::int64_t(1) << 30;
    if (spec.width < 1 || spec.height < 1 || spec.nchannels < 1 || spec.depth > 1 ||
        std::int64_t(spec.width) * spec.height > most_pixels)
        return fmt::format("{} x {} pixels with {} channels cannot be used as a texture", spec.width, spec.height,
                           spec.nchannels);
    image.width = spec.width;
    image.height = spec.height;
    image.n_channels = spec.nchannels;
    const bool eight_bit = spec.format == OIIO::TypeDesc::UINT8;
    image.integers = eight_bit || spec.format == OIIO::TypeDesc::UINT16;
    const auto read = [&](auto& values, OIIO::TypeDesc type) -> std::string {
        values.resize(std::size_t(spec.width) * std::size_t(spec.height) * std::size_t(spec.nchannels));
        if (input->read_image(0, 0, 0, spec.nchannels, type, values.data())) return {};
        return fmt::format("truncated or damaged image: {}", input->geterror());
    };
    return eight_bit ? read(image.bytes, OIIO::TypeDesc::UINT8) : read(image.floats, OIIO::TypeDesc::FLOAT);
}

static_assert(std::is_same_v<loom::ImageDecoder, decltype(loom_image_decoder)>);
