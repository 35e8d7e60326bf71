#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <utility>

#include "formats/io/error.h"
#include "stages/core/assets/image_decoder.h"
#include "stages/core/assets/texture.h"
#include "stages/core/description/spectrum.h"

namespace loom {
namespace {

float decoded(float value, Decode decode, bool integers) {
    if (decode.raw) return value;
    if (decode.gamma > 0) return std::pow(std::max(value, 0.0f), decode.gamma);
    return integers || decode.gamma < 0 ? linear_from_srgb(value) : value;
}

/// Pads a colour to four bytes per pixel.
std::vector<std::uint8_t> padded(const std::vector<std::uint8_t>& rgb) {
    std::vector<std::uint8_t> out(rgb.size() / 3 * 4);
    for (std::size_t i = 0; i < rgb.size() / 3; ++i) std::copy_n(&rgb[3 * i], 3, &out[4 * i]);
    return out;
}

Spectrum mean_of_bytes(const TextureImage& image) {
    // Counting the values first makes the sum exact and cheap.
    std::array<std::array<std::uint64_t, 256>, 3> counts{};
    const std::size_t stride = image.grey ? 1 : 4, n_channels = image.grey ? 1 : 3;
    for (std::size_t i = 0; i < image.bytes.size(); i += stride)
        for (std::size_t c = 0; c < n_channels; ++c) ++counts[c][image.bytes[i + c]];
    Spectrum mean;
    for (std::size_t c = 0; c < 3; ++c) {
        double sum = 0;
        for (std::size_t v = 0; v < 256; ++v) sum += double(counts[c < n_channels ? c : 0][v]) * image.decode[v];
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
    DecodedImage in = decode_image(file);
    TextureImage image;
    image.width = in.width;
    image.height = in.height;
    image.grey = in.n_channels == 1;
    if (!in.note.empty()) image.note = fmt::format("{}: {}", file.string(), in.note);
    if (!in.bytes.empty()) {
        image.bytes = image.grey ? std::move(in.bytes) : padded(in.bytes);
        for (int v = 0; v < 256; ++v) image.decode[std::size_t(v)] = decoded(float(v) / 255.0f, decode, in.integers);
        image.mean = mean_of_bytes(image);
    } else {
        image.floats = std::move(in.floats);
        for (std::size_t i = 0; i < image.floats.size(); ++i) {
            image.floats[i] = decoded(image.floats[i], decode, in.integers);
            if (!std::isfinite(image.floats[i])) {
                const std::size_t pixel = i / (image.grey ? 1 : 3);
                throw InputError(fmt::format("{}: pixel ({}, {}) is not finite", file.string(),
                                             pixel % std::size_t(image.width), pixel / std::size_t(image.width)));
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
    std::call_once(entry->once, [&] { entry->image = std::make_shared<const TextureImage>(read_image(file, decode)); });
    return entry->image;
}

std::vector<std::string> TextureCache::notes() const {
    std::vector<std::string> notes;
    for (const auto& [key, entry] : entries_) {
        if (!entry->image || entry->image->note.empty()) continue;
        if (notes.empty() || notes.back() != entry->image->note) notes.push_back(entry->image->note);
    }
    return notes;
}

}  // namespace loom
