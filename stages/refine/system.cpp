#include "stages/refine/system.h"

#include <algorithm>
#include <atomic>
#include <cmath>

#include "stages/core/compute/parallel.h"
#include "stages/refine/flat_cluster.h"

namespace loom::refine {
namespace {

constexpr std::uint64_t clusters_per_chunk = 1024;

struct Lanes {
    alignas(64) float r[max_lanes + lane_block], g[max_lanes + lane_block], b[max_lanes + lane_block];
    float inv_eta2[max_lanes + lane_block];
    // inv_eta2 times survival of roulette; 0 where no BSDF sample was drawn.
    float clamp_weight[max_lanes + lane_block];
    // clamp_weight for ends without a cluster: 0 also where they are no technique.
    float clamp_weight_alone[max_lanes + lane_block];
};

/// Sums of one chunk; chunks are added in order.
struct ChunkResult {
    std::vector<System::Private> privates;
    std::uint64_t n_clamped = 0, n_columns = 0;
    double sum = 0, taken = 0;
    float largest = 0;
};

struct Builder {
    const PathGraph& graph;
    const GraphReader& reader;
    const Clusters& clusters;
    const SystemOptions& options;
    std::span<const std::uint32_t> offsets;  // of light edges
    System& system;
    /// Whether flat clusters and split coefficients are used. They require that a coefficient has rank one. This does
    /// not hold for points instead of directions, nor where successes are counted. The clamp by cluster needs the light
    /// of each edge separately.
    bool rank_one =
        options.sharing.reuse == Reuse::directions && !options.sharing.as_printed && options.clamp != Clamp::cluster;
    std::atomic<std::uint64_t> n_bytes = 0;  // of allocated blocks

    std::span<const std::uint32_t> members(std::size_t c) const {
        return clusters.member.values().subspan(system.first[c], system.first[c + 1] - system.first[c]);
    }
    /// Returns the squared index of the medium in which the path continues from vertex j.
    float eta2_of_next(const VertexRow& row, std::size_t j) const {
        return sqr(row.bits & vertex_bit::other_medium ? graph.vertices.eta[j + 1] : row.eta);
    }

    /// Adds one column of a block: f_j cos_j / rho at all vertices of the cluster, in 16 bits of its largest value.
    /// in:      clamp_weight  [lane]
    ///          edge_eta2     squared index of the medium that the light crosses
    void add_column(const ClusterShading& shading, const float* clamp_weight, float edge_eta2, float* scale,
                    std::uint16_t* out, float inv_rho, ChunkResult& result) const {
        float sum[3];
        shading.fix_row(clamp_weight, out, scale, sum);
        for (int channel = 0; channel < 3; ++channel) {
            sum[channel] *= edge_eta2 * inv_rho;
            scale[channel] *= inv_rho * (1.0f / 65535.0f);
        }
        const float factor = clamped({sum[0], sum[1], sum[2]}, result);
        for (int channel = 0; channel < 3; ++channel) scale[channel] *= factor;
    }

    /// Adds one column split into base and coat.
    void add_split_column(const ClusterShading& shading, const System::Shape& shape, const float* clamp_weight,
                          float edge_eta2, float* scale, std::uint16_t* out, float inv_rho, ChunkResult& result) const {
        float largest[2], sum[3];
        shading.fix_lobes(shape.base_plane, shape.coat, clamp_weight, out, largest, sum);
        for (float& s : sum) s *= edge_eta2 * inv_rho;
        const float unit = inv_rho * clamped({sum[0], sum[1], sum[2]}, result);
        if (shape.base)
            *scale++ = unit * (shape.base_plane ? largest[0] * (1.0f / 65535.0f) : shading.columns().base[0]);
        if (shape.coat) *scale = unit * (largest[1] * (1.0f / 65535.0f));
    }

    System::Shape shape_of(const ClusterShading& shading) const {
        const ClusterShading::Lobes& lobes = shading.lobes();
        if (!rank_one || !lobes.split) return {};
        return {.base = lobes.base, .base_plane = lobes.base && !lobes.one_base, .coat = lobes.coat};
    }

