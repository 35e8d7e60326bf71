#pragma once
// loom-learn: a radiance cache from the refined vertices of path graphs of one scene.                [HY] section 3.4

#include <algorithm>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "formats/clusters.h"
#include "formats/path_graph.h"
#include "formats/radiance.h"
#include "formats/radiance_cache.h"
#include "stages/core/cache/cache_reader.h"
#include "stages/core/sampling/streams.h"

namespace loom::app {
class Command;
class Report;
}  // namespace loom::app

namespace loom::learn {

enum class Method : std::uint8_t { points, grid };

/// A path graph with its clusters and its refined radiance.
struct LearnInput {
    PathGraph graph;
    Clusters clusters;
    Radiance radiance;
    InputId graph_id;
};

struct LearnOptions {
    Method method = Method::points;
    float smallest_roughness = 0.03f;  // of a surface that the cache covers
    std::uint64_t seed = 0;
    // Length of the training of a grid: a number of samples, rounded up to whole batches, or the CPU time. By time, two
    // runs learn different caches. Neither: default_samples() of the vertices.
    std::optional<std::uint64_t> samples;
    std::optional<double> seconds;
    int threads = 0;  // 0: all
};
/// Training samples of a grid without another length: each vertex twice, within limits. Longer training learns the noise
/// of the labels.
constexpr std::uint64_t default_samples(std::uint64_t n_vertices) {
    constexpr std::uint64_t fewest = std::uint64_t{1} << 20, most = std::uint64_t{1} << 25;
    return std::clamp(2 * n_vertices, fewest, most);
}

/// Share of the vertices that is held back to validate the cache.
inline constexpr double held_back_share = 0.01;
/// Whether a vertex of graph number `graph_idx` is held back.
inline bool is_held_back(std::uint64_t seed, std::size_t graph_idx, std::size_t vertex) {
    return streams::selection(streams::held_back(seed, graph_idx), vertex) < held_back_share;
}

/// Vertex as a query, and its outgoing radiance: what a cache learns.
struct Label {
    CacheQuery query;
    Spectrum L;
    std::uint16_t material_idx = 0;
};

/// Vertices that a cache prefers to learn from: first hits, whose light leaves towards a camera, on surfaces that send
/// different light in different directions; and everywhere where steps from zero counted bounces, as then only first hits
/// have as many as `max_depth` allows. On other surfaces all vertices are alike.
class PreferredVertices {
  public:
    explicit PreferredVertices(const LearnInput& input);
    bool operator()(std::size_t vertex, const Bsdf<float>& bsdf) const;

  private:
    std::vector<bool> is_first_;  // [vertex]
    bool counts_bounces_;
};

/// Returns the held-back vertices of clusters that the cache covers, preferred ones with finite radiance, graph by graph.
std::vector<Label> held_back_labels(const std::vector<LearnInput>& inputs, const LearnOptions& options);

/// Errors of a cache at labels.
struct Validation {
    RadianceCache::Validation by_material;
    double relative_l2 = 0, mean_ratio = 1;  // of all materials
    float median_distance = 0;               // to the nearest point
};
/// in:      materials  names
Validation validate(const CacheReader& reader, const std::vector<Label>& labels,
                    const std::vector<std::string>& materials, int threads);

/// Makes the cache of all inputs; the caller sets scene and provenance.
/// in:      report  shows the progress; null: nothing does
/// needs:   graphs of one scene
RadianceCache learn(const std::vector<LearnInput>& inputs, const LearnOptions& options, app::Report* report = nullptr);

struct Options {
    std::vector<std::string> files;  // path graphs, clusters and radiance, in any order
    std::string output;
    LearnOptions learn;
    bool plan = false;  // print the plan and stop
};

void declare(app::Command& command, Options& options);

/// throws: InputError
void run(const Options& options, app::Report& report);

}  // namespace loom::learn
