#include "stages/residual/stored/path_parts.h"

#include <bit>

#include "stages/residual/stored/candidate_paths.h"

namespace loom::residual {
namespace {

/// Whether n values of two columns, from these on, have the same bits.
template <class T>
bool same_values(const Column<T>& a, std::size_t i, const Column<T>& b, std::size_t j, std::size_t n) {
    using Bits = std::conditional_t<sizeof(T) == 4, std::uint32_t, std::uint16_t>;
    for (std::size_t k = 0; k < n; ++k)
        if (std::bit_cast<Bits>(a[i * n + k]) != std::bit_cast<Bits>(b[j * n + k])) return false;
    return true;
}

}  // namespace

bool PathParts::same_vertex(const PathGraph& before, std::size_t i, const PathGraph& after, std::size_t j) const {
    const std::uint32_t shape = before.vertices.shape[i];
    return !reach_.shapes[shape] && edit_.new_shapes[after.vertices.shape[j]].partner_idx == shape &&
           same_values(before.vertices.p, i, after.vertices.p, j, 3);
}

bool PathParts::same_edge(const PathGraph& before, std::size_t i, const PathGraph& after, std::size_t j) const {
    const auto &e = before.light_edges, &f = after.light_edges;
    return e.technique[i] == f.technique[j] && same_emitter(e.emitter[i], f.emitter[j]) &&
           same_values(e.y, i, f.y, j, 4) && same_values(e.Li, i, f.Li, j, 3) &&
           same_values(e.pdf_nee_w, i, f.pdf_nee_w, j, 1) && same_values(e.pdf_bsdf_w, i, f.pdf_bsdf_w, j, 1);
}

Parts PathParts::of(const StoredPaths& old_paths, std::size_t old_path, std::size_t old_edge,
                    const StoredPaths& new_paths, std::size_t new_path, std::size_t new_edge,
                    const Sampler& sampler) const {
    const PathGraph &before = old_paths.graph(), &after = new_paths.graph();
    Parts parts;
    PathTerms old_terms(old_paths, old_path, old_edge, sampler), new_terms(new_paths, new_path, new_edge, sampler);

    // Directly visible light.
    const int seen_before = old_paths.seen_emitter(old_path), seen_after = new_paths.seen_emitter(new_path);
    const Spectrum Le_before = rgb(before.paths.Le, old_path), Le_after = rgb(after.paths.Le, new_path);
    bool in_common = seen_before < 0 && seen_after < 0;
    if (seen_before >= 0 && seen_after >= 0)
        in_common = same_emitter(std::size_t(seen_before), std::size_t(seen_after)) && Le_before == Le_after;
    if (!in_common) parts.plus += Le_after, parts.minus += Le_before;

    bool touched = false;
    while (!old_terms.ended() || !new_terms.ended()) {
        if (!touched)
            touched = old_terms.ended() || new_terms.ended() ||
                      !same_vertex(before, old_terms.vertex(), after, new_terms.vertex());
        if (touched) {
            for (; !old_terms.ended(); old_terms.advance())
                while (old_terms.has_edge()) parts.minus += old_terms.take_edge();
            for (; !new_terms.ended(); new_terms.advance())
                while (new_terms.has_edge()) parts.plus += new_terms.take_edge();
            break;
        }
        // Both have the vertex. Its light edges are in the same order, and some may be missing in either scene.
        while (old_terms.has_edge() || new_terms.has_edge()) {
            const bool both = old_terms.has_edge() && new_terms.has_edge();
            const auto is_hit = [](const PathGraph& graph, std::size_t edge) {
                return graph.light_edges.technique[edge] == std::uint8_t(LightTechnique::bsdf_hit);
            };
            const bool pair = both && is_hit(before, old_terms.edge()) == is_hit(after, new_terms.edge());
            const bool same = pair && same_edge(before, old_terms.edge(), after, new_terms.edge());
            const bool takes_old =
                old_terms.has_edge() && (pair || !new_terms.has_edge() || !is_hit(before, old_terms.edge()));
            const bool takes_new =
                new_terms.has_edge() && (pair || !old_terms.has_edge() || !is_hit(after, new_terms.edge()));
            const Spectrum old_term = takes_old ? old_terms.take_edge() : Spectrum(0),
                           new_term = takes_new ? new_terms.take_edge() : Spectrum(0);
            if (same) continue;
            parts.minus += old_term;
            parts.plus += new_term;
        }
        old_terms.advance();
        new_terms.advance();
    }
    return parts;
}

void PartSums::write(Image& residual, std::uint64_t samples) const {
    for (int c = 0; c < 3; ++c) {
        const auto channel = [&](const char* layer) -> std::span<float> {
            return residual.add(std::string(layer) + '.' + "RGB"[c]);
        };
        const auto k = std::size_t(c);
        const auto plus = channel("Plus");
        for (std::size_t p = 0; p < sums_.size(); ++p) plus[p] = float(sums_[p].plus[k] / double(samples));
        const auto minus = channel("Minus");
        for (std::size_t p = 0; p < sums_.size(); ++p) minus[p] = float(sums_[p].minus[k] / double(samples));
    }
}

const StoredPaths& RecordedPaths::trace(std::span<const PathId> ids, std::span<PathResult> results) {
    batch_.trace(ids, results, records_);
    graph_.set(records_);
    return paths_;
}

std::size_t RecordedPaths::first_edge(std::size_t path) const {
    const PathGraph& graph = graph_.graph();
    return first_row(graph.light_edges.vertex, graph.paths.first_vertex[path]);
}

}  // namespace loom::residual