    /// Returns the clamp factor of a column from its sums of basic radiance. Each vertex is weighted with its survival
    /// of roulette, as in the density that divides the column. Where no BSDF reflects more than it receives, no sum is
    /// above 1. Vertices at the depth limit drew no sample and do not count: their light is not propagated.
    float clamped(const Spectrum& sum, ChunkResult& result) const {
        const float most = std::max({sum.r, sum.g, sum.b}), total = sum.r + sum.g + sum.b;
        const float bound = 1 - options.epsilon;
        float factor = 1;
        if (options.clamp == Clamp::column && most > bound) {
            factor = bound / most;
            ++result.n_clamped;
            result.taken += double(total) * (1 - factor);
        }
        ++result.n_columns;
        result.sum += total;
        result.largest = std::max(result.largest, most);
        return factor;
    }

    /// Adds vertex j's own samples that no neighbour can use.
    /// in, out: direct  light
    ///          weight  of the continuation
    void add_private(std::size_t j, std::uint32_t unknown, bool all, Spectrum& direct, Spectrum& weight,
                     ChunkResult& result) const {
        const bool delta = is_delta(Lobe(graph.vertices.lobe[j]));
        const bool continues = (graph.vertices.flags[j] & vertex_flag::continued) && (all || delta);
        const std::uint32_t begin = offsets[j], end = offsets[j + 1];
        if (!continues && !((all || delta) && begin < end)) return;
        const ShadingPoint at = reader.vertex(j);
        for (std::uint32_t k = begin; k < end; ++k)
            if (all || LightTechnique(graph.light_edges.technique[k]) == LightTechnique::bsdf_hit)
                direct += own_light(reader, at, j, k);
        if (!continues) return;
        weight = own_continuation(reader, at, j, continuation_direction(graph, j));
        result.privates.push_back({unknown, std::uint32_t(j + 1), weight});
    }

    void add_flat_cluster(std::size_t c, FlatCluster& flat, const ClusterRows& rows, ChunkResult& result) {
        const std::uint32_t begin = system.first[c];
        system.shape[c] = {.flat = true};
        flat.gather_lights(rows, begin);
        const auto vertex = members(c);
        // Weight of a continuation as basic radiance, without its own eta^2: over all techniques, and over those that
        // can sample the light of an end without a cluster (continuation_density()).
        struct {
            float per_attempt = 0;
            Spectrum passed{0};
        } all, alone;
        const auto sum = [&](auto& of, std::uint16_t without) {
            float attempts = 0;
            for (int l = 0; l < flat.size(); ++l)
                if (!(flat.row(l).bits & without)) {
                    attempts += flat.survival(l);
                    of.passed += flat.albedo(l) * (flat.survival(l) / sqr(flat.row(l).eta));
                }
            of.per_attempt = attempts > 0 ? 1 / attempts : 0.0f;
            of.passed *= of.per_attempt;
        };
        sum(all, 0);
        bool last_steps = false;
        for (int l = 0; l < flat.size(); ++l) last_steps |= (flat.row(l).bits & vertex_bit::last_step) != 0;
        if (last_steps) sum(alone, vertex_bit::last_step);
        int n_edges = 0;
        for (int l = 0; l < flat.size(); ++l) {
            const VertexRow row = flat.row(l);  // a copy: the result replaces the original
            const std::uint32_t k = begin + std::uint32_t(l);
            const std::uint32_t j = vertex[std::size_t(l)];
            const Spectrum direct = flat.direct(l), &albedo = flat.albedo(l), own = flat.own_direct(l);
            Spectrum own_weight(0);
            if (row.bits & vertex_flag::continued) {
                const float cos = dot(row.next, flat.normal());
                const bool above = cos > 0;
                const std::size_t slot = begin + std::size_t(n_edges++);
                if (above) own_weight = albedo * (cos * inv_pi<float> / row.pdf_w);
                const auto& of = last_steps && (row.bits & vertex_bit::ends_alone) ? alone : all;
                const bool brings = above && !row.dead_end();
                system.edges[slot] = {clamped(of.passed * (brings ? eta2_of_next(row, j) : 0.0f), result) *
                                          (brings ? of.per_attempt : 0.0f),
                                      j + 1};
            }
            new (&system.at[k]) System::Row{{direct.r, direct.g, direct.b},
                                            {albedo.r, albedo.g, albedo.b},
                                            {own.r, own.g, own.b},
                                            {own_weight.r, own_weight.g, own_weight.b}};
        }
        system.n_edges[c] = std::uint16_t(n_edges);
    }

