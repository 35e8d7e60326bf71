#pragma once
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "formats/clusters.h"
#include "formats/path_graph.h"

namespace loom {
struct Scene;
}

namespace loom::app {
class Command;
class Report;
}  // namespace loom::app

namespace loom::cluster {

enum class Method : std::uint8_t { balanced, centres };
std::string_view method_name(Method method);

/// Options of clustering.
struct ClusterOptions {
    Method method = Method::balanced;
    std::uint32_t k = 16;               // balanced: largest cluster; centres: mean size
    std::uint32_t max_size = 0;         // largest size of a cluster; 0: 2 k
    float normal_weight = 8;            // w of the metric, in cluster radii per unit of |dn|; 0: positions alone
    float private_roughness = 0.03f;    // smallest roughness in a cluster; smoother vertices are solitary
    std::uint64_t seed = 0;             // another seed moves all borders of cells
    int threads = 0;                    // 0: all
    const Scene* scene = nullptr;       // scene of the graph, for visibility tests; null: no test
    const Scene* with_scene = nullptr;  // scene of the second graph
};

/// Working memory that is reused between calls, so that a second pass first-touches no pages.
class Workspace {
  public:
    Workspace();
    ~Workspace();
    struct Parts;
    Parts& parts() { return *parts_; }
    std::uint64_t n_rays = 0;  // rays traced by the last call

  private:
    std::unique_ptr<Parts> parts_;
};

/// Assigns every vertex that shares (SharingRule) to exactly one cluster.
///   balanced:  median splits down to at most k members
///   centres:   N/k random centres, every other vertex to its nearest one; cells above max_size are split by medians
/// With a normal weight, no cluster of either method contains two normals 90 degrees or more apart. Clusters with
/// neighbouring numbers are neighbours in space; members ascend within a cluster. Members of a cell in different media,
/// of one path, or occluded from each other are moved to clusters of their own (separate.h), which can be smaller.
/// The result depends on graph and options, not on the number of threads. The caller, who has the file, sets `graph`
/// (the content hash) and the provenance.
/// needs:   k >= 1, max_size 0 or >= k
/// differs: the paper uses a hash grid and positions alone, without limit of size     PG section 6
Clusters make_clusters(const PathGraph& graph, const ClusterOptions& options, Workspace& workspace);
Clusters make_clusters(const PathGraph& graph, const ClusterOptions& options);

/// Clusters of two graphs of nearly the same scene with common cells, for the difference of their images. Parts common
/// to both graphs are then shared alike in both. The difference has noise and blur only from the parts that differ.
///   balanced:  median splits of all vertices of both graphs, down to at most k of either
///   centres:   one set of centres, drawn from both: one per k vertices of each
/// Vertices with equal position and normal are in the same cell, from either graph (unless more than k of one graph lie
/// there). A cell with vertices of one graph alone appears in that graph's clusters only, so cluster numbers of the two
/// files do not correspond. Two equal graphs give equal clusters.
/// needs:   fewer than 2^32 - 1 vertices in both together
struct JointClusters {
    Clusters first, second;
    std::uint64_t n_rays = 0;  // rays traced for both
};
JointClusters make_joint_clusters(const PathGraph& first, const PathGraph& second, const ClusterOptions& options);

struct Options {
    std::vector<std::string> graphs;  // path graphs (.h5)
    std::string output;               // clusters (.h5); % stands for the name of the graph without its ending
    std::vector<std::string> with;    // per graph, a second graph with common cells; empty: none
    std::string with_output;          // clusters of the second graphs, named like `output`
    std::string scene, with_scene;    // scene files of the graphs
    std::vector<std::string> defines, with_defines;  // of those scenes, name=value
    std::string absent;                              // in that table, value of a parameter whose shapes a frame lacks
    std::string static_frames;                       // table of frames: `scene` stands for what they share
    std::string sensor;                              // of both scenes, id or index; empty: the first
    ClusterOptions cluster;
    bool plan = false;  // print the plan and stop
};

void declare(app::Command& command, Options& options);

/// Describes in one line which features are on or off, and why.
/// in:  with  second graph with common cells, or null
std::string plan(const PathGraph& graph, const PathGraph* with, const ClusterOptions& options);

/// throws: InputError
void run(const Options& options, app::Report& report);

}  // namespace loom::cluster
