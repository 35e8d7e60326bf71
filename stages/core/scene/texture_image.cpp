#include <OpenImageIO/imageio.h>
#include <fmt/format.h>

#include <cmath>

#include "formats/io/error.h"
#include "stages/core/scene/spectrum.h"
#include "stages/core/scene/texture.h"

namespace loom {
namespace {

float decoded(float value, Decode decode, bool integers) {
    if (decode.raw) return value;
    if (decode.gamma > 0) return std::pow(std::max(value, 0.0f), decode.gamma);
    return integers ? linear_from_srgb(value) : value;
}

/// Drops alpha and pads a colour to `stride`: n_in interleaved channels to 1 or `stride` per pixel.
template <class T>
std::vector<T> pick_channels(const std::vector<T>& in, int n_in, bool grey, int stride) {
    const std::size_t n_pixels = in.size() / std::size_t(n_in), n_out = std::size_t(grey ? 1 : stride);
    if (std::size_t(n_in) == n_out) return in;
    std::vector<T> out(n_pixels * n_out);
    for (std::size_t i = 0; i < n_pixels; ++i)
        for (std::size_t c = 0; c < (grey ? 1u : 3u); ++c) out[i * n_out + c] = in[i * std::size_t(n_in) + c];
    return out;
}

Spectrum mean_of_bytes(const TextureImage& image) {
    // Counting the values first keeps the sum exact and cheap.
    std::array<std::array<std::uint64_t, 256>, 3> counts{};
    const std::size_t stride = image.grey ? 1 : 4, n_channels = image.grey ? 1 : 3;
    for (std::size_t i = 0; i < image.bytes.size(); i += stride)
        for (std::size_t c = 0; c < n_channels; ++c) ++counts[c][image.bytes[i + c]];
    Spectrum mean;
    for (std::size_t c = 0; c < 3; ++c) {
        double sum = 0;
        for (std::size_t v = 0; v < 256; ++v)
            sum += double(counts[c < n_channels ? c : 0][v]) * image.decode[v];
        mean[int(c)] = float(sum / (double(image.width) * image.height));
    }
    return mean;
}

Spectrum mean_of_floats(const TextureImage& image) {
    double sums[3] = {};
    const std::size_t stride = image.grey ? 1 : 3;
    for (std::size_t i = 0; i < image.floats.size(); i += stride)
        for (std::size_t c = 0; c < 3; ++c) sums[c] += image.floats[i + (image.grey ? 0 : c)];
    const double n = double(image.width) * image.height;
    return {float(sums[0] / n), float(sums[1] / n), float(sums[2] / n)};
}

TextureImage read_image(const std::filesystem::path& file, Decode decode) {
    const std::string name = file.string();
    std::error_code error;
    if (!std::filesystem::is_regular_file(file, error)) throw InputError(name + ": no such file");
    OIIO::ImageSpec wanted;
    wanted.attribute("oiio:UnassociatedAlpha", 1);  // colours as stored, not multiplied by alpha
    const auto input = OIIO::ImageInput::open(name, &wanted);
    if (!input) throw InputError(fmt::format("{}: not a readable image: {}", name, OIIO::geterror()));
    const OIIO::ImageSpec& spec = input->spec();
    constexpr std::int64_t most_pixels = std::int64_t(1) << 30;
    if (spec.width < 1 || spec.height < 1 || spec.nchannels < 1 || spec.depth > 1 ||
        std::int64_t(spec.width) * spec.height > most_pixels)
        throw InputError(fmt::format("{}: {} x {} pixels with {} channels cannot be used as a texture", name,
                                     spec.width, spec.height, spec.nchannels));
    TextureImage image;
    image.width = spec.width;
    image.height = spec.height;
    image.grey = spec.nchannels < 3;
    const bool eight_bit = spec.format == OIIO::TypeDesc::UINT8;
    const bool integers = eight_bit || spec.format == OIIO::TypeDesc::UINT16;
    const std::size_t n_values =
        std::size_t(spec.width) * std::size_t(spec.height) * std::size_t(spec.nchannels);
    const auto read = [&](auto& values, OIIO::TypeDesc type) {
        values.resize(n_values);
        if (!input->read_image(0, 0, 0, spec.nchannels, type, values.data()))
            throw InputError(fmt::format("{}: truncated or damaged image: {}", name, input->geterror()));
    };
    if (eight_bit) {
        std::vector<std::uint8_t> values;
        read(values, OIIO::TypeDesc::UINT8);
        image.bytes = pick_channels(values, spec.nchannels, image.grey, 4);
        for (int v = 0; v < 256; ++v)
            image.decode[std::size_t(v)] = decoded(float(v) / 255.0f, decode, integers);
        image.mean = mean_of_bytes(image);
    } else {
        std::vector<float> values;
        read(values, OIIO::TypeDesc::FLOAT);
        image.floats = pick_channels(values, spec.nchannels, image.grey, 3);
        for (std::size_t i = 0; i < image.floats.size(); ++i) {
            image.floats[i] = decoded(image.floats[i], decode, integers);
            if (!std::isfinite(image.floats[i])) {
                const std::size_t pixel = i / (image.grey ? 1 : 3);
                throw InputError(fmt::format("{}: pixel ({}, {}) is not finite", name,
                                             pixel % std::size_t(image.width),
                                             pixel / std::size_t(image.width)));
            }
        }
        image.mean = mean_of_floats(image);
    }
    return image;
}

}  // namespace

Spectrum TextureImage::texel(int x, int y) const {
    const std::size_t pixel = std::size_t(y) * std::size_t(width) + std::size_t(x);
    if (!bytes.empty()) {
        if (grey) return Spectrum(decode[bytes[pixel]]);
        const std::uint8_t* p = &bytes[4 * pixel];
        return {decode[p[0]], decode[p[1]], decode[p[2]]};
    }
    if (grey) return Spectrum(floats[pixel]);
    const float* p = &floats[3 * pixel];
    return {p[0], p[1], p[2]};
}

std::shared_ptr<const TextureImage> TextureCache::image(const std::filesystem::path& file, Decode decode) {
    std::shared_ptr<Entry> entry;
    {
        const std::lock_guard lock(mutex_);
        std::shared_ptr<Entry>& slot = entries_[{file.lexically_normal().string(), decode}];
        if (!slot) slot = std::make_shared<Entry>();
        entry = slot;
    }
    std::call_once(entry->once,
                   [&] { entry->image = std::make_shared<const TextureImage>(read_image(file, decode)); });
    return entry->image;
}

}  // namespace loom