    void add_cluster(std::size_t c, ClusterShading& shading, Lanes& direct, const ClusterRows& rows,
                     std::span<const VertexRow> vertex_rows, ChunkResult& result) {
        const std::uint32_t begin = system.first[c];
        shading.load(members(c), vertex_rows);
        load_lanes(shading, direct);
        OwnSums own;
        add_delta_samples(c, shading, direct, own, result);
        add_block(c, shading, direct, vertex_rows, own, result);
        add_direct_light(c, shading, rows, direct, own);
        if (!system.inv_eta2.empty()) std::copy_n(direct.inv_eta2, shading.size(), system.inv_eta2.data() + begin);
        for (int l = 0; l < shading.size(); ++l) {
            const Spectrum &light = own.light[l], &weight = own.weight[l];
            new (&system.at[begin + l]) System::Row{{direct.r[l], direct.g[l], direct.b[l]},
                                                    {},
                                                    {light.r, light.g, light.b},
                                                    {weight.r, weight.g, weight.b}};
        }
    }

    /// Results of each vertex's own samples.
    struct OwnSums {
        Spectrum light[max_lanes], weight[max_lanes];  // direct light; weight of the continuation
    };

    static void load_lanes(const ClusterShading& shading, Lanes& direct) {
        const int lanes = shading.padded();
        for (int l = 0; l < lanes; ++l) direct.r[l] = direct.g[l] = direct.b[l] = 0;
        for (int l = 0; l < lanes; ++l) {
            const bool there = l < shading.size();
            direct.inv_eta2[l] = there ? 1 / sqr(shading.row(l).eta) : 1.0f;
            direct.clamp_weight[l] = shading.columns().survival[l] * direct.inv_eta2[l];
            direct.clamp_weight_alone[l] =
                there && (shading.row(l).bits & vertex_bit::last_step) ? 0 : direct.clamp_weight[l];
        }
    }

    /// Adds samples of delta lobes, which only their own vertex uses.
    void add_delta_samples(std::size_t c, const ClusterShading& shading, Lanes& direct, OwnSums& own,
                           ChunkResult& result) {
        const std::uint32_t begin = system.first[c];
        for (int l = 0; l < shading.size(); ++l) {
            system.unknown[shading.vertex(l)] = begin + l;
            Spectrum light(0), weight(0);
            if (shading.row(l).bits & vertex_bit::delta)
                add_private(shading.vertex(l), begin + l, false, light, weight, result);
            direct.r[l] = light.r, direct.g[l] = light.g, direct.b[l] = light.b;
            own.light[l] = light, own.weight[l] = weight;
        }
    }

    /// Adds the block of coefficients, one column per continuation.
    [[gnu::always_inline]] void add_block(std::size_t c, ClusterShading& shading, const Lanes& direct,
                                          std::span<const VertexRow> vertex_rows, OwnSums& own, ChunkResult& result) {
        // Reserve memory.
        const int lanes = shading.padded();
        const auto n_edges = int(std::ranges::count_if(vertex_rows, &VertexRow::continues_shared));
        const System::Shape shape = system.shape[c] = shape_of(shading);
        system.n_edges[c] = std::uint16_t(n_edges);
        system.block[c] = n_bytes.fetch_add(shape.bytes(n_edges, lanes));
        System::BlockAt<std::byte> at(system.blocks.data() + system.block[c], shape, n_edges, lanes);

        // Store tints and columns.
        if (shape.base)
            for (const float* tint : {shading.columns().tint_r, shading.columns().tint_g, shading.columns().tint_b})
                at.tint = std::copy_n(tint, lanes, at.tint);
        std::size_t slot = system.first[c];
        const auto sink = [&](int lane, std::uint32_t end, float inv_rho) {
            const std::size_t j = shading.vertex(lane);
            const VertexRow& row = shading.row(lane);
            const float end_eta2 = eta2_of_next(row, j);
            const float* clamp_weight =
                row.bits & vertex_bit::ends_alone ? direct.clamp_weight_alone : direct.clamp_weight;
            if (shape.channels()) {
                const float back = shading.to_solid_angle(lane);
                own.weight[lane] = back > 0 ? shading.f(lane, back / row.pdf_w)
                                            : own_continuation(reader, reader.vertex(j), j, row.next);
                add_column(shading, clamp_weight, end_eta2, at.scale, at.fraction, inv_rho, result);
            } else {
                own.weight[lane] = shading.f_of_lobes(lane, 1 / row.pdf_w);
                add_split_column(shading, shape, clamp_weight, end_eta2, at.scale, at.fraction, inv_rho, result);
            }
            if (!system.edge_survival.empty()) system.edge_survival[slot] = row.q * end_eta2;
            at.scale += shape.n_scales();
            at.fraction += shape.n_planes() * lanes;
            system.edges[slot++] = {1, end};
        };
        if (shape.channels())
            for_each_indirect_edge(shading, graph, options.sharing, sink);
        else
            for_each_direction(shading, sink);
    }

