#pragma once
// Makes a path graph, its clusters and its radiance from a scene within one process, as the stages make them from
// files. For tests of single steps.

#include <fmt/format.h>
#include <unistd.h>

#include <atomic>
#include <filesystem>
#include <fstream>
#include <memory>
#include <mutex>
#include <string>

#include "stages/cluster/cluster.h"
#include "stages/core/app/report.h"
#include "stages/core/scene/build.h"
#include "stages/refine/refine.h"
#include "stages/trace/trace.h"

namespace loom::testing {

inline std::filesystem::path scratch_file(const char* ending) {
    static std::atomic<int> n{0};
    return std::filesystem::temp_directory_path() / fmt::format("loom-{}-{}{}", getpid(), n++, ending);
}

/// Loads a scene file of the project.
inline std::unique_ptr<Scene> own_scene(const std::string& name, int width, int height, Defines defines = {}) {
    defines.emplace_back("resx", std::to_string(width));
    defines.emplace_back("resy", std::to_string(height));
    return load_scene(std::filesystem::path(LOOM_SOURCE_DIR) / "scenes" / name, defines);
}

/// A scene of shapes, emitters and one sensor without its film; box filter.
struct InlineScene {
    std::string sensor;  // type="…" of the sensor, then its parameters
    std::string body;    // BSDFs, shapes, emitters
    int width = 16, height = 16;
    int max_depth = -1;
};

inline std::unique_ptr<Scene> load_inline(const InlineScene& s) {
    const auto file = scratch_file(".xml");
    std::ofstream(file) << fmt::format(
        R"(<scene version="3.0.0"><integrator type="path"><integer name="max_depth" value="{}"/></integrator>
<sensor {}<film type="hdrfilm"><integer name="width" value="{}"/><integer name="height" value="{}"/><rfilter type="box"/></film></sensor>
{}
</scene>)",
        s.max_depth, s.sensor, s.width, s.height, s.body);
    auto scene = load_scene(file);
    std::filesystem::remove(file);
    return scene;
}

inline PathOptions path_options(const Scene& scene, std::uint64_t seed,
                                SamplerKind sampler = SamplerKind::independent) {
    PathOptions path;
    path.seed = seed;
    path.sampler = sampler;
    path.rr_depth = scene.rr_depth;
    path.max_depth = scene.max_depth;
    return path;
}

/// Returns the graph written and read again, so that all invariants of the format hold.
inline PathGraph trace_graph(const Scene& scene, const PathOptions& path, std::uint64_t spp,
                             std::uint64_t first_sample = 0, const OptionalColumns& columns = {}) {
    app::Report report;
    report.set_quiet(true);
    trace::Counts counts;
    const auto file = scratch_file(".h5");
    const auto traced =
        trace::render_graph(scene, path, {first_sample, spp, 0}, report, counts, std::make_shared<Arena>(), columns);
    static std::mutex hdf5_one_at_a_time;  // tests call this from many threads
    const std::lock_guard lock(hdf5_one_at_a_time);
    write_path_graph(traced, file, Sync::no);
    PathGraph graph = read_path_graph(file);
    std::filesystem::remove(file);  // the mapping keeps its bytes
    return graph;
}

/// in:  scene  scene of the graph, for visibility tests; null: no test
inline Clusters clusters_of(const PathGraph& graph, std::uint32_t k, std::uint64_t seed = 0,
                            float private_roughness = 0.03f, const Scene* scene = nullptr) {
    cluster::ClusterOptions options;
    options.k = k;
    options.seed = seed;
    options.private_roughness = private_roughness;
    options.scene = scene;
    return cluster::make_clusters(graph, options);
}

inline Radiance radiance_of(const PathGraph& graph, const Clusters& clusters, const refine::Options& options = {}) {
    app::Report report;
    report.set_quiet(true);
    return refine::refine_radiance(graph, clusters, options, report);
}

}  // namespace loom::testing
