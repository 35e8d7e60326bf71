#include "stages/cluster/cluster.h"

#include <fmt/format.h>

#include <algorithm>
#include <numeric>
#include <stdexcept>
#include <vector>

#include "stages/cluster/median_splits.h"
#include "stages/cluster/metric.h"
#include "stages/cluster/nearest_centres.h"
#include "stages/cluster/pool.h"
#include "stages/cluster/scratch.h"
#include "stages/cluster/separate.h"
#include "stages/core/compute/parallel.h"
#include "stages/core/sampling/streams.h"
#include "stages/core/scene/scene.h"

namespace loom::cluster {

struct Workspace::Parts {
    Scratch<Point> points, centres;
    Scratch<std::uint32_t> bucket, nearest, slot;
    Scratch<std::uint64_t> media;
};

Workspace::Workspace() : parts_(std::make_unique<Parts>()) {}
Workspace::~Workspace() = default;

namespace {

/// Largest extent of a piece along each of three orthogonal axes of normals. Two of its normals are then at most 0.8
/// sqrt(3) < sqrt(2) apart, less than 90 degrees.
constexpr float normal_spread = 0.8f;

/// Vertices per task, and per separately counted part.
constexpr std::uint64_t vertices_per_chunk = 1 << 16;
/// A bucket fits into the second-level cache: 128 KiB of points.
constexpr std::size_t points_per_bucket = 4096;
constexpr std::uint32_t subset_per_bucket = 32;
constexpr std::size_t most_buckets = 1 << 15;
constexpr std::uint32_t no_bucket = 0xffffffffu;

std::size_t count_sharing(const Pool& pool, const ClusterOptions& options) {
    const std::size_t n = pool.size();
    std::vector<std::size_t> counts((n + vertices_per_chunk - 1) / vertices_per_chunk);
    parallel_chunks(n, vertices_per_chunk, options.threads,
                    [&](std::uint64_t chunk, std::uint64_t begin, std::uint64_t end) {
                        std::size_t count = 0;
                        for (std::uint64_t j = begin; j < end; ++j) count += pool.shares(j) ? 1 : 0;
                        counts[chunk] = count;
                    });
    return std::accumulate(counts.begin(), counts.end(), std::size_t{0});
}

/// All sharing vertices as points, ordered by bucket, in each bucket in the order of the pool.
struct BucketedPoints {
    std::span<Point> points;
    std::vector<std::size_t> first;  // bucket+1 offsets into points
};

BucketedPoints fill_buckets(const Pool& pool, std::size_t n_sharing, const Metric& metric,
                            const ClusterOptions& options, Workspace::Parts& memory) {
    const std::size_t n = pool.size();
    const std::size_t n_wanted = std::clamp<std::size_t>(n_sharing / points_per_bucket, 1, most_buckets);
    std::vector<Point> subset;
    const std::size_t n_subset = n_wanted == 1 ? 0 : n_wanted * subset_per_bucket;
    for (std::uint64_t i = 0; subset.size() < n_subset; ++i) {
        const std::size_t j = streams::subset(options.seed, i) % n;
        if (pool.shares(j)) subset.push_back(metric(j));
    }
    const Buckets buckets(subset, subset_per_bucket, options.seed);

    const std::size_t n_chunks = (n + vertices_per_chunk - 1) / vertices_per_chunk, n_buckets = buckets.size();
    const std::span<std::uint32_t> bucket_of = memory.bucket.get(n);
    std::vector<std::uint32_t> counts(n_chunks * n_buckets);
    parallel_chunks(n, vertices_per_chunk, options.threads,
                    [&](std::uint64_t chunk, std::uint64_t begin, std::uint64_t end) {
                        std::uint32_t* mine = counts.data() + chunk * n_buckets;
                        std::array<Point, Buckets::batch> batch{};
                        std::array<std::uint32_t, Buckets::batch> found;
                        std::size_t n_batch = 0;
                        const auto place_batch = [&] {
                            buckets.of(batch, found);
                            for (std::size_t i = 0; i < n_batch; ++i) {
                                bucket_of[batch[i].vertex] = found[i];
                                ++mine[found[i]];
                            }
                            n_batch = 0;
                        };
                        for (std::uint64_t j = begin; j < end; ++j) {
                            bucket_of[j] = no_bucket;
                            if (!pool.shares(j)) continue;
                            batch[n_batch++] = metric(j);
                            if (n_batch == Buckets::batch) place_batch();
                        }
                        place_batch();
                    });

    BucketedPoints out{memory.points.get(n_sharing), std::vector<std::size_t>(n_buckets + 1)};
    std::vector<std::size_t> places(n_chunks * n_buckets);
    std::size_t place = 0;
    for (std::size_t bucket = 0; bucket < n_buckets; ++bucket) {
        for (std::size_t chunk = 0; chunk < n_chunks; ++chunk) {
            places[chunk * n_buckets + bucket] = place;
            place += counts[chunk * n_buckets + bucket];
        }
        out.first[bucket + 1] = place;
    }
    // Recomputing a point is cheaper than storing it twice.
    parallel_chunks(n, vertices_per_chunk, options.threads,
                    [&](std::uint64_t chunk, std::uint64_t begin, std::uint64_t end) {
                        std::size_t* mine = places.data() + chunk * n_buckets;
                        for (std::uint64_t j = begin; j < end; ++j) {
                            if (bucket_of[j] == no_bucket) continue;
                            Point point = metric(j);
                            if (options.scene) point.ng = metric.geometric_normal(j);
                            out.points[mine[bucket_of[j]]++] = point;
                        }
                    });
    return out;
}

Splits with_seed(Splits splits, std::uint64_t seed) {
    splits.seed = seed;
    return splits;
}

/// Converts the cluster sizes of all tasks, in their order, to offsets.
std::vector<std::uint32_t> offsets_of(const std::vector<std::vector<std::uint32_t>>& sizes_of_tasks) {
    std::size_t n = 0;
    for (const auto& sizes : sizes_of_tasks) n += sizes.size();
    std::vector<std::uint32_t> first;
    first.reserve(n + 1);
    first.push_back(0);
    for (const auto& sizes : sizes_of_tasks)
        for (const std::uint32_t size : sizes) first.push_back(first.back() + size);
    return first;
}

/// Groups of vertices of a pool that may share light.
struct Cells {
    std::vector<std::uint32_t> first, member;
    Separation separation;
};

Separation added(const std::vector<Separation>& parts) {
    Separation sum;
    for (const Separation& part : parts) sum += part;
    return sum;
}

/// Separates while the points of a bucket are cached: in the order of the graph each point would touch its own page.
Cells balanced_cells(const BucketedPoints& in, const ClusterOptions& options, const Splits& splits,
                     const Separator& separator) {
    const std::size_t n_buckets = in.first.size() - 1;
    std::vector<std::vector<std::uint32_t>> sizes(n_buckets);
    std::vector<Separation> separations(n_buckets);
    std::vector<std::uint32_t> member(in.points.size());
    parallel_chunks(n_buckets, 1, options.threads, [&](std::uint64_t bucket, std::uint64_t, std::uint64_t) {
        const auto points = in.points.subspan(in.first[bucket], in.first[bucket + 1] - in.first[bucket]);
        sizes[bucket].reserve(points.size() / options.k * 5 / 4 + 1);
        split_by_medians(points, with_seed(splits, streams::part(options.seed, bucket)), sizes[bucket]);
        separator.cut(points, sizes[bucket], separations[bucket]);
        for (std::size_t i = 0; i < points.size(); ++i) member[in.first[bucket] + i] = points[i].vertex;
    });
    return {offsets_of(sizes), std::move(member), added(separations)};
}

/// Returns the bits of x with two zeros after each; x < 1024.
std::uint32_t spread_bits(std::uint32_t x) {
    x = (x | (x << 16)) & 0x030000ffu;
    x = (x | (x << 8)) & 0x0300f00fu;
    x = (x | (x << 4)) & 0x030c30c3u;
    return (x | (x << 2)) & 0x09249249u;
}

/// Sorts the points of one bucket along a Z-order curve through its own box.
void sort_along_curve(std::span<Point> points) {
    if (points.empty()) return;
    std::array<float, 3> low{}, high{}, scale{};
    for (std::size_t c = 0; c < 3; ++c) {
        low[c] = high[c] = points[0].x[c];
        for (const Point& p : points) {
            low[c] = std::min(low[c], p.x[c]);
            high[c] = std::max(high[c], p.x[c]);
        }
        scale[c] = high[c] > low[c] ? 1023 / (high[c] - low[c]) : 0;
    }
    std::vector<std::uint64_t> keys(points.size());
    for (std::size_t i = 0; i < points.size(); ++i) {
        std::uint32_t code = 0;
        for (std::size_t c = 0; c < 3; ++c)
            code |= spread_bits(std::min(std::uint32_t((points[i].x[c] - low[c]) * scale[c]), 1023u)) << c;
        keys[i] = std::uint64_t{code} << 32 | i;
    }
    std::sort(keys.begin(), keys.end());
    const std::vector<Point> before(points.begin(), points.end());
    for (std::size_t i = 0; i < points.size(); ++i) points[i] = before[std::uint32_t(keys[i])];
}

/// Selects n of the points in their order; all subsets of n are equally likely.
///                                              [Knuth1981] The Art of Computer Programming 2, 3.4.2, algorithm S
void select(std::span<const Point> points, std::span<Point> chosen, std::uint64_t seed) {
    std::size_t taken = 0;
    for (std::size_t i = 0; taken < chosen.size(); ++i) {
        const double u = streams::selection(seed, i);
        if (double(points.size() - i) * u < double(chosen.size() - taken)) chosen[taken++] = points[i];
    }
}

/// in: mean_size  of a cell;  splits  applied to cells that are too large
Cells centre_cells(const BucketedPoints& in, const ClusterOptions& options, std::uint32_t mean_size,
                   const Splits& splits, const Separator& separator, Workspace::Parts& memory) {
    const std::size_t n = in.points.size();
    parallel_chunks(in.first.size() - 1, 1, options.threads, [&](std::uint64_t bucket, std::uint64_t, std::uint64_t) {
        sort_along_curve(in.points.subspan(in.first[bucket], in.first[bucket + 1] - in.first[bucket]));
    });
    const std::size_t n_centres = (n + mean_size - 1) / mean_size;
    const std::span<Point> centres = memory.centres.get(n_centres);
    select(in.points, centres, options.seed);
    const std::span<std::uint32_t> nearest = memory.nearest.get(n);
    if (n > 0) nearest_centres(in.points, centres, options.normal_weight > 0 ? 6 : 3, options.threads, nearest);

    std::vector<std::uint32_t> first(n_centres + 1);
    for (const std::uint32_t centre : nearest) ++first[centre + 1];
    std::partial_sum(first.begin(), first.end(), first.begin());
    std::vector<std::uint32_t> next(first.begin(), first.end());
    const std::span<std::uint32_t> slot = memory.slot.get(n);
    for (std::size_t i = 0; i < n; ++i) slot[next[nearest[i]]++] = std::uint32_t(i);

    constexpr std::size_t centres_per_chunk = 1024;
    const std::size_t n_chunks = (n_centres + centres_per_chunk - 1) / centres_per_chunk;
    std::vector<std::vector<std::uint32_t>> sizes(n_chunks);
    std::vector<Separation> separations(n_chunks);
    std::vector<std::uint32_t> member(n);
    parallel_chunks(n_centres, centres_per_chunk, options.threads,
                    [&](std::uint64_t chunk, std::uint64_t begin, std::uint64_t end) {
                        std::vector<Point> points;
                        std::vector<std::uint32_t> of_centre;
                        for (std::uint64_t centre = begin; centre < end; ++centre) {
                            points.clear();
                            for (std::uint32_t i = first[centre]; i < first[centre + 1]; ++i)
                                points.push_back(in.points[slot[i]]);
                            of_centre.clear();
                            split_by_medians(points, with_seed(splits, streams::part(options.seed, centre)), of_centre);
                            separator.cut(points, of_centre, separations[chunk]);
                            sizes[chunk].insert(sizes[chunk].end(), of_centre.begin(), of_centre.end());
                            for (std::size_t i = 0; i < points.size(); ++i)
                                member[first[centre] + i] = points[i].vertex;
                        }
                    });
    return {offsets_of(sizes), std::move(member), added(separations)};
}

struct PooledCells {
    Cells cells;
    Clusters::Settings settings;
};

PooledCells make_cells(const Pool& pool, const ClusterOptions& options, Workspace::Parts& memory) {
    const std::uint32_t n_graphs = pool.joint() ? 2 : 1;
    const std::size_t n_sharing = count_sharing(pool, options);
    const float length_scale = typical_radius(pool, n_sharing, n_graphs * options.k);
    const std::uint32_t max_size = options.max_size == 0 ? 2 * options.k : options.max_size;
    const Metric metric(pool, length_scale, options.normal_weight, options.seed);
    const BucketedPoints points = fill_buckets(pool, n_sharing, metric, options, memory);
    Splits splits;
    if (options.normal_weight > 0) splits.normal_spread = normal_spread * options.normal_weight;
    if (pool.joint()) splits.second_graph = std::uint32_t(pool.n_first());
    splits.k = options.method == Method::balanced ? options.k : max_size;
    const auto rays = [](const Scene* scene) { return scene ? scene->rays.get() : nullptr; };
    const Separator separator(pool, metric, rays(options.scene), rays(options.with_scene), options.threads,
                              memory.media);
    Cells cells = options.method == Method::balanced
                      ? balanced_cells(points, options, splits, separator)
                      : centre_cells(points, options, n_graphs * options.k, splits, separator, memory);
    cells.separation.tested_visibility = options.scene != nullptr;
    return {std::move(cells),
            {std::string(method_name(options.method)), options.k, max_size, options.normal_weight, length_scale,
             options.private_roughness, options.seed}};
}

void set_separation(Clusters& clusters, const Separation& separation) {
    clusters.separation.other_media = {separation.n_media};
    clusters.separation.same_path = {separation.n_same_path};
    if (separation.tested_visibility) clusters.separation.occluded = {separation.n_occluded};
}

/// Makes clusters of one graph from the members of each cell that are vertices [begin, end) of the pool.
Clusters clusters_within(const PooledCells& pooled, std::size_t begin, std::size_t end) {
    std::vector<std::uint32_t> first{0}, member;
    for (std::size_t c = 0; c + 1 < pooled.cells.first.size(); ++c) {
        for (std::uint32_t i = pooled.cells.first[c]; i < pooled.cells.first[c + 1]; ++i)
            if (const std::uint32_t vertex = pooled.cells.member[i]; vertex >= begin && vertex < end)
                member.push_back(std::uint32_t(vertex - begin));
        if (member.size() > first.back()) first.push_back(std::uint32_t(member.size()));
    }
    Clusters out;
    out.graph_vertices = end - begin;
    out.settings = pooled.settings;
    set_separation(out, pooled.cells.separation);
    out.first = std::move(first);
    out.member = std::move(member);
    return out;
}

}  // namespace

std::string_view method_name(Method method) {
    return method == Method::balanced ? "balanced" : "centres";
}

Clusters make_clusters(const PathGraph& graph, const ClusterOptions& options, Workspace& workspace) {
    PooledCells pooled = make_cells(Pool(graph, nullptr, options.private_roughness), options, workspace.parts());
    workspace.n_rays = pooled.cells.separation.n_rays;
    Clusters out;
    out.graph_vertices = graph.n_vertices();
    out.settings = std::move(pooled.settings);
    set_separation(out, pooled.cells.separation);
    out.first = std::move(pooled.cells.first);
    out.member = std::move(pooled.cells.member);
    return out;
}

Clusters make_clusters(const PathGraph& graph, const ClusterOptions& options) {
    Workspace workspace;
    return make_clusters(graph, options, workspace);
}

JointClusters make_joint_clusters(const PathGraph& first, const PathGraph& second, const ClusterOptions& options) {
    const std::size_t n_first = first.n_vertices(), n = n_first + second.n_vertices();
    if (n >= Splits::no_second) throw std::logic_error("make_joint_clusters: too many vertices");
    Workspace workspace;
    const PooledCells pooled = make_cells(Pool(first, &second, options.private_roughness), options, workspace.parts());
    return {clusters_within(pooled, 0, n_first), clusters_within(pooled, n_first, n), pooled.cells.separation.n_rays};
}

std::string plan(const PathGraph& graph, const PathGraph* with, const ClusterOptions& options) {
    const Pool pool(graph, with, options.private_roughness);
    const std::size_t n_solitary = pool.size() - count_sharing(pool, options);
    std::string on = options.method == Method::balanced ? "median splits" : "nearest of random centres", off;
    (options.normal_weight > 0 ? on : off) += options.normal_weight > 0 ? ", normals" : "normals (weight 0)";
    if (with) on += ", cells of two graphs";
    std::string& visibility = options.scene ? on : off;
    visibility += std::string(visibility.empty() ? "" : ", ") +
                  (options.scene ? "visibility of members" : "visibility of members (no --scene)");
    if (n_solitary == 0)
        off += std::string(off.empty() ? "" : ", ") + "solitary vertices (all share)";
    else
        on += fmt::format(", {} solitary vertices", n_solitary);
    return "on: " + on + "; off: " + (off.empty() ? "nothing" : off);
}

}  // namespace loom::cluster