    /// Adds direct light: the light edges of all vertices, at each vertex.
    [[gnu::always_inline]] void add_direct_light(std::size_t c, ClusterShading& shading, const ClusterRows& rows,
                                                 Lanes& direct, OwnSums& own) {
        const int lanes = shading.padded();
        const auto lights = [&](const ClusterShading&, int lane) {
            return rows.lights_of(system.first[c] + shading.place(lane));
        };
        for_each_light_edge(shading, options.sharing, lights,
                            [&](int lane, const LightRow& edge, const Spectrum& light, float inv_rho) {
                                const std::size_t j = shading.vertex(lane);
                                const float back = shading.to_solid_angle(lane);
                                own.light[lane] += back > 0
                                                       ? own_light(edge, shading.f(lane, back), shading.row(lane).pdf_w)
                                                       : own_light(reader, reader.vertex(j), j, edge.edge);
                                const Spectrum w = light * inv_rho;
                                const float *r = shading.f(0), *g = shading.f(1), *b = shading.f(2);
                                for (int l = 0; l < lanes; ++l) {
                                    direct.r[l] += r[l] * w.r;
                                    direct.g[l] += g[l] * w.g;
                                    direct.b[l] += b[l] * w.b;
                                }
                            });
    }

    /// Builds all clusters. Returns one result per chunk.
    std::vector<ChunkResult> add_clusters() {
        const std::size_t n_members = system.first.back();
        ClusterRows rows(reader, system.unknown, n_members, offsets, options.threads);
        const VertexRow* vertex_rows = rows.vertices.data();
        system.at = std::move(rows.vertices).reused<System::Row>();
        const auto rows_of = [&](std::uint64_t c) {
            return std::span(vertex_rows + system.first[c], system.first[c + 1] - system.first[c]);
        };
        const std::uint64_t n_chunks = (system.n_clusters + clusters_per_chunk - 1) / clusters_per_chunk;
        std::vector<ChunkResult> results(n_chunks);
        // Build half of the rows of light at a time: holding all of them costs more than reading the graph's light
        // edges twice.
        for (const auto& [first_chunk, past_chunks] :
             {std::pair{std::uint64_t(0), n_chunks / 2}, std::pair{n_chunks / 2, n_chunks}}) {
            const std::size_t past_end = std::min(past_chunks * clusters_per_chunk, system.n_clusters);
            rows.load_lights(reader, system.unknown, system.first[first_chunk * clusters_per_chunk],
                             system.first[past_end], offsets, options.threads);
            parallel_chunks(past_chunks - first_chunk, 1, options.threads,
                            [&](std::uint64_t i, std::uint64_t, std::uint64_t) {
                                const std::uint64_t chunk = first_chunk + i, begin = chunk * clusters_per_chunk;
                                const auto shading = std::make_unique<ClusterShading>(reader);
                                const auto flat = std::make_unique<FlatCluster>(reader);
                                const auto direct = std::make_unique<Lanes>();
                                for (std::uint64_t c = begin; c < std::min(begin + clusters_per_chunk, past_end); ++c) {
                                    if (rank_one && flat->load(rows_of(c)))
                                        add_flat_cluster(c, *flat, rows, results[chunk]);
                                    else
                                        add_cluster(c, *shading, *direct, rows, rows_of(c), results[chunk]);
                                }
                            });
        }
        return results;
    }

