#include "stages/residual/stored/candidate_paths.h"

#include <algorithm>

#include "stages/core/graph/graph_reader.h"

namespace loom::residual {

CandidatePaths::CandidatePaths(const Scene& old_scene, const EditReach& reach, const PathGraph& graph)
    : reach_(reach), graph_(graph), camera_(old_scene.sensor.origin) {
    const bool asks = reach.any_emitter || !reach.old_places.empty() || !reach.new_places.empty();
    tells_ = reach.everything.empty() && !(asks && graph.misses.vertex.empty());
    any_shape_ =
        std::any_of(reach.shapes.begin(), reach.shapes.end(), [](std::uint8_t changed) { return changed != 0; });
}

void CandidatePaths::room(std::size_t n) {
    if (vertices_.size() >= n) return;
    segments_ = SegmentColumns(n);
    vertices_.resize(n);
}

void CandidatePaths::fill(std::size_t n, const std::uint32_t* __restrict__ vertex, const float* __restrict__ y) {
    room(n);
    const float* __restrict__ const p = graph_.vertices.p.data();
    float *__restrict__ const ox = segments_.o[0].data(), *__restrict__ const oy = segments_.o[1].data(), *__restrict__ const oz = segments_.o[2].data();
    float *__restrict__ const dx = segments_.inv_d[0].data(), *__restrict__ const dy = segments_.inv_d[1].data(), *__restrict__ const dz = segments_.inv_d[2].data();
    float* __restrict__ const t_max = segments_.t_max.data();
    std::uint32_t* __restrict__ const in_block = vertices_.data();
    for (std::size_t i = 0; i < n; ++i) {
        const std::size_t j = vertex[i];
        const float w = y[4 * i + 3];
        ox[i] = p[3 * j];
        oy[i] = p[3 * j + 1];
        oz[i] = p[3 * j + 2];
        dx[i] = y[4 * i] - w * ox[i];
        dy[i] = y[4 * i + 1] - w * oy[i];
        dz[i] = y[4 * i + 2] - w * oz[i];
        t_max[i] = w != 0 ? 1.0f : INFINITY;
        in_block[i] = std::uint32_t(j - first_);
    }
}

void CandidatePaths::answer(std::size_t n, const Obstacles& obstacles) {
    for (int c = 0; c < 3; ++c) {
        float* const d = segments_.inv_d[c].data();
        for (std::size_t i = 0; i < n; ++i) d[i] = 1 / d[i];
    }
    find_met(segments_, n, obstacles.boxes().data(), obstacles.boxes().size());
}

/// Segment i arrives at vertex i of the block.
void CandidatePaths::arrivals(std::size_t begin, std::size_t end) {
    const auto& first = graph_.paths.first_vertex;
    const std::size_t n = first[end] - first_;
    room(n);
    const float* const p = graph_.vertices.p.data() + 3 * first_;
    for (int c = 0; c < 3; ++c) {
        float *const o = segments_.o[c].data(), *const d = segments_.inv_d[c].data();
        for (std::size_t i = 1; i < n; ++i) {
            o[i] = p[3 * i - 3 + std::size_t(c)];
            d[i] = p[3 * i + std::size_t(c)] - o[i];
        }
    }
    std::fill_n(segments_.t_max.begin(), n, 1.0f);
    const bool one_origin = graph_.paths.origin.empty();
    for (std::size_t path = begin; path < end; ++path) {
        const std::size_t i = first[path] - first_;
        if (first[path + 1] - first_ == i) continue;
        const float* const from = one_origin ? &camera_.x : graph_.paths.origin.data() + 3 * path;
        for (int c = 0; c < 3; ++c) {
            segments_.o[c][i] = from[c];
            segments_.inv_d[c][i] = p[3 * i + std::size_t(c)] - from[c];
        }
    }
    answer(n, reach_.new_places);
    for (std::size_t i = 0; i < n; ++i) met_[i] |= segments_.met[i];
}

void CandidatePaths::light_edges(std::size_t last_vertex) {
    const auto& e = graph_.light_edges;
    const std::size_t begin = first_row(e.vertex, first_), end = first_row(e.vertex, last_vertex, begin),
                      n = end - begin;
    if (reach_.any_emitter || reach_.any_relit)
        for (std::size_t k = begin; k < end; ++k)
            if (reach_.emitters[e.emitter[k]] | reach_.relit[e.emitter[k]]) met_[e.vertex[k] - first_] |= other_light;
    if (reach_.new_places.empty()) return;
    fill(n, e.vertex.data() + begin, e.y.data() + 4 * begin);
    answer(n, reach_.new_places);
    mark(n);
}

void CandidatePaths::misses(std::size_t last_vertex) {
    if (!reach_.any_emitter && reach_.old_places.empty() && reach_.new_places.empty()) return;
    const auto& m = graph_.misses;
    const std::size_t begin = first_row(m.vertex, first_), end = first_row(m.vertex, last_vertex, begin),
                      n = end - begin;
    const std::uint8_t* const technique = m.technique.data() + begin;
    constexpr auto by_bsdf = std::uint8_t(LightTechnique::bsdf_hit);
    miss_of_.resize(last_vertex - first_);
    for (std::size_t i = n; i-- > 0;) miss_of_[m.vertex[begin + i] - first_] = std::uint32_t(begin + i);
    if (reach_.any_emitter)
        for (std::size_t i = 0; i < n; ++i)
            if (technique[i] != by_bsdf && reach_.emitters[m.emitter[begin + i]])
                met_[m.vertex[begin + i] - first_] |= other_light;
    // An old shape may have occluded the occluded rays; a new shape may occlude the others.
    const auto ask = [&](const Obstacles& obstacles, bool through) {
        if (obstacles.empty()) return;
        fill(n, m.vertex.data() + begin, m.y.data() + 4 * begin);
        for (std::size_t i = 0; i < n; ++i)
            segments_.t_max[i] = (technique[i] == by_bsdf) == through ? segments_.t_max[i] : -1.0f;
        answer(n, obstacles);
        mark(n);
    };
    ask(reach_.old_places, false);
    if (std::find(technique, technique + n, by_bsdf) != technique + n) ask(reach_.new_places, true);
}

void CandidatePaths::find(std::size_t begin, std::size_t end, std::uint8_t* may) {
    const auto& first = graph_.paths.first_vertex;
    // An escaped camera ray has no row.
    const bool escaped = reach_.sky || !reach_.new_places.empty();
    for (std::size_t path = begin; path < end; ++path)
        may[path - begin] = std::uint8_t(!tells_ || (escaped && first[path] == first[path + 1]));
    if (!tells_) return;
    if (reach_.any_relit)
        for (std::size_t path = begin; path < end; ++path)
            may[path - begin] |= std::uint8_t(!is_black(rgb(graph_.paths.Le, path)));
    const auto& v = graph_.vertices;
    const std::size_t last = first[end];
    first_ = first[begin];
    met_.assign(last - first_, 0);
    if (last == first_) return;
    if (any_shape_)
        for (std::size_t j = first_; j < last; ++j) met_[j - first_] = reach_.shapes[v.shape[j]];
    if (reach_.sky || reach_.dark_light)
        for (std::size_t j = first_; j < last; ++j) {
            const Ending ending = ending_of(v.flags[j]);
            if ((reach_.sky && ending == Ending::escaped) || (reach_.dark_light && ending == Ending::hit_emitter))
                met_[j - first_] |= other_light;
        }
    if (!reach_.new_places.empty()) arrivals(begin, end);
    light_edges(last);
    misses(last);
    std::size_t path = begin;
    for (auto at = std::find_if(met_.begin(), met_.end(), [](std::uint8_t met) { return met != 0; }); at != met_.end();
         at = std::find_if(at, met_.end(), [](std::uint8_t met) { return met != 0; })) {
        const std::size_t j = first_ + std::size_t(at - met_.begin());
        while (first[path + 1] <= j) ++path;
        may[path - begin] = 1;
        at = met_.begin() + std::ptrdiff_t(first[path + 1] - first_);
    }
}

}  // namespace loom::residual
