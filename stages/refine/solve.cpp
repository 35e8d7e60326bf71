#include "stages/refine/solve.h"

#include <algorithm>
#include <cmath>

#include "stages/core/transport/parallel.h"

namespace loom::refine {
namespace {

constexpr std::uint64_t clusters_per_chunk = 512;

struct Sums {
    double change = 0, total = 0, given = 0, taken = 0;
};

float magnitude(const Light& L) {
    return std::fabs(L.r) + std::fabs(L.g) + std::fabs(L.b);
}
float distance(const Light& a, const Light& b) {
    return std::fabs(a.r - b.r) + std::fabs(a.g - b.g) + std::fabs(a.b - b.b);
}

/// Factor that keeps a cluster from giving more than (1 - epsilon) of what it takes in; one for all channels, so that
/// colours stay.
float cluster_factor(const float* given, const float* taken_in, float epsilon) {
    float factor = 1;
    for (int channel = 0; channel < 3; ++channel)
        if (given[channel] > (1 - epsilon) * taken_in[channel])
            factor = std::min(factor, (1 - epsilon) * taken_in[channel] / given[channel]);
    return factor;
}

}  // namespace

std::vector<Iteration> solve(const System& s, std::span<const std::uint32_t> first_hits, const SolveOptions& options,
                             HugeArray<Light>& X, const std::function<void(const Iteration&)>& step) {
    const auto apply = cluster_kernels().apply_block;
    const std::size_t n_members = s.first.back();
    HugeArray<Light> next(s.n_unknowns);
    std::vector<Iteration> log;
    double least = HUGE_VAL;
    const std::uint64_t n_chunks = (s.n_clusters + clusters_per_chunk - 1) / clusters_per_chunk;
    for (int i = 0; i < options.iterations; ++i) {
        std::vector<Sums> sums(n_chunks);
        parallel_chunks(s.n_clusters, clusters_per_chunk, options.threads, [&](std::uint64_t chunk, std::uint64_t begin, std::uint64_t end) {
            alignas(64) float L[3 * max_lanes], out[3 * (max_lanes + lane_block)];
            Sums local;
            for (std::uint64_t c = begin; c < end; ++c) {
                const std::uint32_t first = s.first[c];
                const int n = int(s.first[c + 1] - first), lanes = padded_lanes(n), n_edges = s.n_edges[c];
                if (c + 2 < end)
                    for (std::uint32_t slot = s.first[c + 2], k = 0; k < s.n_edges[c + 2]; ++k) __builtin_prefetch(&X[s.edge_end[slot + k]]);
                float taken_in[3] = {};
                for (int e = 0; e < n_edges; ++e) {
                    const Light in = X[s.edge_end[first + e]];
                    const Light scale = s.edge_scale[first + e];
                    L[3 * e] = in.r * scale.r, L[3 * e + 1] = in.g * scale.g, L[3 * e + 2] = in.b * scale.b;
                    if (options.clamp == Clamp::cluster) {
                        const float inv_q = 1 / s.edge_survival[first + e];
                        taken_in[0] += in.r * inv_q, taken_in[1] += in.g * inv_q, taken_in[2] += in.b * inv_q;
                    }
                }
                apply(s.coefficients.data() + s.block[c], L, n_edges, lanes, out);
                float factor = 1;
                if (options.clamp == Clamp::cluster) {
                    float given[3] = {};
                    for (int l = 0; l < n; ++l)
                        for (int channel = 0; channel < 3; ++channel) given[channel] += out[channel * lanes + l] * s.inv_eta2[first + l];
                    factor = cluster_factor(given, taken_in, options.epsilon);
                    const double all = double(given[0]) + given[1] + given[2];
                    local.given += all;
                    local.taken += all * (1 - factor);
                }
                for (int l = 0; l < n; ++l) {
                    const Light& B = s.B[first + l];
                    next[first + l] = {B.r + out[l] * factor, B.g + out[lanes + l] * factor, B.b + out[2 * lanes + l] * factor};
                }
            }
            sums[chunk] = local;
        });
        for (std::size_t k = n_members; k < s.n_unknowns; ++k) next[k] = s.B[k];
        parallel_chunks(s.privates.size(), 65536, options.threads, [&](std::uint64_t, std::uint64_t begin, std::uint64_t end) {
            for (std::uint64_t k = begin; k < end; ++k) {
                const System::Private& p = s.privates[k];
                const Light& in = X[p.end];
                Light& out = next[p.unknown];
                out.r += p.weight.r * in.r, out.g += p.weight.g * in.g, out.b += p.weight.b * in.b;
            }
        });

        constexpr std::uint64_t block = 1 << 16;
        std::vector<Sums> all((s.n_unknowns + block - 1) / block), image((first_hits.size() + block - 1) / block);
        parallel_chunks(s.n_unknowns, block, options.threads, [&](std::uint64_t chunk, std::uint64_t begin, std::uint64_t end) {
            for (std::uint64_t k = begin; k < end; ++k) {
                all[chunk].change += distance(next[k], X[k]);
                all[chunk].total += magnitude(next[k]);
            }
        });
        parallel_chunks(first_hits.size(), block, options.threads, [&](std::uint64_t chunk, std::uint64_t begin, std::uint64_t end) {
            for (std::uint64_t k = begin; k < end; ++k) {
                image[chunk].change += distance(next[first_hits[k]], X[first_hits[k]]);
                image[chunk].total += magnitude(next[first_hits[k]]);
            }
        });
        const auto ratio = [](const std::vector<Sums>& parts, double Sums::*a, double Sums::*b) {
            double over = 0, under = 0;
            for (const Sums& part : parts) over += part.*a, under += part.*b;
            return under > 0 ? over / under : over > 0 ? HUGE_VAL : 0;
        };
        Iteration iteration;
        iteration.residual = ratio(all, &Sums::change, &Sums::total);
        iteration.image_change = ratio(image, &Sums::change, &Sums::total);
        iteration.clamped_share = ratio(sums, &Sums::taken, &Sums::given);
        if (!std::isfinite(iteration.residual)) break;
        std::swap(X, next);
        log.push_back(iteration);
        if (step) step(iteration);
        double change = 0;
        for (const Sums& part : all) change += part.change;
        if (change > 3 * least) break;
        least = std::min(least, change);
    }
    return log;
}

}  // namespace loom::refine
