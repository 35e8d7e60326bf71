#pragma once
// The linear system of a path graph, X = M X + B: X is the radiance that each vertex reflects along its path, B what
// it reflects of light that arrives directly, M what neighbouring vertices pass on from vertex to vertex.
//                              PG section 4
//
// Clusters pool their samples: M is never built, but as one block of coefficients per cluster (a row for each vertex,
// a column for each continuation), followed by the step along each continuation. The block of a flat matte cluster is
// of rank one (flat_columns.h): an albedo for each vertex times a weight for each continuation. Where all coats are
// grey a coefficient is tint * base + coat, with a tint for each vertex, and base and coat have no colour; seen from
// one side of one normal the base is of rank one too.

#include "formats/clusters.h"
#include "stages/core/clusters/cluster_edges.h"
#include "stages/core/compute/huge_array.h"

namespace loom::refine {

/// What keeps the iteration from growing. Light is counted as basic radiance, L / eta^2 with the index of the medium
/// it travels in: where it leaves glass its radiance changes by eta^2 and its energy does not.       [Veach1997] 5.2
enum class Clamp {
    none,
    column,   // once: no edge gives more than (1 - epsilon) of the light that it brings; linear
    cluster,  // every cluster and iteration: no cluster gives more than (1 - epsilon) of what it takes in, as the paper
};

struct SystemOptions {
    SharingOptions sharing;
    Clamp clamp = Clamp::column;
    float epsilon = 1e-4f;
    int threads = 0;
};

/// Four floats in one cache line's quarter: radiance is gathered at random.
struct alignas(16) Light {
    float r = 0, g = 0, b = 0, unused = 0;
};

/// Unknowns are numbered cluster by cluster (lane by lane), solitary vertices last.
struct System {
    static constexpr std::uint32_t nothing = 0xffffffffu;

    std::size_t n_unknowns = 0, n_clusters = 0;
    HugeArray<std::uint32_t> unknown;  // of a vertex
    /// Of an unknown, in one line of the cache.
    struct alignas(64) Row {
        Light B;
        Light albedo;  // in flat clusters
        Light X;       // what path tracing knows: of light by its own samples; then, by path_radiance(), of all
        Light weight;  // of its own continuation
    };
    HugeArray<Row> at;

    // Clusters. Cluster c has unknowns first[c] to first[c+1]; its edge i is in slot first[c] + i.
    std::vector<std::uint32_t> first;
    std::vector<std::uint16_t> n_edges;
    struct Shape {
        bool flat = false;        // of rank one: no block
        bool base = false;        // tint times a number of the edge,
        bool base_plane = false;  // and of the vertex
        bool coat = false;
        bool channels() const { return !flat && !base && !coat; }
        int n_scales() const { return flat ? 0 : channels() ? 3 : base + coat; }
        int n_planes() const { return flat ? 0 : channels() ? 3 : base_plane + coat; }
        std::size_t bytes(int n_edges, int lanes) const {
            return sizeof(float) * std::size_t(n_edges * n_scales() + (base ? 3 * lanes : 0)) +
                   sizeof(std::uint16_t) * std::size_t(n_edges * n_planes()) * std::size_t(lanes);
        }
    };
    std::vector<Shape> shape;
    struct Edge {
        float weight;       // flat: times the albedo of each unknown
        std::uint32_t end;  // unknown that the light comes from
    };
    HugeArray<Edge> edges;             // by slot
    std::vector<std::uint64_t> block;  // where it starts, in bytes; differs from run to run
    HugeArray<std::byte> blocks;
    HugeArray<float> edge_survival;  // by slot, times eta^2 of the edge; empty unless the clamp asks for it
    HugeArray<float> inv_eta2;       // by unknown, on the side of wo; empty unless the clamp asks for it
    /// Numbers and 16-bit fractions of them.
    template <class Byte>
    struct BlockAt {
        template <class T>
        using As = std::conditional_t<std::is_const_v<Byte>, const T, T>;
        As<float>*scale, *tint;       // [edge][rgb, or base and coat]; [rgb][padded lane], if there is a base
        As<std::uint16_t>* fraction;  // [edge][rgb, or base_plane and coat][padded lane]

        BlockAt(Byte* at, const Shape& shape, int n_edges, int lanes)
            : scale(reinterpret_cast<As<float>*>(at)),
              tint(scale + n_edges * shape.n_scales()),
              fraction(reinterpret_cast<As<std::uint16_t>*>(tint + (shape.base ? 3 * lanes : 0))) {}
    };
    BlockAt<const std::byte> block_of(std::size_t c) const {
        return {blocks.data() + block[c], shape[c], n_edges[c], lanes(c)};
    }
    int lanes(std::size_t c) const { return padded_lanes(int(first[c + 1] - first[c])); }

    /// Continuations that only their own vertex uses: delta lobes, solitary vertices.
    struct Private {
        std::uint32_t unknown, end;
        Spectrum weight;
    };
    std::vector<Private> privates;

    /// Columns that the clamp scaled, and the share of the coefficients' sum that it took.
    std::uint64_t n_clamped = 0, n_columns = 0;
    double clamped_share = 0;
    float largest_column_sum = 0;  // before the clamp, of basic radiance, survival counted: the bound of the spectrum

    /// What the vertex in a lane of cluster c reflects of the light of edge i.
    Spectrum coefficient(std::size_t c, int i, int lane) const;
};

/// Evaluates all clusters once: direct light and blocks.
/// needs:   clusters of this graph, of at most max_lanes vertices
System build_system(const PathGraph& graph, const Clusters& clusters, const SystemOptions& options);

/// Makes each X what the vertex reflects along its path by that path's own samples: all that path tracing knows.
/// out:     by path: of the first vertex, without the light that reaches it straight
/// needs:   to be called once
HugeArray<Light> path_radiance(System& system, const PathGraph& graph, int threads);

/// What each vertex reflects along its path by that path's own samples, by vertex: the plain twin of the above.
HugeArray<Light> path_radiance(const GraphReader& reader, int threads, Heuristic heuristic = Heuristic::power);

}  // namespace loom::refine
