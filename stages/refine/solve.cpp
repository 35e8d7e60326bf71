#include "stages/refine/solve.h"

#include <algorithm>
#include <bit>
#include <cmath>

#include "stages/core/compute/parallel.h"

namespace loom::refine {
namespace {

constexpr std::uint64_t clusters_per_chunk = 512;

/// Below this the residual fluctuates by rounding.
constexpr double rounding = 1e-6;

/// The four numbers of a Light as one vector.
using Quad = float __attribute__((vector_size(sizeof(Light))));
Quad quad(const Light& L) {
    return std::bit_cast<Quad>(L);
}
Light light(const Quad& q) {
    return std::bit_cast<Light>(q);
}

float magnitude(const Quad& q) {
    return std::fabs(q[0]) + std::fabs(q[1]) + std::fabs(q[2]);
}

struct Sums {
    double change = 0, total = 0, given = 0, taken = 0;

    Sums& operator+=(const Sums& other) {
        change += other.change, total += other.total, given += other.given, taken += other.taken;
        return *this;
    }
};

struct AllSums {
    Sums all, image;
};

double ratio(double over, double under) {
    return under > 0 ? over / under : over > 0 ? HUGE_VAL : 0;
}

/// Returns the factor that limits a cluster's output to (1 - epsilon) of its input. All channels have one factor, so
/// that colours are kept.
float cluster_factor(const float* given, const float* taken_in, float epsilon) {
    float factor = 1;
    for (int channel = 0; channel < 3; ++channel)
        if (given[channel] > (1 - epsilon) * taken_in[channel])
            factor = std::min(factor, (1 - epsilon) * taken_in[channel] / given[channel]);
    return factor;
}

/// The reduced system. A flat cluster is represented by the light S that it passes to all its vertices, X_k = B_k +
/// albedo_k S. The unknowns Y are S of all flat clusters, then X of all other vertices: far fewer.
///
///   S_c = sum_e weight_e X_end = sum_e weight_e B_end + sum_e (weight_e albedo_end) S_end
///
/// For an end that is not flat, X_end is used directly. Steps Y <- base + gain Y equal the steps of X.
class Reduced {
  public:
    Reduced(const System& s, std::span<const std::uint32_t> first_hits, const SolveOptions& options);

    /// Computes Y from a start X, and the sums of the step.
    AllSums first_step(LightColumn X);
    /// Computes the next Y; accept() makes it current.
    AllSums step();
    void accept() {
        std::swap(Y_, next_);
        has_previous_ = true;
    }
    /// Computes X from Y.
    /// in:  none_but_first_hits  the others are computed from the previous Y; after the first step they keep the start
    void expand(LightColumn X, bool none_but_first_hits) const;

  private:
    using Given = float[3 * (max_lanes + lane_block)];  // [rgb][padded lane]
    struct Edges {
        alignas(64) float L[3 * max_lanes], base[3 * max_lanes];
        Given out, base_out;
        float taken_in[3];
    };

    template <class Body>
    void for_clusters(Body&& body) const {
        parallel_chunks(s_.n_clusters, clusters_per_chunk, options_.threads, body);
    }
    std::size_t n_chunks() const { return std::size_t((s_.n_clusters + clusters_per_chunk - 1) / clusters_per_chunk); }
    int size(std::size_t c) const { return int(s_.first[c + 1] - s_.first[c]); }
    /// Returns the row in Y of the first vertex of a cluster that is not flat.
    std::size_t rows(std::size_t c) const { return s_.n_clusters + general_[c]; }
    std::size_t member_row(std::size_t c, std::size_t k) const {
        return s_.shape[c].flat ? c : rows(c) + (k - s_.first[c]);
    }
    std::size_t solitary_row(std::size_t k) const { return rows(s_.n_clusters) + (k - s_.first.back()); }

    /// Computes the output of cluster c, which is not flat, for light L[edge][rgb].
    void give(std::size_t c, const float* L, Given& out) const;
    float clamp(std::size_t c, const float* taken_in, const float* out, Sums& sums) const;

