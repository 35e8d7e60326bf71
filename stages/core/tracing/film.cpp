#include "stages/core/tracing/film.h"

#include <cmath>

namespace loom {

void PixelSums::add(const Spectrum& sample) {
    for (int c = 0; c < 3; ++c) L[c].add(sample[c]);
}

void PixelSums::add(const Spectrum& sample, const FirstHit& first) {
    add(sample);
    add(first);
}

void PixelSums::add(const FirstHit& first) {
    if (first.depth == 0) return;
    ++hits;
    depth += first.depth;
    for (int c = 0; c < 3; ++c) {
        albedo[c] += first.albedo[c];
        n[c] += first.n[c];
    }
}

Film::Film(std::uint32_t width, std::uint32_t height, std::uint64_t samples) {
    image_.width = width;
    image_.height = height;
    image_.samples = samples;
    const char *rgb[] = {"R", "G", "B"}, *xyz[] = {"X", "Y", "Z"};
    // Add all channels before taking spans: adding a channel may move the others.
    for (int c = 0; c < 3; ++c) {
        image_.add(rgb[c]);
        image_.add(std::string("VarMean.") + rgb[c]);
        image_.add(std::string("Albedo.") + rgb[c]);
        image_.add(std::string("N.") + xyz[c]);
    }
    image_.add("Depth.Z");
    for (int c = 0; c < 3; ++c) {
        radiance_[c] = image_.add(rgb[c]);
        var_mean_[c] = image_.add(std::string("VarMean.") + rgb[c]);
        albedo_[c] = image_.add(std::string("Albedo.") + rgb[c]);
        n_[c] = image_.add(std::string("N.") + xyz[c]);
    }
    depth_ = image_.add("Depth.Z");
}

void Film::set(std::uint64_t pixel, const PixelSums& sums) {
    const double samples = double(sums.L[0].n);
    // Depth is the mean over the samples that hit a surface; the others are means over all samples.
    for (int c = 0; c < 3; ++c) {
        radiance_[c][pixel] = float(sums.L[c].mean);
        var_mean_[c][pixel] = float(sums.L[c].var_mean());
        albedo_[c][pixel] = float(sums.albedo[c] / samples);
        n_[c][pixel] = float(sums.n[c] / samples);
    }
    depth_[pixel] = sums.hits > 0 ? float(sums.depth / double(sums.hits)) : 0.0f;
}

Image Film::finish(Provenance provenance) && {
    image_.provenance = std::move(provenance);
    return std::move(image_);
}

}  // namespace loom
