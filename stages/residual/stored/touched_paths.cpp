#include "stages/residual/stored/touched_paths.h"

#include <algorithm>
#include <memory>

namespace loom::residual {
namespace {

/// Extends a segment a little beyond its end point, because a surface of the edit may coincide with another.
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

/// Handles a failed light sample of a vertex, whose light was occluded.
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
    return {light.emitter_idx, light.at_infinity ? Point3f(light.wi) : light.y, light.at_infinity, light.density() > 0};
}

void TouchedPaths::look_at(std::size_t path) {
    const PathGraph& g = paths_.graph();
    const auto& edge_vertex = g.light_edges.vertex;
    const Rows of{path, g.paths.first_vertex[path], g.paths.first_vertex[path + 1], next_edge_,
                  std::uint32_t(path - begin_)};
    while (next_edge_ < edge_vertex.size() && edge_vertex[next_edge_] < of.last) ++next_edge_;
    if (!reach_.everything.empty()) return cut(of.in_block, 0);

    if (const int seen = reach_.any_relit ? paths_.seen_emitter(path) : -1;
        seen >= 0 && reach_.relit[std::size_t(seen)])
        touched_[of.in_block] = 1;
    if (of.first == of.last) return look_at_camera_ray(of);
    // Test what needs no ray; rays behind the first change need no test.
    look_at_shapes(of);
    look_at_lights(of);
    look_at_rays(of);
}

/// Tests the ray of a path without vertices.
void TouchedPaths::look_at_camera_ray(const Rows& of) {
    if (reach_.sky) see_other_sky(of.in_block);
    if (reach_.new_places.empty()) return;
    const Ray ray = paths_.camera_ray(of.path);
    if (reach_.new_places.may_meet(ray.o, ray.d)) through_.add(ray, {of.in_block, 0, true});
}

void TouchedPaths::look_at_shapes(const Rows& of) {
    const auto& shape = paths_.graph().vertices.shape;
    for (std::size_t j = of.first; j < of.last; ++j) {
        if (!reach_.shapes[shape[j]]) continue;
        if (reach_.repainted[shape[j]] >= 0) {
            repainted_[of.in_block] = touched_[of.in_block] = 1;
            continue;
        }
        cut(of.in_block, std::uint32_t(j - of.first));
        return;
    }
}

void TouchedPaths::look_at_lights(const Rows& of) {
    const auto& e = paths_.graph().light_edges;
    const auto& emitters = paths_.scene().emitters;
    for (std::size_t k = of.edges; k < next_edge_; ++k) {
        const std::size_t emitter = e.emitter[k];
        if (reach_.relit[emitter]) touched_[of.in_block] = 1;
        if (e.technique[k] == std::uint8_t(LightTechnique::bsdf_hit)) {
            // A ray may have ended on a shape that emits but reflects nothing. What leaves the scene does so still.
            if ((reach_.emitters[emitter] && e.y[4 * k + 3] == 1) ||
                (e.y[4 * k + 3] == 1 && reach_.shapes[emitters[emitter].shape_idx]))
                cut(of.in_block, std::uint32_t(e.vertex[k] - of.first + 1));
        } else if (reach_.emitters[emitter]) {
            sample_again(of.in_block, std::uint32_t(e.vertex[k] - first_vertex_));
        }
    }
}

/// Tests the ray that hit a vertex.
inline void TouchedPaths::look_at_arriving_ray(const Rows& of, std::size_t j, const Point3f& p) {
    const Obstacles& ahead = reach_.new_places;
    const Point3f from = j == of.first ? paths_.camera(of.path) : paths_.position(j - 1);
    if (ahead.empty() || !ahead.may_meet(from, p)) return;
    const Vector3f d = paths_.arrival(j);
    const Point3f o = j == of.first ? from : spawn_ray(paths_.end(j - 1), d).o;
    through_.add({o, d, 0, beyond(dot(p - o, d), p)}, {of.in_block, std::uint32_t(j - of.first), true});
}

/// Tests the ray along light edge k.
inline void TouchedPaths::look_at_light_ray(const Rows& of, std::size_t k, const Point3f& p) {
    const Obstacles& ahead = reach_.new_places;
    const auto& e = paths_.graph().light_edges;
    const std::size_t j = e.vertex[k];
    const bool by_hit = e.technique[k] == std::uint8_t(LightTechnique::bsdf_hit), at_infinity = e.y[4 * k + 3] == 0;
    const Point3f y{e.y[4 * k], e.y[4 * k + 1], e.y[4 * k + 2]};
    const Asked asked = by_hit ? Asked{of.in_block, std::uint32_t(j - of.first + 1), true}
                               : Asked{of.in_block, std::uint32_t(j - first_vertex_), false};
    if (at_infinity) {
        if (ahead.may_meet(p, Vector3f(y))) through_.add(spawn_ray(paths_.end(j), Vector3f(y)), asked);
    } else if (ahead.may_meet(p, y)) {
        Ray ray = spawn_segment(paths_.end(j), {y});
        if (by_hit) {
            // The light point lies along the ray's direction from the vertex, not from the ray's origin.
            const float distance = length(y - p);
            ray = spawn_ray(paths_.end(j), (y - p) / distance);
            ray.t_max = beyond(distance, y);
        }
        through_.add(ray, asked);
    }
}

/// Tests the ray that left the last vertex and hit no further vertex.
/// in:      hit_found  whether it has hit a light
inline void TouchedPaths::look_at_last_ray(const Rows& of, const Point3f& p, bool hit_found) {
    const Obstacles& ahead = reach_.new_places;
    const std::size_t j = of.last - 1;
    const std::uint32_t n = std::uint32_t(of.last - of.first);
    const Ending ending = ending_of(paths_.graph().vertices.flags[j]);
    if (ending == Ending::escaped && reach_.sky) see_other_sky(of.in_block);
    if (ending == Ending::hit_emitter && !hit_found && reach_.dark_light) {
        cut(of.in_block, n);
    } else if ((ending == Ending::escaped || ending == Ending::hit_emitter) && !hit_found && !ahead.empty()) {
        const Ray ray = paths_.sampled_ray(of.path, j);
        if (ahead.may_meet(p, ray.d)) through_.add(ray, {of.in_block, n, true});
    }
}

/// Tests rays from and to the vertices before the first one that is known to differ.
void TouchedPaths::look_at_rays(const Rows& of) {
    const auto& e = paths_.graph().light_edges;
    const std::uint32_t end = cuts_[of.in_block];
    std::size_t k = of.edges;
    for (std::size_t j = of.first; j < of.last && j - of.first < end; ++j) {
        if (!candidates_.may_touch(j)) continue;
        while (k < next_edge_ && e.vertex[k] < j) ++k;
        const Point3f p = paths_.position(j);
        const bool may_meet = candidates_.may_meet(j);
        if (may_meet) look_at_arriving_ray(of, j, p);
        bool light_found = false, hit_found = false;
        for (; k < next_edge_ && e.vertex[k] == j; ++k) {
            const bool by_hit = e.technique[k] == std::uint8_t(LightTechnique::bsdf_hit);
            (by_hit ? hit_found : light_found) = true;
            if (!may_meet || reach_.new_places.empty() || (by_hit && j - of.first + 1 >= end)) continue;
            look_at_light_ray(of, k, p);
        }
        if (!light_found) look_at_failed_light(of.path, j);
        if (j + 1 == of.last && of.last - of.first < end) look_at_last_ray(of, p, hit_found);
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
    other_sky_.assign(end - begin, 0);
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
        change.sky = other_sky_[i];
        for (std::size_t j = first; j < first + std::min<std::size_t>(n, change.cut); ++j) {
            if (!again_[j - first_vertex_]) continue;
            changes.again.push_back(std::uint32_t(j));
            ++change.n_again;
        }
    }
}

}  // namespace loom::residual
