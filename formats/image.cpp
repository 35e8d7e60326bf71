#include "formats/image.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <stdexcept>

#include "formats/io/error.h"
#include "formats/io/field_checker.h"

namespace loom {
namespace {

std::string channel_name(std::string_view layer, char component) {
    return layer.empty() ? std::string(1, component) : fmt::format("{}.{}", layer, component);
}

}  // namespace

std::span<const float> Image::find(std::string_view name) const {
    const auto found = std::find_if(channels.begin(), channels.end(), [&](const Channel& c) { return c.name == name; });
    return found == channels.end() ? std::span<const float>{} : std::span<const float>(found->values);
}

std::span<float> Image::add(const std::string& name) {
    for (auto& channel : channels) {
        if (channel.name == name) return channel.values;
    }
    return channels.emplace_back(Channel{name, std::vector<float>(n_pixels())}).values;
}

std::vector<float> Image::interleaved(std::string_view layer) const {
    std::vector<float> triples(3 * n_pixels());
    for (std::size_t c = 0; c < 3; ++c) {
        const std::string name = channel_name(layer, "RGB"[c]);
        const auto values = find(name);
        if (values.empty() && n_pixels() > 0) throw InputError(fmt::format("the image has no channel {}", name));
        for (std::size_t i = 0; i < values.size(); ++i) triples[3 * i + c] = values[i];
    }
    return triples;
}

void Image::set_layer(std::string_view layer, std::string_view axes, std::span<const float> triples) {
    if (axes.size() != 3 || triples.size() != 3 * n_pixels()) {
        throw std::logic_error(fmt::format("layer {}: {} numbers for {} pixels", layer, triples.size(), n_pixels()));
    }
    for (std::size_t c = 0; c < 3; ++c) {
        const auto values = add(channel_name(layer, axes[c]));
        for (std::size_t i = 0; i < values.size(); ++i) values[i] = triples[3 * i + c];
    }
}

std::size_t count_nonfinite(const Image& image) {
    std::size_t n = 0;
    for (const auto& channel : image.channels) n += count_nonfinite(channel.values);
    return n;
}

void require_finite(const Image& image, std::initializer_list<std::string_view> layers,
                    const std::filesystem::path& file) {
    std::string text;
    for (const std::string_view layer : layers)
        for (const char component : {'R', 'G', 'B'}) {
            const auto values = image.find(channel_name(layer, component));
            const std::size_t first = first_nonfinite(values);
            if (first == values.size()) continue;
            text +=
                fmt::format("{}{} of {} (first in pixel ({}, {}))", text.empty() ? "" : ", ", count_nonfinite(values),
                            channel_name(layer, component), first % image.width, first / image.width);
        }
    if (!text.empty()) throw InputError(fmt::format("{}: values that are NaN or infinite: {}", file.native(), text));
}

double mean_var_mean(const Image& image) {
    double sum = 0;
    for (const char* channel : {"VarMean.R", "VarMean.G", "VarMean.B"})
        for (const float v : image.find(channel))
            if (std::isfinite(v)) sum += double(v);
    return sum / (3.0 * double(image.n_pixels()));
}

std::string image_markdown() {
    return R"(| channels | units | what it is |
|---|---|---|
| `R`, `G`, `B` | W m^-2 sr^-1 | mean radiance over the samples of a pixel |
| `VarMean.R`, `VarMean.G`, `VarMean.B` ? | (W m^-2 sr^-1)^2 | variance of that mean: s^2 / samples |
| `CacheError.R`, `CacheError.G`, `CacheError.B` ? | W m^-2 sr^-1 | of an image that used a radiance cache: expected error of the mean by it, beyond `VarMean` |
| `Albedo.R`, `Albedo.G`, `Albedo.B` ? | 1 | reflectance at the first hit |
| `N.X`, `N.Y`, `N.Z` ? | 1 | shading normal at the first hit, world space, mean over the samples |
| `Weight.R`, `Weight.G`, `Weight.B` ? | 1 | of a new image from a graph of the old scene: weight of the old image in it; 1 where the layer is missing |
| `Depth.Z` ? | m | distance from the camera to the first hit |
| `Plus.R`, `Plus.G`, `Plus.B` ? | W m^-2 sr^-1 | of a residual: mean of what paths of the new scene bring that the edit touches |
| `Minus.R`, `Minus.G`, `Minus.B` ? | W m^-2 sr^-1 | of a residual: mean of what paths of the old scene bring that the edit touches; `R`, `G`, `B` are Plus - Minus |
| `Coverage.A` ? | 1 | share of the camera rays of a pixel whose first hits an edit changes, by which the old image has less weight |

| attribute | what it is |
|---|---|
| `samples` | samples per pixel |
| `scene` ? | content hash and name of the scene of the image; absent for a residual |
| `ledger` ? | history of an image with edits: JSON, a list of the image before them and each edit, in order; of a residual, itself alone |

Each link of `ledger`: `scene` and `hash` of the scene after it; `what` it changes; `method` (empty for the first); `samples` per
pixel (pairs for an edit); `seed` of its random numbers; `var_mean`, the variance that it adds ((W m^-2 sr^-1)^2, mean over pixels
and R, G, B); `var_sample`, the variance of one path-traced sample of that scene (0: not known). Links share no random numbers, so
their `var_mean` add up.
)";
}

}  // namespace loom
