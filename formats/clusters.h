#pragma once
// clusters: which vertices of a path graph share their samples.
//
// A cluster is a set of vertices that are close in position and normal. Its rows are a run of `clusters/member`. A
// vertex is in at most one cluster. A vertex without a cluster ("solitary") has scattering too narrow to use a
// neighbour's sample.

#include <cstdint>
#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include "formats/io/documenter.h"
#include "formats/io/field.h"
#include "formats/io/mapped_file.h"
#include "formats/io/output_file.h"
#include "formats/io/provenance.h"

namespace loom {

struct PathGraph;

struct Clusters {
    static constexpr FormatId format{"clusters", 1, 2};

    std::string graph;                 // content hash of the path graph, as in Provenance::inputs
    std::uint64_t graph_vertices = 0;  // vertices of that graph

    struct Settings {
        std::string method = "balanced";  // or "centres"
        std::uint32_t k = 16, max_size = 32;
        float normal_weight = 0, length_scale = 1;
        float private_roughness = 0.03f;
        std::uint64_t seed = 0;
    } settings;

    // Numbers of vertices that were separated although close in position and normal; empty in files of version 1.0.
    struct Separation {
        Column<std::uint64_t> other_media;
        Column<std::uint64_t> same_path;  // empty in files of version 1.1
        Column<std::uint64_t> occluded;   // empty: visibility was not tested
    } separation;

    Column<std::uint32_t> first;   // cluster+1 offsets into member
    Column<std::uint32_t> member;  // rows of the graph's vertices, ordered by cluster

    Provenance provenance;
    std::shared_ptr<const MappedFile> storage;  // memory that the columns borrow; null when they own it

    std::size_t n_clusters() const { return first.empty() ? 0 : first.size() - 1; }
    std::size_t n_members() const { return member.size(); }

    /// Checks the invariants beyond types, lengths and finite floats. Returns the first violation; empty when all hold.
    std::string problem() const;

    template <class Self, class Visitor>
    static void fields(Self& c, Visitor& v);
};

/// needs:   columns that share an axis have the same length
void write_clusters(const Clusters& clusters, const std::filesystem::path& path, Sync sync = Sync::yes);
/// Reads, maps and checks the whole file.
/// throws:  InputError naming the file and the dataset
Clusters read_clusters(const std::filesystem::path& path);

inline constexpr std::uint32_t no_cluster = 0xffffffffu;
/// Returns the cluster of each vertex of the graph; no_cluster for solitary vertices.
std::vector<std::uint32_t> cluster_of_vertices(const Clusters& clusters);

/// Refuses clusters of another graph than `graph`, whose content is `graph_id`.
/// throws:  InputError naming both files and the command that makes matching clusters
void require_clusters_of(const PathGraph& graph, const InputId& graph_id, const Clusters& clusters,
                         const std::filesystem::path& clusters_path);

template <class Self, class Visitor>
void Clusters::fields(Self& c, Visitor& v) {
    v.value("graph/hash", c.graph, "", "1", "content hash (XXH64, 16 hexadecimal digits) of the path graph");
    v.value("graph/n_vertices", c.graph_vertices, "", "1", "vertices of the path graph");

    auto& s = c.settings;
    v.value("settings/method", s.method, "", "1",
            "balanced: median splits; centres: each vertex to the nearest of randomly chosen vertices");
    v.value("settings/k", s.k, "", "1", "balanced: largest cluster; centres: mean size of a cluster");
    v.value("settings/max_size", s.max_size, "", "1", "size of the largest allowed cluster");
    v.value("settings/normal_weight", s.normal_weight, "", "1",
            "weight w of normals in distance^2 = (dp / s)^2 + (w dn)^2 between positions p and shading normals n on "
            "the side of wo");
    v.value("settings/length_scale", s.length_scale, "", "m", "length scale s in distance^2");
    v.value("settings/private_roughness", s.private_roughness, "", "1",
            "smallest microfacet roughness of a vertex in a cluster");
    v.value("settings/seed", s.seed, "", "1", "seed of the random choices of this pass");

    v.optional("separation/other_media", c.separation.other_media, 1, "one", "1",
               "vertices separated from their cell because they lie in another medium; absent: not tested");
    v.optional("separation/same_path", c.separation.same_path, 1, "one", "1",
               "vertices separated from their cell because another vertex of their path is in it; absent: not tested");
    v.optional("separation/occluded", c.separation.occluded, 1, "one", "1",
               "vertices separated from their cell because they are occluded from its middle; absent: not tested");

    v.field("clusters/first", c.first, 1, "cluster+1", "1",
            "offsets into clusters/member; neighbouring clusters lie close in space");
    v.field("clusters/member", c.member, 1, "member", "1",
            "row of the graph's vertices; vertices in no cluster are solitary: their scattering is all delta "
            "or nearly specular");
}

}  // namespace loom