    /// Adds solitary vertices, which have no cluster.
    std::vector<ChunkResult> add_solitary() {
        const std::size_t n_members = system.first.back();
        if (n_members == system.n_unknowns) return {};
        std::uint32_t next = std::uint32_t(n_members);
        std::vector<std::uint32_t> vertices;
        for (std::size_t j = 0; j < system.n_unknowns; ++j)
            if (system.unknown[j] == System::nothing) {
                vertices.push_back(std::uint32_t(j));
                system.unknown[j] = next++;
            }
        std::vector<ChunkResult> results((next - n_members) / 4096 + 1);
        parallel_chunks(
            next - n_members, 4096, options.threads, [&](std::uint64_t chunk, std::uint64_t begin, std::uint64_t end) {
                for (std::uint64_t i = begin; i < end; ++i) {
                    Spectrum direct(0), weight(0);
                    add_private(vertices[i], std::uint32_t(n_members + i), true, direct, weight, results[chunk]);
                    const Light light{direct.r, direct.g, direct.b};
                    new (&system.at[n_members + i]) System::Row{light, {}, light, {weight.r, weight.g, weight.b}};
                }
            });
        return results;
    }
};

/// Allocates all columns except the rows.
System empty_system(const PathGraph& graph, const Clusters& clusters, const SystemOptions& options) {
    System s;
    s.n_clusters = clusters.n_clusters();
    s.n_unknowns = graph.n_vertices();
    s.unknown = HugeArray<std::uint32_t>(s.n_unknowns);
    s.first.assign(clusters.first.begin(), clusters.first.end());
    s.n_edges.resize(s.n_clusters);
    s.shape.resize(s.n_clusters);
    s.block.resize(s.n_clusters);
    // Take memory on demand: clusters that need a block take the next piece of a common reservation.
    std::uint64_t most_bytes = 0;
    for (std::size_t c = 0; c < s.n_clusters; ++c) {
        const int n = int(s.first[c + 1] - s.first[c]);
        most_bytes += System::Shape{}.bytes(n, padded_lanes(n)) + 3 * sizeof(float) * std::size_t(padded_lanes(n));
    }
    const std::size_t n_members = s.first.back();
    s.edges = HugeArray<System::Edge>(n_members);
    if (options.clamp == Clamp::cluster) {
        s.edge_survival = HugeArray<float>(n_members);
        s.inv_eta2 = HugeArray<float>(n_members);
    }
    s.blocks = HugeArray<std::byte>(most_bytes);
    return s;
}

/// Numbers vertices by cluster; the vertices of a cluster that is not flat are sorted once more.
void number_members(System& s, const Clusters& clusters, int threads) {
    const std::size_t n_members = s.first.back();
    if (n_members < s.n_unknowns) std::fill_n(s.unknown.data(), s.n_unknowns, System::nothing);
    parallel_chunks(n_members, 1 << 16, threads, [&](std::uint64_t, std::uint64_t begin, std::uint64_t end) {
        for (std::uint64_t k = begin; k < end; ++k) s.unknown[clusters.member[k]] = std::uint32_t(k);
    });
}

/// Sums chunks in order.
void add_results(const std::vector<ChunkResult>& results, System& s, double& sum, double& taken) {
    for (const ChunkResult& r : results) {
        s.privates.insert(s.privates.end(), r.privates.begin(), r.privates.end());
        s.n_clamped += r.n_clamped;
        s.n_columns += r.n_columns;
        s.largest_column_sum = std::max(s.largest_column_sum, r.largest);
        sum += r.sum;
        taken += r.taken;
    }
}

/// Converts ends from vertices to unknowns for the iteration.
void number_ends(System& s, int threads) {
    for (System::Private& p : s.privates) p.end = s.unknown[p.end];
    parallel_chunks(s.n_clusters, 4096, threads, [&](std::uint64_t, std::uint64_t begin, std::uint64_t end) {
        for (std::uint64_t c = begin; c < end; ++c)
            for (std::uint32_t slot = s.first[c]; slot < s.first[c] + s.n_edges[c]; ++slot)
                s.edges[slot].end = s.unknown[s.edges[slot].end];
    });
}

}  // namespace

System build_system(const PathGraph& graph, const Clusters& clusters, const SystemOptions& options) {
    const GraphReader reader(graph);
    const std::vector<std::uint32_t> offsets = light_edge_offsets(graph);
    System s = empty_system(graph, clusters, options);
    number_members(s, clusters, options.threads);

    // Evaluate clusters, then solitary vertices.
    Builder builder{graph, reader, clusters, options, offsets, s};
    double sum = 0, taken = 0;
    add_results(builder.add_clusters(), s, sum, taken);
    add_results(builder.add_solitary(), s, sum, taken);
    s.clamped_share = sum > 0 ? taken / sum : 0;

    number_ends(s, options.threads);
    return s;
}

Spectrum System::coefficient(std::size_t c, int i, int lane) const {
    const Shape& of = shape[c];
    if (of.flat) {
        const Light& a = at[first[c] + std::size_t(lane)].albedo;
        return Spectrum{a.r, a.g, a.b} * edges[first[c] + std::size_t(i)].weight;
    }
    const int n = lanes(c);
    const auto b = block_of(c);
    const float* scale = b.scale + i * of.n_scales();
    const std::uint16_t* fraction = b.fraction + i * of.n_planes() * n + lane;
    if (of.channels()) return {fraction[0] * scale[0], fraction[n] * scale[1], fraction[2 * n] * scale[2]};
    Spectrum sum(0);
    if (of.base)
        sum = Spectrum{b.tint[lane], b.tint[n + lane], b.tint[2 * n + lane]} *
              (*scale++ * (of.base_plane ? *fraction : 1));
    return of.coat ? sum + Spectrum(fraction[of.base_plane ? n : 0] * *scale) : sum;
}

HugeArray<Light> path_radiance(System& system, const PathGraph& g, int threads) {
    HugeArray<Light> indirect(g.n_paths());
    constexpr std::uint64_t ahead = 32;
    parallel_chunks(g.n_paths(), 4096, threads, [&](std::uint64_t, std::uint64_t begin, std::uint64_t end) {
        std::uint64_t asked = g.paths.first_vertex[begin];
        for (std::uint64_t i = begin; i < end; ++i) {
            for (const std::uint64_t to = std::min(g.paths.first_vertex[i + 1] + ahead, g.paths.first_vertex[end]);
                 asked < to; ++asked)
                __builtin_prefetch(&system.at[system.unknown[asked]], 1);
            Light L, along;
            for (std::uint64_t j = g.paths.first_vertex[i + 1]; j-- > g.paths.first_vertex[i];) {
                System::Row& row = system.at[system.unknown[j]];
                along = {row.weight.r * L.r, row.weight.g * L.g, row.weight.b * L.b};
                L = {row.X.r + along.r, row.X.g + along.g, row.X.b + along.b};
                row.X = L;
            }
            indirect[i] = along;
        }
    });
    return indirect;
}

HugeArray<Light> path_radiance(const GraphReader& reader, int threads, Heuristic heuristic) {
    const PathGraph& g = reader.graph();
    const OwnSamples samples(reader, heuristic);
    HugeArray<Light> X(g.n_vertices());
    parallel_chunks(g.n_paths(), 4096, threads, [&](std::uint64_t, std::uint64_t begin, std::uint64_t end) {
        const std::uint64_t first = g.paths.first_vertex[begin];
        std::size_t edge = first_light_edge(g, g.paths.first_vertex[end]);
        Spectrum L(0);
        std::uint64_t j = g.paths.first_vertex[end];
        while (j-- > first) {
            const ShadingPoint at = samples.vertex(j);
            L = g.vertices.flags[j] & vertex_flag::continued ? samples.continuation(j, at) * L : Spectrum(0);
            while (edge > 0 && g.light_edges.vertex[edge - 1] == j) L += samples.light(j, at, --edge);
            X[j] = {L.r, L.g, L.b};
        }
    });
    return X;
}

}  // namespace loom::refine
