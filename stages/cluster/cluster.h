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

/// How vertices are put into clusters.
struct ClusterOptions {
    Method method = Method::balanced;
    std::uint32_t k = 16;               // balanced: largest cluster; centres: mean size
    std::uint32_t max_size = 0;         // of a cluster; 0: 2 k
    float normal_weight = 8;            // w of the metric, in cluster radii per unit of |dn|; 0: positions alone
    float private_roughness = 0.03f;    // narrower vertices are in no cluster
    std::uint64_t seed = 0;             // another one moves all borders
    int threads = 0;                    // 0: all
    const Scene* scene = nullptr;       // that the graph was traced in, for the test of visibility; null: no test
    const Scene* with_scene = nullptr;  // that of a second graph
};

/// Working memory, kept from call to call: a second pass then touches no fresh pages.
class Workspace {
  public:
    Workspace();
    ~Workspace();
    struct Parts;
    Parts& parts() { return *parts_; }
    std::uint64_t n_rays = 0;  // that the last call traced

  private:
    std::unique_ptr<Parts> parts_;
};

/// Puts every vertex that shares (SharingRule) into exactly one cluster.
///   balanced:  median splits down to at most k members
///   centres:   N/k random vertices, each other one to its nearest; larger than max_size: split by medians
/// With a normal weight, no cluster of either method holds two normals 90 degrees or more apart.
/// Clusters are numbered so that neighbours in number are neighbours in space; members ascend within a cluster.
/// Members of a cell that lie in different media, that are of one path, or that a surface of the scene hides from one
/// another, are put into clusters of their own (separate.h), so those can be smaller.
/// The result depends on graph and options, not on the number of threads. `graph` (the content hash) and the
/// provenance are left to who knows the file.
/// needs:   k >= 1, max_size 0 or >= k
/// differs: the paper uses a hash grid and positions alone, without limit of size     PG section 6
Clusters make_clusters(const PathGraph& graph, const ClusterOptions& options, Workspace& workspace);
Clusters make_clusters(const PathGraph& graph, const ClusterOptions& options);

/// The same cells for two graphs of nearly one scene, for the difference of what they say: what both have in common is
/// then shared alike in both, so that noise and blur of the difference are those of what differs.
///   balanced:  median splits of all vertices of both, down to at most k of either
///   centres:   one set of centres, drawn from both: one for k of each
/// Vertices of one place and normal are in the same cell, whichever graph they are of (unless more than k of one graph
/// lie there). A cell with vertices of one graph alone is in that graph's clusters only: the numbers of the two files
/// do not go together. The same graph twice gives the same clusters twice.
/// needs:   fewer than 2^32 - 1 vertices in both
struct JointClusters {
    Clusters first, second;
    std::uint64_t n_rays = 0;  // that were traced for both
};
JointClusters make_joint_clusters(const PathGraph& first, const PathGraph& second, const ClusterOptions& options);

struct Options {
    std::vector<std::string> graphs;  // path graphs (.h5)
    std::string output;               // clusters (.h5); % stands for the name of the graph, without its ending
    std::vector<std::string> with;    // for each graph another one in the same cells, or none for all
    std::string with_output;          // their clusters, named as output
    std::string scene, with_scene;    // scene files that the graphs were traced in
    std::vector<std::string> defines, with_defines;  // of those scenes, name=value
    std::string sensor;                              // of both scenes, id or number; empty: the first
    ClusterOptions cluster;
    bool plan = false;  // print the plan and stop
};

void declare(app::Command& command, Options& options);

/// What is on, what is off and why, in one line.
/// in:  with  another graph in the same cells, or null
std::string plan(const PathGraph& graph, const PathGraph* with, const ClusterOptions& options);

/// throws: InputError
void run(const Options& options, app::Report& report);

}  // namespace loom::cluster
