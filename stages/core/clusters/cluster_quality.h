#pragma once
#include <string>

#include "formats/clusters.h"
#include "formats/path_graph.h"

namespace loom {

/// Figures that rate a way to cluster.
struct ClusterSizes {
    std::size_t n_clusters = 0, n_members = 0, min = 0, median = 0, p99 = 0, max = 0;
    double mean = 0;
    double size_weighted_mean = 0;  // mean size of the cluster of a random member: the cost of aggregation per vertex
};
ClusterSizes cluster_sizes(const Clusters& clusters);
std::string text_of(const ClusterSizes& sizes);  // one line

struct ClusterSpread {
    std::size_t n_members = 0;    // members that were examined
    double mean_distance = 0;     // m, mean distance from a member to the centroid of its cluster
    double median_radius = 0;     // m, median over clusters of the root mean square distance to the centroid
    double share_off_normal = 0;  // share of members whose normal is more than 26 degrees off the mean one
    double share_opposed = 0;     // share of members that face away from the mean normal
};
/// Examines every cluster, or an even selection of at most `max_clusters` (0: no limit). Normals are the shading
/// normals on the side of wo.
ClusterSpread cluster_spread(const PathGraph& graph, const Clusters& clusters, std::size_t max_clusters = 0);
std::string text_of(const ClusterSpread& spread);  // one line

/// Describes what was separated, and what was not tested.
std::string text_of(const Clusters::Separation& separation);

}  // namespace loom
