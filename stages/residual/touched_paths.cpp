#include "stages/residual/touched_paths.h"

#include <algorithm>
#include <memory>

#include "stages/core/transport/path_step.h"

namespace loom::residual {
namespace {

/// A segment ends this much behind the point that it leads to: a surface of the edit may lie in the very place of another.
float beyond(float t, const Point3f& p) {
    constexpr float slack = 1e-5f;
    return t * (1 + slack) + slack * (1 + std::max({std::abs(p.x), std::abs(p.y), std::abs(p.z)}));
}

constexpr std::size_t queue_size = 1024;

}  // namespace

TouchedPaths::TouchedPaths(const Scene& old_scene, const EditReach& reach, const GraphReader& reader, const PathOptions& options)
    : scene_(old_scene), reach_(reach), candidates_(old_scene, reach, reader.graph()), reader_(reader), options_(options) {
    for (Queue* queue : {&through_, &blocked_}) queue->rays.reserve(2 * queue_size);
    for (std::size_t i = 0; i < reader.graph().materials.kind.size(); ++i)
        for (const float side : {1.0f, -1.0f}) matte_.push_back(albedo(Bsdf<float>(reader.model(i)), {0, 0, side}));
}

Sampler TouchedPaths::sampler_of(std::size_t path) const {
    const std::size_t n_pixels = reader_.graph().n_pixels();
    return {options_.sampler, options_.seed, path % n_pixels, reader_.graph().tracing.first_sample + path / n_pixels};
}

Point3f TouchedPaths::camera_of(std::size_t path) const {
    const auto& origin = reader_.graph().paths.origin;
    return origin.empty() ? scene_.sensor.origin : Point3f{origin[3 * path], origin[3 * path + 1], origin[3 * path + 2]};
}

Point3f TouchedPaths::position(std::size_t j) const {
    const float* p = reader_.graph().vertices.p.data() + 3 * j;
    return {p[0], p[1], p[2]};
}

Vector3f TouchedPaths::arrival(std::size_t j) const {
    const float* wo = reader_.graph().vertices.wo.data() + 3 * j;
    return {-wo[0], -wo[1], -wo[2]};
}

FirstHit TouchedPaths::first_hit(std::size_t i) {
    const PathGraph& g = reader_.graph();
    const std::size_t j = g.paths.first_vertex[i];
    if (j == g.paths.first_vertex[i + 1]) return {};
    const std::int16_t* const code = g.vertices.ns.data() + 2 * j;
    if (code[0] != last_code_[0] || code[1] != last_code_[1]) {
        last_normal_ = unit_vector<Normal3f>(g.vertices.ns, j);
        std::copy(code, code + 2, last_code_);
    }
    const Vector3f d = arrival(j);
    const float cosine = dot(-d, last_normal_);
    const std::size_t material = g.vertices.material[j];
    const bool matte = reader_.model(material).kind == BsdfKind::diffuse && g.materials.textured[material] == 0;
    // An albedo depends on the angle to the normal alone, a matte one on the side.
    return {matte ? matte_[2 * material + (cosine < 0)] : albedo(reader_.bsdf(j), {0, 0, cosine}), last_normal_, dot(position(j) - camera_of(i), d)};
}

BsdfSample<float> TouchedPaths::redraw(const ShadingPoint& here, std::size_t path, std::size_t j) const {
    const Sampler sampler = sampler_of(path);
    const int depth = int(j - reader_.graph().paths.first_vertex[path]) + 1;
    return sample(here.bsdf, here.wo_local, sampler.pair(dimension(depth, Place::lobe)).x, sampler.pair(dimension(depth, Place::direction)));
}

Ray TouchedPaths::sampled_ray(std::size_t path, std::size_t j) const {
    const ShadingPoint here = reader_.vertex(j);
    return spawn_ray(here.p, here.ng, here.frame.to_world(redraw(here, path, j).wi));
}

Spectrum TouchedPaths::light(std::size_t path, std::size_t k) const {
    const PathGraph& g = reader_.graph();
    const auto& e = g.light_edges;
    const std::size_t first = g.paths.first_vertex[path], last = g.paths.first_vertex[path + 1];
    Spectrum L = rgb(g.paths.Le, path), beta(1);
    for (std::size_t j = first; j < last && k < e.vertex.size() && e.vertex[k] < last; ++j) {
        const ShadingPoint here = reader_.vertex(j);
        for (; k < e.vertex.size() && e.vertex[k] == j && e.technique[k] == std::uint8_t(LightTechnique::next_event); ++k) {
            const float weight = power_heuristic(e.pdf_nee_w[k], e.pdf_bsdf_w[k]) / e.pdf_nee_w[k];
            L += beta * f_cos_pdf(here, reader_.light_direction(here.p, k)).f_cos * rgb(e.Li, k) * weight;
        }
        if (k == e.vertex.size() || e.vertex[k] >= last) break;
        BsdfSample<float> s = redraw(here, path, j);
        if (here.perturbed && s.lobe != Lobe::null) s.weight *= bump_shadowing(here, here.frame.to_world(s.wi), s.wi.z);
        beta *= s.weight * (1 / (g.vertices.q.empty() ? 1.0f : g.vertices.q[j]));
        for (; k < e.vertex.size() && e.vertex[k] == j; ++k) L += beta * rgb(e.Li, k) * power_heuristic(e.pdf_bsdf_w[k], e.pdf_nee_w[k]);
    }
    return L;
}

/// What the vertex asked for and did not get: light that was not seen.
bool TouchedPaths::vertex_touches(std::size_t path, std::size_t j, bool light_found, std::uint32_t in_block) {
    const PathGraph& g = reader_.graph();
    const Point3f p = position(j);
    const auto ng = [&] { return unit_vector<Normal3f>(g.vertices.ng.empty() ? g.vertices.ns : g.vertices.ng, j); };
    if (light_found || !(g.vertices.flags[j] & vertex_flag::attempted_nee)) return false;
    const bool may_be_freed =
        !reach_.old_places.empty() && (!reach_.bounded_lights || reach_.old_places.may_meet(p, reach_.lights));
    if (!may_be_freed && !reach_.any_emitter) return false;
    const int depth = int(j - g.paths.first_vertex[path]) + 1;
    const LightSample light = sample_light(scene_, p, sampler_of(path).pair(dimension(depth, Place::light)));
    if (reach_.emitters[light.emitter]) return true;
    if (!may_be_freed || !(light.pdf_w > 0)) return false;
    if (light.at_infinity ? reach_.old_places.may_meet(p, light.wi) : reach_.old_places.may_meet(p, light.y))
        ask(blocked_, light.at_infinity ? spawn_ray(p, ng(), light.wi) : spawn_segment(p, ng(), light.y), in_block);
    return false;
}

bool TouchedPaths::touches(std::size_t path, std::size_t begin) {
    const PathGraph& g = reader_.graph();
    const auto &v = g.vertices;
    const auto &e = g.light_edges;
    const std::size_t first = g.paths.first_vertex[path], last = g.paths.first_vertex[path + 1], edges = next_edge_;
    while (next_edge_ < e.vertex.size() && e.vertex[next_edge_] < last) ++next_edge_;
    const std::uint32_t in_block = std::uint32_t(path - begin);
    const Obstacles& ahead = reach_.new_places;
    if (!reach_.everything.empty()) return true;

    if (first == last) {
        if (reach_.sky) return true;
        if (ahead.empty()) return false;
        const std::uint64_t pixel = path % g.n_pixels();
        const Ray ray = scene_.sensor.sample_ray(std::uint32_t(pixel % g.sensor.width), std::uint32_t(pixel / g.sensor.width), sampler_of(path).pair(film_pair));
        if (ahead.may_meet(ray.o, ray.d)) ask(through_, ray, in_block);
        return false;
    }
    for (std::size_t j = first; j < last; ++j)
        if (reach_.shapes[v.shape[j]]) return true;
    for (std::size_t k = edges; k < next_edge_; ++k) {
        if (reach_.emitters[e.emitter[k]]) return true;
        // A ray may have ended on a shape that only shines.
        if (e.technique[k] == std::uint8_t(LightTechnique::bsdf_hit) && e.y[4 * k + 3] == 1 && reach_.shapes[scene_.emitters[e.emitter[k]].shape]) return true;
    }

    const auto ng = [&](std::size_t j) { return unit_vector<Normal3f>(v.ng.empty() ? v.ns : v.ng, j); };
    std::size_t k = edges;
    Point3f from = camera_of(path);
    for (std::size_t j = first; j < last; ++j) {
        const Point3f p = position(j);
        if (!ahead.empty() && ahead.may_meet(from, p)) {
            const Vector3f d = arrival(j);
            const Point3f o = j == first ? from : offset_origin(from, ng(j - 1), d);
            ask(through_, {o, d, 0, beyond(dot(p - o, d), p)}, in_block);
        }
        from = p;
        bool light_found = false, hit_found = false;
        for (; k < next_edge_ && e.vertex[k] == j; ++k) {
            const bool by_hit = e.technique[k] == std::uint8_t(LightTechnique::bsdf_hit), at_infinity = e.y[4 * k + 3] == 0;
            (by_hit ? hit_found : light_found) = true;
            if (ahead.empty()) continue;
            const Point3f y{e.y[4 * k], e.y[4 * k + 1], e.y[4 * k + 2]};
            if (at_infinity) {
                if (ahead.may_meet(p, Vector3f(y))) ask(through_, spawn_ray(p, ng(j), Vector3f(y)), in_block);
            } else if (ahead.may_meet(p, y)) {
                Ray ray = spawn_segment(p, ng(j), y);
                if (by_hit) {
                    // It lies in the direction of the ray from the vertex, not from where the ray started.
                    const float distance = length(y - p);
                    ray = spawn_ray(p, ng(j), (y - p) / distance);
                    ray.t_max = beyond(distance, y);
                }
                ask(through_, ray, in_block);
            }
        }
        if (vertex_touches(path, j, light_found, in_block)) return true;
        if (j + 1 < last) continue;
        const Ending ending = ending_of(v.flags[j]);
        if (ending == Ending::escaped && reach_.sky) return true;
        if (ending == Ending::hit_emitter && !hit_found && reach_.dark_light) return true;
        if ((ending == Ending::escaped || ending == Ending::hit_emitter) && !hit_found && !ahead.empty()) {
            const Ray ray = sampled_ray(path, j);
            if (ahead.may_meet(p, ray.d)) ask(through_, ray, in_block);
        }
    }
    return false;
}

void TouchedPaths::answer(Queue& queue, const Obstacles& obstacles, std::uint8_t* touched) {
    const std::size_t n = queue.rays.size();
    if (n == 0) return;
    pointers_.resize(n);
    for (std::size_t i = 0; i < n; ++i) pointers_[i] = &queue.rays[i];
    const auto met = std::make_unique_for_overwrite<bool[]>(n);
    obstacles.meet(pointers_.data(), n, met.get());
    for (std::size_t i = 0; i < n; ++i)
        if (met[i]) touched[queue.paths[i]] = 1;
    queue.rays.clear();
    queue.paths.clear();
}

void TouchedPaths::find(std::size_t begin, std::size_t end, std::uint8_t* touched, KnownPath* known) {
    const PathGraph& g = reader_.graph();
    const auto& edge_vertex = g.light_edges.vertex;
    next_edge_ = std::size_t(std::lower_bound(edge_vertex.begin(), edge_vertex.end(), g.paths.first_vertex[begin]) - edge_vertex.begin());
    const std::size_t last_edge = std::size_t(std::lower_bound(edge_vertex.begin(), edge_vertex.end(), g.paths.first_vertex[end]) - edge_vertex.begin());
    edges_.resize(end - begin);
    candidates_.find(begin, end, touched);
    for (std::size_t path = begin; path < end; ++path) {
        if (!touched[path - begin]) continue;
        next_edge_ = std::size_t(std::lower_bound(edge_vertex.begin() + std::ptrdiff_t(next_edge_), edge_vertex.begin() + std::ptrdiff_t(last_edge), g.paths.first_vertex[path]) - edge_vertex.begin());
        edges_[path - begin] = next_edge_;
        touched[path - begin] = touches(path, begin) ? 1 : 0;
        if (through_.rays.size() >= queue_size) answer(through_, reach_.new_places, touched);
        if (blocked_.rays.size() >= queue_size) answer(blocked_, reach_.old_places, touched);
    }
    answer(through_, reach_.new_places, touched);
    answer(blocked_, reach_.old_places, touched);
    for (std::size_t i = 0; i < end - begin; ++i)
        if (touched[i]) known[i].L = light(begin + i, edges_[i]);
        else known[i].first = first_hit(begin + i);
}

}  // namespace loom::residual
