#pragma once
// Shared code of the statistical tests: replicates with their own seeds, and tests of image means and tile means.

#include <array>
#include <filesystem>
#include <string>
#include <vector>

#include "formats/image.h"
#include "stages/core/app/report.h"
#include "stages/core/scene/build.h"
#include "stages/core/stats/student.h"
#include "stages/trace/trace.h"

namespace loom {

inline constexpr int n_tiles = 8;  // per side

std::filesystem::path source_dir();
/// Returns the folder of shared scenes and references beside the project; empty when it is missing.
std::filesystem::path shared_dir();
/// Converts a text to a GoogleTest name: "a-scene.xml 3" -> a_scene_3.
std::string test_name(std::string text);
/// Whether the test runs under `make test-full`, with more samples.
bool full_run();

/// Means over regions of one image: regions[0] is the whole image, then 8 x 8 tiles row by row.
using RegionMeans = std::array<std::vector<double>, 3>;
RegionMeans region_means(const Image& image, const std::string& layer = "");

/// R path-traced images of a scene, each with its own seed.
struct Replicates {
    Image mean;                        // over all replicates, VarMean from their spread
    std::vector<RegionMeans> regions;  // [replicate]
    Estimate estimate(int channel, int region) const;
    double spread_per_pixel = 0;   // sum over pixels and channels of the variance between replicates
    double claimed_per_pixel = 0;  // sum of the images' var_mean, mean over replicates
};
/// in:  first_seed  of the replicates' consecutive seeds
Replicates trace_replicates(const Scene& scene, const PathOptions& path, std::uint64_t spp, int replicates,
                            std::uint64_t first_seed = 1000);

PathOptions options_of(const Scene& scene);

/// Compares image mean and tile means with known ones; each comparison at Sidak's alpha over `n_comparisons`.
/// in:  reference_se  standard errors of the reference means by channel and region
/// out: the failures as text, empty when there are none; on failure the images are kept in out/test-failures
std::string judge_regions(const Replicates& ours, const RegionMeans& reference, const RegionMeans& reference_se,
                          int n_comparisons, const std::string& name);

}  // namespace loom
