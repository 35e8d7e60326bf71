#pragma once
// Passes of path graphs, from scene to image, for the statistical tests of sharing, gathering and blending.

#include <algorithm>
#include <functional>

#include "stages/gather/gather.h"
#include "stages/merge/blend.h"
#include "tests/statistical/support.h"
#include "tests/traced_graph.h"

namespace loom {

struct Recipe {
    std::uint32_t k = 16;
    std::uint64_t spp = 1;
    refine::Options refine;
    gather::GatherOptions gather;
    SamplerKind sampler = SamplerKind::independent;
    bool visibility = true;  // members that are occluded from each other are separated
};

struct Pass {
    Image image;  // from the clusters, by the recipe
    Image paths;  // of the same graph, from its paths alone
    Radiance radiance;
};

/// Makes one pass with its own random streams and borders of clusters.
inline Pass make_pass(const Scene& scene, std::uint64_t seed, const Recipe& recipe) {
    const PathGraph graph = testing::trace_graph(scene, testing::path_options(scene, seed, recipe.sampler), recipe.spp);
    const Clusters clusters = testing::clusters_of(graph, recipe.k, seed, 0.03f, recipe.visibility ? &scene : nullptr);
    Radiance radiance = testing::radiance_of(graph, clusters, recipe.refine);
    Image image = gather::gathered_image(graph, radiance, recipe.gather, 0, {&clusters, &scene, seed});
    return {std::move(image), gather::path_traced_image(graph, 0), std::move(radiance)};
}

/// Mean of a channel over the pixels of a window [x0, x1) x [y0, y1); by default over all pixels.
struct Window {
    std::uint32_t x0 = 0, y0 = 0, x1 = 0xffffffffu, y1 = 0xffffffffu;
};
inline double mean_of(const Image& image, const char* channel = "G", Window w = {}) {
    const auto values = image.find(channel);
    double sum = 0, n = 0;
    for (std::uint32_t y = w.y0; y < std::min(w.y1, image.height); ++y)
        for (std::uint32_t x = w.x0; x < std::min(w.x1, image.width); ++x, ++n)
            sum += values[std::size_t(y) * image.width + x];
    return sum / n;
}

/// Returns the mean of value(pass) over `passes` passes, with its standard error.
inline Estimate estimate_over_passes(const Scene& scene, const Recipe& recipe, int passes,
                                     const std::function<double(const Pass&)>& value) {
    std::vector<double> values;
    for (int i = 0; i < passes; ++i) values.push_back(value(make_pass(scene, 5000 + std::uint64_t(i), recipe)));
    return estimate_of(values);
}

/// Running mean of images over passes.
class MeanImage {
  public:
    void add(const Image& image) {
        const auto rgb = image.interleaved("");
        if (sum_.empty()) sum_.resize(rgb.size());
        for (std::size_t i = 0; i < rgb.size(); ++i) sum_[i] += rgb[i];
        ++n_;
    }
    std::vector<double> mean() const {
        std::vector<double> out(sum_);
        for (double& v : out) v /= n_;
        return out;
    }

  private:
    std::vector<double> sum_;
    int n_ = 0;
};

inline std::vector<double> doubles_of(const Image& image) {
    const auto rgb = image.interleaved("");
    return {rgb.begin(), rgb.end()};
}

/// Mean of (x - r)^2 / (r^2 + 0.01).
inline double rel_mse(const std::vector<double>& image, const std::vector<double>& reference) {
    double sum = 0;
    for (std::size_t i = 0; i < image.size(); ++i) sum += sqr(image[i] - reference[i]) / (sqr(reference[i]) + 0.01);
    return sum / double(image.size());
}

/// Path-traces a reference with spp samples per pixel.
inline std::vector<double> reference_of(const Scene& scene, std::uint64_t spp) {
    app::Report report;
    report.set_quiet(true);
    trace::Counts counts;
    return doubles_of(
        trace::render_image(scene, testing::path_options(scene, 77, SamplerKind::sobol), {0, spp, 0}, report, counts));
}

/// Errors of many passes against a reference: of the blend, of the clusters' mean, of the paths' mean.
struct Errors {
    double blend = 0, cluster = 0, paths = 0;
};
inline Errors errors_of(const Scene& scene, std::uint64_t first_seed, int passes, Recipe recipe,
                        const std::vector<double>& reference) {
    recipe.gather.estimates = true;
    std::vector<Image> parts;
    MeanImage cluster, paths;
    for (int i = 0; i < passes; ++i) {
        Pass pass = make_pass(scene, first_seed + std::uint64_t(i), recipe);
        cluster.add(pass.image);
        paths.add(pass.paths);
        parts.push_back(std::move(pass.image));
    }
    const Image blend = merge::blend_images(parts.size(), [&](std::size_t i) { return parts[i]; });
    return {rel_mse(doubles_of(blend), reference), rel_mse(cluster.mean(), reference),
            rel_mse(paths.mean(), reference)};
}

}  // namespace loom
