#include "stages/residual/stored/touched_paths.h"

#include <algorithm>
#include <memory>

namespace loom::residual {
namespace {

/// A segment ends this much behind the point that it leads to: a surface of the edit may lie in the very place of
/// another.
float beyond(float t, const Point3f& p) {
    constexpr float slack = 1e-5f;
    return t * (1 + slack) + slack * std::max({std::abs(p.x), std::abs(p.y), std::abs(p.z)});
}

constexpr std::size_t queue_size = 1024;

}  // namespace

TouchedPaths::TouchedPaths(const StoredPaths& paths, const EditReach& reach)
    : paths_(paths), reach_(reach), candidates_(paths.scene(), reach, paths.graph()) {
    for (Queue* queue : {&through_, &blocked_}) queue->rays.reserve(2 * queue_size);
}

/// What the vertex asked for and did not get: light that was not seen.
void TouchedPaths::look_at_failed_light(std::size_t path, std::size_t j) {
    if (!(paths_.graph().vertices.flags[j] & vertex_flag::attempted_nee)) return;
    const Point3f p = paths_.position(j);
    const bool may_be_freed =
        !reach_.old_places.empty() && (!reach_.bounded_lights || reach_.old_places.may_meet(p, reach_.lights));
    if (!may_be_freed && !reach_.any_emitter) return;
    const std::uint32_t in_block = std::uint32_t(path - begin_), vertex = std::uint32_t(j - first_vertex_);
    const FailedLight light = failed_light(path, j, p);
    if (reach_.emitters[light.emitter]) return sample_again(in_block, vertex);
    if (!may_be_freed || !light.asked) return;
    if (light.at_infinity ? reach_.old_places.may_meet(p, Vector3f(light.y)) : reach_.old_places.may_meet(p, light.y))
        blocked_.add(
            light.at_infinity ? spawn_ray(paths_.end(j), Vector3f(light.y)) : spawn_segment(paths_.end(j), {light.y}),
            {in_block, vertex, false});
}

TouchedPaths::FailedLight TouchedPaths::failed_light(std::size_t path, std::size_t j, const Point3f& p) const {
    if (candidates_.tells()) {
        const auto& m = paths_.graph().misses;
        const std::size_t k = candidates_.miss_of(j);
        const Point3f y{m.y[4 * k], m.y[4 * k + 1], m.y[4 * k + 2]};
        const bool at_infinity = m.y[4 * k + 3] == 0;
        return {m.emitter[k], y, at_infinity, at_infinity || !(y == p)};
    }
    const LightSample light =
        sample_light(paths_.scene(), p, paths_.sampler(path).pair(dimension(paths_.depth(path, j), Dimension::light)));
    return {light.emitter, light.at_infinity ? Point3f(light.wi) : light.y, light.at_infinity, light.pdf_w > 0};
}

void TouchedPaths::look_at(std::size_t path) {
    const PathGraph& g = paths_.graph();
    const auto& v = g.vertices;
    const auto& e = g.light_edges;
    const std::size_t first = g.paths.first_vertex[path], last = g.paths.first_vertex[path + 1], edges = next_edge_;
    while (next_edge_ < e.vertex.size() && e.vertex[next_edge_] < last) ++next_edge_;
    const std::uint32_t in_block = std::uint32_t(path - begin_), n = std::uint32_t(last - first);
    const Obstacles& ahead = reach_.new_places;
    const Scene& scene = paths_.scene();
    if (!reach_.everything.empty()) return cut(in_block, 0);

    if (const int seen = reach_.any_relit ? paths_.seen_emitter(path) : -1;
        seen >= 0 && reach_.relit[std::size_t(seen)])
        touched_[in_block] = 1;
    if (first == last) {
        if (reach_.sky) return cut(in_block, 0);
        if (ahead.empty()) return;
        const Ray ray = paths_.camera_ray(path);
        if (ahead.may_meet(ray.o, ray.d)) through_.add(ray, {in_block, 0, true});
        return;
    }
    // What needs no ray to be known; rays behind that need not be asked.
    for (std::size_t j = first; j < last; ++j) {
        if (!reach_.shapes[v.shape[j]]) continue;
        if (reach_.repainted[v.shape[j]] >= 0) {
            repainted_[in_block] = touched_[in_block] = 1;
            continue;
        }
        cut(in_block, std::uint32_t(j - first));
        break;
    }
    for (std::size_t k = edges; k < next_edge_; ++k) {
        const std::size_t emitter = e.emitter[k];
        if (reach_.relit[emitter]) touched_[in_block] = 1;
        if (e.technique[k] == std::uint8_t(LightTechnique::bsdf_hit)) {
            // A ray may have ended on a shape that only shines.
            if (reach_.emitters[emitter] || (e.y[4 * k + 3] == 1 && reach_.shapes[scene.emitters[emitter].shape]))
                cut(in_block, std::uint32_t(e.vertex[k] - first + 1));
        } else if (reach_.emitters[emitter]) {
            sample_again(in_block, std::uint32_t(e.vertex[k] - first_vertex_));
        }
    }

    const std::uint32_t end = cuts_[in_block];
    std::size_t k = edges;
    for (std::size_t j = first; j < last && j - first < end; ++j) {
        if (!candidates_.may_touch(j)) continue;
        while (k < next_edge_ && e.vertex[k] < j) ++k;
        const Point3f p = paths_.position(j), from = j == first ? paths_.camera(path) : paths_.position(j - 1);
        const std::uint32_t number = std::uint32_t(j - first), vertex = std::uint32_t(j - first_vertex_);
        const Asked arriving{in_block, number, true}, leaving{in_block, number + 1, true};
        if (!ahead.empty() && ahead.may_meet(from, p)) {
            const Vector3f d = paths_.arrival(j);
            const Point3f o = j == first ? from : spawn_ray(paths_.end(j - 1), d).o;
            through_.add({o, d, 0, beyond(dot(p - o, d), p)}, arriving);
        }
        bool light_found = false, hit_found = false;
        for (; k < next_edge_ && e.vertex[k] == j; ++k) {
            const bool by_hit = e.technique[k] == std::uint8_t(LightTechnique::bsdf_hit),
                       at_infinity = e.y[4 * k + 3] == 0;
            (by_hit ? hit_found : light_found) = true;
            if (ahead.empty() || (by_hit && number + 1 >= end)) continue;
            const Point3f y{e.y[4 * k], e.y[4 * k + 1], e.y[4 * k + 2]};
            const Asked asked = by_hit ? leaving : Asked{in_block, vertex, false};
            if (at_infinity) {
                if (ahead.may_meet(p, Vector3f(y))) through_.add(spawn_ray(paths_.end(j), Vector3f(y)), asked);
            } else if (ahead.may_meet(p, y)) {
                Ray ray = spawn_segment(paths_.end(j), {y});
                if (by_hit) {
                    // It lies in the direction of the ray from the vertex, not from where the ray started.
                    const float distance = length(y - p);
                    ray = spawn_ray(paths_.end(j), (y - p) / distance);
                    ray.t_max = beyond(distance, y);
                }
                through_.add(ray, asked);
            }
        }
        if (!light_found) look_at_failed_light(path, j);
        if (j + 1 < last || n >= end) continue;
        const Ending ending = ending_of(v.flags[j]);
        if ((ending == Ending::escaped && reach_.sky) ||
            (ending == Ending::hit_emitter && !hit_found && reach_.dark_light)) {
            cut(in_block, n);
        } else if ((ending == Ending::escaped || ending == Ending::hit_emitter) && !hit_found && !ahead.empty()) {
            const Ray ray = paths_.sampled_ray(path, j);
            if (ahead.may_meet(p, ray.d)) through_.add(ray, leaving);
        }
    }
}

void TouchedPaths::answer(Queue& queue, const Obstacles& obstacles) {
    const std::size_t n = queue.rays.size();
    if (n == 0) return;
    pointers_.resize(n);
    for (std::size_t i = 0; i < n; ++i) pointers_[i] = &queue.rays[i];
    const auto met = std::make_unique_for_overwrite<bool[]>(n);
    obstacles.meet(pointers_.data(), n, met.get());
    for (std::size_t i = 0; i < n; ++i) {
        if (!met[i]) continue;
        const Asked& asked = queue.asked[i];
        if (asked.arrives)
            cut(asked.path, asked.vertex);
        else
            sample_again(asked.path, asked.vertex);
    }
    queue.rays.clear();
    queue.asked.clear();
}

void TouchedPaths::find(std::size_t begin, std::size_t end, std::uint8_t* touched, PathChanges& changes) {
    const PathGraph& g = paths_.graph();
    const auto& first_vertex = g.paths.first_vertex;
    const auto& edge_vertex = g.light_edges.vertex;
    begin_ = begin;
    first_vertex_ = first_vertex[begin];
    next_edge_ = first_row(edge_vertex, first_vertex_);
    touched_ = touched;
    cuts_.assign(end - begin, PathChange::never);
    repainted_.assign(end - begin, 0);
    again_.assign(first_vertex[end] - first_vertex_, 0);
    edges_.resize(end - begin);
    const std::size_t last_edge = first_row(edge_vertex, first_vertex[end], next_edge_);
    candidates_.find(begin, end, touched);
    for (std::size_t path = begin; path < end; ++path) {
        if (!touched[path - begin]) continue;
        touched[path - begin] = 0;
        next_edge_ = first_row(edge_vertex, first_vertex[path], next_edge_, last_edge);
        edges_[path - begin] = next_edge_;
        look_at(path);
        if (through_.rays.size() >= queue_size) answer(through_, reach_.new_places);
        if (blocked_.rays.size() >= queue_size) answer(blocked_, reach_.old_places);
    }
    answer(through_, reach_.new_places);
    answer(blocked_, reach_.old_places);
    for (std::size_t i = 0; i < end - begin; ++i) {
        if (!touched[i]) continue;
        const std::size_t first = first_vertex[begin + i], n = first_vertex[begin + i + 1] - first;
        PathChange& change = changes.paths.emplace_back();
        change.path = begin + i;
        change.edge = edges_[i];
        change.cut = cuts_[i];
        change.repainted = repainted_[i];
        for (std::size_t j = first; j < first + std::min<std::size_t>(n, change.cut); ++j) {
            if (!again_[j - first_vertex_]) continue;
            changes.again.push_back(std::uint32_t(j));
            ++change.n_again;
        }
    }
}

}  // namespace loom::residual
