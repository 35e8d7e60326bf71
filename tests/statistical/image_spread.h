#pragma once
// The spread of replicates of an image: means of regions, and the variance of each pixel.

#include <cstddef>
#include <string>
#include <vector>

#include "formats/image.h"
#include "stages/core/stats/moments.h"
#include "tests/statistical/support.h"

namespace loom {

/// Images of one kind, each with samples of its own.
class ImageSpread {
  public:
    explicit ImageSpread(std::size_t n_pixels) : moments_(3 * n_pixels), stored_(n_pixels) {}

    void add(const Image& image) {
        regions_.push_back(region_means(image));
        for (std::size_t c = 0; c < 3; ++c) {
            const std::string channel(1, "RGB"[c]);
            const auto L = image.find(channel), V = image.find("VarMean." + channel);
            for (std::size_t p = 0; p < L.size(); ++p) {
                moments_[c * L.size() + p].add(L[p]);
                stored_[p] += V[p];
            }
        }
    }
    /// Variance between the images, summed over channels and pixels.
    /// in:      of  whether a pixel counts
    template <class Of>
    double variance(Of&& of) const {
        double sum = 0;
        for (std::size_t i = 0; i < moments_.size(); ++i)
            if (of(i % stored_.size())) sum += moments_[i].var_sample();
        return sum;
    }
    /// The same as the images store it, mean over them.
    template <class Of>
    double stored_variance(Of&& of) const {
        double sum = 0;
        for (std::size_t p = 0; p < stored_.size(); ++p)
            if (of(p)) sum += stored_[p];
        return sum / double(regions_.size());
    }
    Estimate estimate(std::size_t channel, std::size_t region) const {
        std::vector<double> values;
        for (const RegionMeans& means : regions_) values.push_back(means[channel][region]);
        return estimate_of(values);
    }
    static bool everywhere(std::size_t) { return true; }

  private:
    std::vector<RegionMeans> regions_;
    std::vector<Moments> moments_;  // [channel, pixel]
    std::vector<double> stored_;    // [pixel] sum over channels and images
};

}  // namespace loom
