#pragma once
// The linear system of a path graph, X = M X + B. X is the radiance that each vertex reflects along its path, B its
// part from direct light, M the transport between neighbouring vertices.
//                              PG section 4
//
// Clusters pool their samples. M is never built as a whole. It is one block of coefficients per cluster (a row for each
// vertex, a column for each continuation), followed by the step along each continuation. The block of a flat diffuse
// cluster has rank one (flat_columns.h): an albedo for each vertex times a weight for each continuation. Where all
// coats are grey a coefficient is tint * base + coat, with a tint for each vertex; base and coat have no colour. On one
// side of one normal the base has rank one too.

#include "formats/clusters.h"
#include "stages/core/clusters/cluster_edges.h"
#include "stages/core/compute/huge_array.h"

namespace loom::refine {

/// Bound that keeps the iteration from growing. Light is counted as basic radiance, L / eta^2 with the index of its
/// medium: where light leaves glass its radiance changes by eta^2 but its energy does not.       [Veach1997] 5.2
enum class Clamp {
    none,
    column,   // once: no edge transports more than (1 - epsilon) of its light; linear
    cluster,  // each cluster and iteration: output at most (1 - epsilon) of the input, as in the paper
};

struct SystemOptions {
    SharingOptions sharing;
    Clamp clamp = Clamp::column;
    float epsilon = 1e-4f;
    int threads = 0;
};

/// Four floats, a quarter of a cache line: radiance is gathered in random order.
struct alignas(16) Light {
    float r = 0, g = 0, b = 0, unused = 0;
};

/// Unknowns are numbered cluster by cluster (lane by lane), solitary vertices last.
struct System {
    static constexpr std::uint32_t nothing = 0xffffffffu;

    std::size_t n_unknowns = 0, n_clusters = 0;
    HugeArray<std::uint32_t> unknown;  // [vertex]
    /// State of one unknown, in one cache line.
    struct alignas(64) Row {
        Light B;
        Light albedo;  // in flat clusters
        Light X;       // estimate of path tracing: direct light of its own samples; after path_radiance() all light
        Light weight;  // of its own continuation
    };
    HugeArray<Row> at;

    // Clusters. Cluster c has unknowns first[c] to first[c+1]; its edge i is in slot first[c] + i.
    std::vector<std::uint32_t> first;
    std::vector<std::uint16_t> n_edges;
    struct Shape {
        bool flat = false;        // rank one: no block
        bool base = false;        // tint times a factor of the edge,
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
        std::uint32_t end;  // unknown at the edge's end, the source of its light
    };
    HugeArray<Edge> edges;             // [slot]
    std::vector<std::uint64_t> block;  // start in bytes; differs from run to run
    HugeArray<std::byte> blocks;
    HugeArray<float> edge_survival;  // [slot] times eta^2 of the edge; empty unless the clamp needs it
    HugeArray<float> inv_eta2;       // [unknown] on the side of wo; empty unless the clamp needs it
    /// Scales, and 16-bit fractions of them.
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

    /// Columns scaled by the clamp, and the clamped share of the coefficients' sum.
    std::uint64_t n_clamped = 0, n_columns = 0;
    double clamped_share = 0;
    float largest_column_sum = 0;  // before the clamp, of basic radiance, with survival: bounds the spectral radius

    /// Returns the coefficient of edge i for the vertex in a lane of cluster c.
    Spectrum coefficient(std::size_t c, int i, int lane) const;
};

/// Evaluates all clusters once: direct light and blocks.
/// needs:   clusters of this graph, of at most max_lanes vertices
System build_system(const PathGraph& graph, const Clusters& clusters, const SystemOptions& options);

/// Sets each X to the radiance reflected along the path by that path's own samples: the estimate of path tracing.
/// out:     [path] radiance of the first vertex without its direct light
/// needs:   must be called once only
HugeArray<Light> path_radiance(System& system, const PathGraph& graph, int threads);

/// Returns the radiance that each vertex reflects along its path by that path's own samples, [vertex]; the simple
/// version of the function above.
HugeArray<Light> path_radiance(const GraphReader& reader, int threads, Heuristic heuristic = Heuristic::power);

}  // namespace loom::refine
