#include "tests/statistical/support.h"

#include <fmt/format.h>
#include <tbb/parallel_for.h>

#include <cctype>
#include <cmath>
#include <cstdlib>

#include "stages/core/stats/chi_square.h"
#include "stages/core/stats/moments.h"

namespace loom {

std::filesystem::path source_dir() {
    return LOOM_SOURCE_DIR;
}

std::filesystem::path shared_dir() {
    const auto dir = source_dir() / ".." / "shared";
    return std::filesystem::is_directory(dir / "oracles") ? dir : std::filesystem::path();
}

std::string test_name(std::string text) {
    if (const auto ending = text.find(".xml"); ending != std::string::npos) text.erase(ending, 4);
    for (char& c : text)
        if (!std::isalnum(static_cast<unsigned char>(c))) c = '_';
    return text;
}

bool full_run() {
    const char* full = std::getenv("LOOM_TEST_FULL");
    return full && *full && std::string(full) != "0";
}

RegionMeans region_means(const Image& image, const std::string& layer) {
    RegionMeans means;
    const char* rgb[] = {"R", "G", "B"};
    for (int c = 0; c < 3; ++c) {
        const auto values = image.find(layer.empty() ? rgb[c] : layer + "." + rgb[c]);
        constexpr std::size_t n_regions = 1 + n_tiles * n_tiles;
        std::vector<double> sum(n_regions), count(n_regions);
        for (std::uint32_t y = 0; y < image.height; ++y)
            for (std::uint32_t x = 0; x < image.width; ++x) {
                const double v = values[std::size_t(y) * image.width + x];
                const int tile = 1 + int(y * n_tiles / image.height) * n_tiles + int(x * n_tiles / image.width);
                sum[0] += v;
                sum[tile] += v;
                ++count[0];
                ++count[tile];
            }
        for (std::size_t i = 0; i < sum.size(); ++i) sum[i] /= count[i];
        means[c] = std::move(sum);
    }
    return means;
}

PathOptions options_of(const Scene& scene) {
    PathOptions path;
    path.max_depth = scene.max_depth;
    path.rr_depth = scene.rr_depth;
    return path;
}

Estimate Replicates::estimate(int channel, int region) const {
    std::vector<double> values;
    for (const RegionMeans& r : regions) values.push_back(r[channel][region]);
    return estimate_of(values);
}

Replicates trace_replicates(const Scene& scene, const PathOptions& path, std::uint64_t spp, int replicates,
                            std::uint64_t first_seed) {
    app::Report report;
    report.set_quiet(true);
    Replicates out;
    const std::size_t n = scene.sensor.n_pixels();
    std::vector<Moments> moments(3 * n);
    const char* rgb[] = {"R", "G", "B"};
    // Side by side, for many of the images are too small to keep several threads busy.
    std::vector<Image> images(replicates);
    tbb::parallel_for(0, replicates, [&](int i) {
        PathOptions mine = path;
        mine.seed = first_seed + std::uint64_t(i);
        trace::Counts counts;
        images[i] = trace::render_image(scene, mine, {0, spp, 1}, report, counts);
    });
    for (int i = 0; i < replicates; ++i) {
        Image& image = images[i];
        out.regions.push_back(region_means(image));
        for (int c = 0; c < 3; ++c) {
            const auto values = image.find(rgb[c]), var = image.find(std::string("VarMean.") + rgb[c]);
            for (std::size_t k = 0; k < n; ++k) {
                moments[3 * k + c].add(values[k]);
                out.claimed_per_pixel += var[k] / replicates;
            }
        }
        if (i == 0) out.mean = std::move(image);
    }
    for (int c = 0; c < 3; ++c) {
        const auto mean = out.mean.add(rgb[c]);
        for (std::size_t k = 0; k < n; ++k) mean[k] = float(moments[3 * k + c].mean);
        const auto var = out.mean.add(std::string("VarMean.") + rgb[c]);
        for (std::size_t k = 0; k < n; ++k) {
            var[k] = float(moments[3 * k + c].var_mean());
            out.spread_per_pixel += moments[3 * k + c].var_sample();
        }
    }
    out.mean.samples = spp * replicates;
    return out;
}

std::string judge_regions(const Replicates& ours, const RegionMeans& reference, const RegionMeans& reference_se,
                          int n_comparisons, const std::string& name) {
    const double alpha = sidak_alpha(n_comparisons);
    std::string failures;
    for (int c = 0; c < 3; ++c)
        for (int region = 0; region < 1 + n_tiles * n_tiles; ++region) {
            const Estimate mine = ours.estimate(c, region);
            const Estimate theirs{reference[c][region], reference_se[c][region], INFINITY};
            const double p = welch_p_value(mine, theirs);
            if (p >= alpha) continue;
            failures +=
                fmt::format("\n  {} channel {}: ours {:.7g} +- {:.2g}, reference {:.7g} +- {:.2g}, p = {:.2g}",
                            region == 0 ? std::string("image mean")
                                        : fmt::format("tile ({}, {})", (region - 1) % n_tiles, (region - 1) / n_tiles),
                            c, mine.mean, mine.se, theirs.mean, theirs.se, p);
        }
    if (!failures.empty()) {
        const auto dir = source_dir() / "out" / "test-failures";
        std::filesystem::create_directories(dir);
        write_image(ours.mean, dir / (name + ".exr"));
        write_png(ours.mean, dir / (name + ".png"));
        failures += fmt::format("\n  our image: out/test-failures/{}.exr", name);
    }
    return failures;
}

}  // namespace loom