    struct Arriving {
        Quad all, base;  // light of X, and of B alone
    };
    /// Returns the light of an edge in the first step; sets its gain.
    [[gnu::always_inline]] Arriving first_light_of(std::size_t slot, LightColumn X);
    [[gnu::always_inline]] void first_step_of_flat(std::size_t c, LightColumn X);
    [[gnu::always_inline]] void first_step_of_general(std::size_t c, LightColumn X, Edges& edges, Sums& clamped);
    void first_step_of_privates(LightColumn X);
    AllSums sums_of_first_step(LightColumn X);
    AllSums sums_of_step() const;
    static AllSums added(const std::vector<AllSums>& parts);

    const System& s_;
    const SolveOptions& options_;
    const ClusterKernels& kernels_;
    std::vector<std::uint32_t> general_;   // [cluster] vertices of earlier clusters that are not flat
    std::vector<std::uint8_t> first_hit_;  // [unknown]
    HugeArray<std::uint32_t> home_;        // [unknown] row of Y; for the first step
    struct alignas(16) Gain {
        float r, g, b;
        std::uint32_t from;  // row of Y of the light's source
    };
    static Quad quad_of(const Gain& g) { return Quad{g.r, g.g, g.b, 0}; }
    HugeArray<Gain> gain_;  // [slot]
    std::vector<std::uint32_t> private_from_, private_to_;
    std::vector<Light> private_gain_;
    HugeArray<Light> Y_, next_, base_;
    bool has_previous_ = false;  // whether next_ holds the previous Y
    // For flat clusters: sums of albedos, over all vertices and over first hits; sums of all B.
    HugeArray<Light> albedo_sum_, image_albedo_sum_;
    AllSums flat_base_;
};

Reduced::Reduced(const System& s, std::span<const std::uint32_t> first_hits, const SolveOptions& options)
    : s_(s),
      options_(options),
      kernels_(cluster_kernels()),
      general_(s.n_clusters + 1),
      first_hit_(s.n_unknowns),
      home_(s.n_unknowns) {
    for (std::size_t c = 0; c < s.n_clusters; ++c)
        general_[c + 1] = general_[c] + (s.shape[c].flat ? 0u : s.first[c + 1] - s.first[c]);
    const std::size_t n_members = s.first.back(), n_solitary = s.n_unknowns - n_members;
    const std::size_t n_rows = s.n_clusters + general_.back() + n_solitary;
    for_clusters([&](std::uint64_t, std::uint64_t begin, std::uint64_t end) {
        for (std::uint64_t c = begin; c < end; ++c)
            for (std::uint32_t k = s.first[c]; k < s.first[c + 1]; ++k) home_[k] = std::uint32_t(member_row(c, k));
    });
    for (std::size_t k = n_members; k < s.n_unknowns; ++k) home_[k] = std::uint32_t(solitary_row(k));
    for (const std::uint32_t k : first_hits) first_hit_[k] = 1;
    gain_ = HugeArray<Gain>(n_members);
    Y_ = HugeArray<Light>(n_rows), next_ = HugeArray<Light>(n_rows), base_ = HugeArray<Light>(n_rows);
    albedo_sum_ = HugeArray<Light>(s.n_clusters), image_albedo_sum_ = HugeArray<Light>(s.n_clusters);
}

void Reduced::give(std::size_t c, const float* L, Given& out) const {
    const System::Shape& shape = s_.shape[c];
    const auto block = s_.block_of(c);
    const int n_edges = s_.n_edges[c], lanes = s_.lanes(c), stride = shape.n_planes() * lanes,
              n_scales = shape.n_scales();
    alignas(64) float scaled[3 * max_lanes];
    if (shape.channels()) {
        for (int i = 0; i < 3 * n_edges; ++i) scaled[i] = block.scale[i] * L[i];
        kernels_.apply_block(block.fraction, scaled, n_edges, lanes, out);
        return;
    }
    const auto scale_by = [&](int lobe) {
        for (int e = 0; e < n_edges; ++e)
            for (int channel = 0; channel < 3; ++channel)
                scaled[3 * e + channel] = block.scale[e * n_scales + lobe] * L[3 * e + channel];
    };
    if (shape.coat) {
        scale_by(shape.base);
        kernels_.apply_plane(block.fraction + (shape.base_plane ? lanes : 0), stride, scaled, n_edges, lanes, out);
    } else {
        std::fill_n(out, 3 * lanes, 0.0f);
    }
    if (!shape.base) return;
    scale_by(0);
    if (shape.base_plane) {
        Given base;
        kernels_.apply_plane(block.fraction, stride, scaled, n_edges, lanes, base);
        for (int i = 0; i < 3 * lanes; ++i) out[i] += block.tint[i] * base[i];
        return;
    }
    float sum[3] = {};
    for (int e = 0; e < n_edges; ++e)
        for (int channel = 0; channel < 3; ++channel) sum[channel] += scaled[3 * e + channel];
    for (int channel = 0; channel < 3; ++channel)
        for (int l = 0; l < lanes; ++l) out[channel * lanes + l] += block.tint[channel * lanes + l] * sum[channel];
}

/// Clamp::cluster: returns the factor on the output of cluster c.
float Reduced::clamp(std::size_t c, const float* taken_in, const float* out, Sums& sums) const {
    float given[3] = {};
    const int lanes = padded_lanes(size(c));
    for (int l = 0; l < size(c); ++l)
        for (int channel = 0; channel < 3; ++channel)
            given[channel] += out[channel * lanes + l] * s_.inv_eta2[s_.first[c] + std::size_t(l)];
    const float factor = cluster_factor(given, taken_in, options_.epsilon);
    const double all = double(given[0]) + given[1] + given[2];
    sums.given += all;
    sums.taken += all * (1 - factor);
    return factor;
}

AllSums Reduced::added(const std::vector<AllSums>& parts) {
    AllSums sum;
    for (const AllSums& part : parts) sum.all += part.all, sum.image += part.image;
    return sum;
}

AllSums Reduced::first_step(LightColumn X) {
    // Step the clusters.
    const System& s = s_;
    std::vector<AllSums> clamped(n_chunks());
    for_clusters([&](std::uint64_t chunk, std::uint64_t begin, std::uint64_t end) {
        Edges edges;
        for (std::uint64_t c = begin; c < end; ++c) {
            if (c + 2 < end)
                for (std::uint32_t slot = s.first[c + 2], i = 0; i < s.n_edges[c + 2]; ++i) {
                    const std::uint32_t k = s.edges[slot + i].end;
                    __builtin_prefetch(&home_[k]);
                    __builtin_prefetch(&X[k]);
                    __builtin_prefetch(&s.at[k]);
                }
            if (s.shape[c].flat)
                first_step_of_flat(c, X);
            else
                first_step_of_general(c, X, edges, clamped[chunk].all);
        }
    });

    // Step all other vertices.
    for (std::size_t k = s.first.back(); k < s.n_unknowns; ++k) Y_[home_[k]] = base_[home_[k]] = s.at[k].B;
    first_step_of_privates(X);

    AllSums sums = sums_of_first_step(X);
    home_ = {};
    sums.all += added(clamped).all;
    return sums;
}

inline Reduced::Arriving Reduced::first_light_of(std::size_t slot, LightColumn X) {
    const std::uint32_t k = s_.edges[slot].end, from = home_[k];
    const float w = s_.edges[slot].weight;
    const Quad weight{w, w, w, 0};
    const bool end_is_flat = from < s_.n_clusters;
    const Quad gain = end_is_flat ? weight * quad(s_.at[k].albedo) : weight;
    gain_[slot] = {gain[0], gain[1], gain[2], from};
    return {weight * quad(X[k]), end_is_flat ? weight * quad(s_.at[k].B) : Quad{}};
}

inline void Reduced::first_step_of_flat(std::size_t c, LightColumn X) {
    Quad S{}, S_base{};
    for (int e = 0; e < s_.n_edges[c]; ++e) {
        const Arriving arriving = first_light_of(s_.first[c] + std::size_t(e), X);
        S += arriving.all, S_base += arriving.base;
    }
    Y_[c] = light(S), base_[c] = light(S_base);
}

inline void Reduced::first_step_of_general(std::size_t c, LightColumn X, Edges& edges, Sums& clamped) {
    // Gather the light of its edges.
    const std::uint32_t first = s_.first[c];
    const int n = size(c), lanes = padded_lanes(n), n_edges = s_.n_edges[c];
    std::fill_n(edges.taken_in, 3, 0.0f);
    for (int e = 0; e < n_edges; ++e) {
        const std::size_t slot = first + std::size_t(e);
        const Arriving arriving = first_light_of(slot, X);
        for (int channel = 0; channel < 3; ++channel)
            edges.L[3 * e + channel] = arriving.all[channel], edges.base[3 * e + channel] = arriving.base[channel];
        if (options_.clamp == Clamp::cluster)
            for (int channel = 0; channel < 3; ++channel)
                edges.taken_in[channel] += quad(X[s_.edges[slot].end])[channel] / s_.edge_survival[slot];
    }

    // Reflect it at its vertices.
    give(c, edges.L, edges.out);
    give(c, edges.base, edges.base_out);
    const float factor = options_.clamp == Clamp::cluster ? clamp(c, edges.taken_in, edges.out, clamped) : 1.0f;
    for (int l = 0; l < n; ++l) {
        const Light& B = s_.at[first + std::size_t(l)].B;
        const float *out = edges.out + l, *base = edges.base_out + l;
        Y_[rows(c) + std::size_t(l)] = {B.r + out[0] * factor, B.g + out[lanes] * factor,
                                        B.b + out[2 * lanes] * factor};
        base_[rows(c) + std::size_t(l)] = {B.r + base[0], B.g + base[lanes], B.b + base[2 * lanes]};
    }
}

void Reduced::first_step_of_privates(LightColumn X) {
    const System& s = s_;
    private_from_.resize(s.privates.size()), private_to_.resize(s.privates.size());
    private_gain_.resize(s.privates.size());
    parallel_chunks(s.privates.size(), 65536, options_.threads,
                    [&](std::uint64_t, std::uint64_t begin, std::uint64_t end) {
                        for (std::uint64_t i = begin; i < end; ++i) {
                            const System::Private& p = s.privates[i];
                            const std::uint32_t from = home_[p.end], to = home_[p.unknown];
                            const Quad weight{p.weight.r, p.weight.g, p.weight.b, 0};
                            const bool end_is_flat = from < s.n_clusters;
                            private_from_[i] = from, private_to_[i] = to;
                            private_gain_[i] = light(end_is_flat ? weight * quad(s.at[p.end].albedo) : weight);
                            if (end_is_flat) base_[to] = light(quad(base_[to]) + weight * quad(s.at[p.end].B));
                            Y_[to] = light(quad(Y_[to]) + weight * quad(X[p.end]));
                        }
                    });
}

/// Sums the changes from X vertex by vertex, because X has no S. Stores what later steps need to compute these sums
/// from S alone.
AllSums Reduced::sums_of_first_step(LightColumn X) {
    const System& s = s_;
    std::vector<AllSums> parts(n_chunks() + 1), bases(n_chunks());
    const auto compare = [&](AllSums& sums, std::size_t k, const Quad& now) {
        const double change = magnitude(now - quad(X[k])), total = magnitude(now);
        sums.all.change += change, sums.all.total += total;
        if (first_hit_[k]) sums.image.change += change, sums.image.total += total;
    };
    for_clusters([&](std::uint64_t chunk, std::uint64_t begin, std::uint64_t end) {
        for (std::uint64_t c = begin; c < end; ++c) {
            const Quad S = quad(Y_[c]);
            Quad albedo_sum{}, image_albedo_sum{};
            for (std::uint32_t k = s.first[c]; k < s.first[c + 1]; ++k) {
                if (!s.shape[c].flat) {
                    compare(parts[chunk], k, quad(Y_[home_[k]]));
                    continue;
                }
                const Quad albedo = quad(s.at[k].albedo), B = quad(s.at[k].B);
                compare(parts[chunk], k, B + albedo * S);
                albedo_sum += albedo;
                bases[chunk].all.total += magnitude(B);
                if (first_hit_[k]) image_albedo_sum += albedo, bases[chunk].image.total += magnitude(B);
            }
            if (s.shape[c].flat) albedo_sum_[c] = light(albedo_sum), image_albedo_sum_[c] = light(image_albedo_sum);
        }
    });
    for (std::size_t k = s.first.back(); k < s.n_unknowns; ++k) compare(parts.back(), k, quad(Y_[home_[k]]));
    flat_base_ = added(bases);
    return added(parts);
}

AllSums Reduced::step() {
    const System& s = s_;
    std::vector<AllSums> clamped(n_chunks());
    for_clusters([&](std::uint64_t chunk, std::uint64_t begin, std::uint64_t end) {
        Edges edges;
        for (std::uint64_t c = begin; c < end; ++c) {
            const std::uint32_t first = s.first[c];
            const int n = size(c), lanes = padded_lanes(n), n_edges = s.n_edges[c];
            if (c + 2 < end)
                for (std::uint32_t slot = s.first[c + 2], i = 0; i < s.n_edges[c + 2]; ++i)
                    __builtin_prefetch(&Y_[gain_[slot + i].from]);
            if (s.shape[c].flat) {
                Quad S = quad(base_[c]);
                for (int e = 0; e < n_edges; ++e) {
                    const Gain& gain = gain_[first + std::size_t(e)];
                    S += quad_of(gain) * quad(Y_[gain.from]);
                }
                next_[c] = light(S);
                continue;
            }
            std::fill_n(edges.taken_in, 3, 0.0f);
            for (int e = 0; e < n_edges; ++e) {
                const std::size_t slot = first + std::size_t(e);
                const Quad Y = quad(Y_[gain_[slot].from]), in = quad_of(gain_[slot]) * Y;
                for (int channel = 0; channel < 3; ++channel) edges.L[3 * e + channel] = in[channel];
                if (options_.clamp == Clamp::cluster)
                    for (int channel = 0; channel < 3; ++channel)
                        edges.taken_in[channel] += Y[channel] / s.edge_survival[slot];
            }
            give(c, edges.L, edges.out);
            const float factor =
                options_.clamp == Clamp::cluster ? clamp(c, edges.taken_in, edges.out, clamped[chunk].all) : 1.0f;
            for (int l = 0; l < n; ++l) {
                const Light& base = base_[rows(c) + std::size_t(l)];
                const float* out = edges.out + l;
                next_[rows(c) + std::size_t(l)] = {base.r + out[0] * factor, base.g + out[lanes] * factor,
                                                   base.b + out[2 * lanes] * factor};
            }
        }
    });
    for (std::size_t k = s.first.back(); k < s.n_unknowns; ++k) next_[solitary_row(k)] = base_[solitary_row(k)];
    parallel_chunks(s.privates.size(), 65536, options_.threads,
                    [&](std::uint64_t, std::uint64_t begin, std::uint64_t end) {
                        for (std::uint64_t i = begin; i < end; ++i) {
                            const std::uint32_t to = private_to_[i];
                            next_[to] = light(quad(next_[to]) + quad(private_gain_[i]) * quad(Y_[private_from_[i]]));
                        }
                    });
    AllSums sums = sums_of_step();
    sums.all += added(clamped).all;
    return sums;
}

/// Returns the sums over all vertices. Vertices of flat clusters are not visited: all terms are positive, so the sums
/// follow from S.
AllSums Reduced::sums_of_step() const {
    const System& s = s_;
    std::vector<AllSums> parts(n_chunks() + 1);
    const auto compare = [&](AllSums& sums, std::size_t k, std::size_t row) {
        const double change = magnitude(quad(next_[row]) - quad(Y_[row])), total = magnitude(quad(next_[row]));
        sums.all.change += change, sums.all.total += total;
        if (first_hit_[k]) sums.image.change += change, sums.image.total += total;
    };
    for_clusters([&](std::uint64_t chunk, std::uint64_t begin, std::uint64_t end) {
        AllSums& sums = parts[chunk];
        for (std::uint64_t c = begin; c < end; ++c) {
            if (s.shape[c].flat) {
                const Quad S = quad(next_[c]), change = S - quad(Y_[c]);
                sums.all.change += magnitude(change * quad(albedo_sum_[c])),
                    sums.all.total += magnitude(S * quad(albedo_sum_[c]));
                sums.image.change += magnitude(change * quad(image_albedo_sum_[c])),
                    sums.image.total += magnitude(S * quad(image_albedo_sum_[c]));
                continue;
            }
            for (std::uint32_t k = s.first[c]; k < s.first[c + 1]; ++k) compare(sums, k, rows(c) + (k - s.first[c]));
        }
    });
    for (std::size_t k = s.first.back(); k < s.n_unknowns; ++k) compare(parts.back(), k, solitary_row(k));
    AllSums sums = added(parts);
    sums.all += flat_base_.all, sums.image += flat_base_.image;
    return sums;
}

void Reduced::expand(LightColumn X, bool none_but_first_hits) const {
    const auto set = [&](std::size_t k, auto&& value) {
        if (!none_but_first_hits || first_hit_[k])
            X[k] = value(Y_);
        else if (has_previous_)
            X[k] = value(next_);
    };
    for_clusters([&](std::uint64_t, std::uint64_t begin, std::uint64_t end) {
        for (std::uint64_t c = begin; c < end; ++c)
            for (std::uint32_t k = s_.first[c]; k < s_.first[c + 1]; ++k)
                set(k, [&](const HugeArray<Light>& Y) {
                    const Light& y = Y[member_row(c, k)];
                    return s_.shape[c].flat ? light(quad(s_.at[k].B) + quad(s_.at[k].albedo) * quad(y)) : y;
                });
    });
    for (std::size_t k = s_.first.back(); k < s_.n_unknowns; ++k)
        set(k, [&](const HugeArray<Light>& Y) { return Y[solitary_row(k)]; });
}

}  // namespace

std::vector<Iteration> solve(const System& s, std::span<const std::uint32_t> first_hits, const SolveOptions& options,
                             LightColumn X, const std::function<void(const Iteration&)>& step) {
    std::vector<Iteration> log;
    if (options.iterations <= 0) return log;
    Reduced reduced(s, first_hits, options);
    double least = HUGE_VAL;
    for (int i = 0; i < options.iterations; ++i) {
        const AllSums sums = i == 0 ? reduced.first_step(X) : reduced.step();
        const Iteration iteration{ratio(sums.all.change, sums.all.total), ratio(sums.image.change, sums.image.total),
                                  ratio(sums.all.taken, sums.all.given)};
        if (!std::isfinite(iteration.residual)) {
            if (!log.empty()) reduced.expand(X, false);
            return log;
        }
        if (i > 0) reduced.accept();
        log.push_back(iteration);
        if (step) step(iteration);
        if (sums.all.change > 3 * least && iteration.residual > rounding) break;
        least = std::min(least, sums.all.change);
    }
    reduced.expand(X, options.last_for_first_hits);
    return log;
}

}  // namespace loom::refine
