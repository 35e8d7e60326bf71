#pragma once
// The paths of a graph as the tracer computed them.

#include <algorithm>
#include <vector>

#include "stages/core/graph/graph_reader.h"
#include "stages/core/tracing/vertex_rules.h"

namespace loom::residual {

/// Reconstructs from a path's own random stream what the columns do not store. Borrows scene and graph. Vertices are
/// rows of the graph.
class StoredPaths {
  public:
    /// in:      options  with which the graph was traced in the scene
    StoredPaths(const Scene& scene, const GraphReader& reader, const PathOptions& options)
        : scene_(scene), reader_(reader), options_(options) {}

    const Scene& scene() const { return scene_; }
    const GraphReader& reader() const { return reader_; }
    const PathGraph& graph() const { return reader_.graph(); }
    const PathOptions& options() const { return options_; }

    PathId id(std::size_t path) const {
        const std::size_t n_pixels = graph().n_pixels();
        return {path % n_pixels, graph().tracing.first_sample + path / n_pixels};
    }
    Sampler sampler(std::size_t path) const {
        const PathId of = id(path);
        return {options_.sampler, options_.seed, of.pixel, of.sample};
    }
    Ray camera_ray(std::size_t path) const {
        const std::uint64_t pixel = id(path).pixel;
        return scene_.sensor.sample_ray(std::uint32_t(pixel % graph().sensor.width),
                                        std::uint32_t(pixel / graph().sensor.width), sampler(path).pair(film_pair));
    }
    Point3f camera(std::size_t path) const { return camera_origin(graph(), path); }
    /// Returns the emitter that is directly visible to the camera; -1: none.
    int seen_emitter(std::size_t path) const {
        const PathGraph& g = graph();
        if (is_black(rgb(g.paths.Le, path))) return -1;
        const std::size_t j = g.paths.first_vertex[path];
        return j == g.paths.first_vertex[path + 1] ? scene_.environment_idx
                                                   : scene_.shapes[g.vertices.shape[j]].emitter_idx;
    }
    /// Returns the index of a vertex in its path, from 1; also the index of the edge that leads to it.
    int depth(std::size_t path, std::size_t vertex) const { return int(vertex - graph().paths.first_vertex[path]) + 1; }
    Point3f position(std::size_t vertex) const { return loom::position(graph(), vertex); }
    Normal3f ng(std::size_t vertex) const { return geometric_normal(graph(), vertex); }
    RayEnd end(std::size_t vertex) const {
        return {position(vertex), ng(vertex), scene_.shapes[graph().vertices.shape[vertex]].hit_error};
    }
    /// Returns the whole vertex, identical to the tracer's.
    ShadingPoint shading_point(std::size_t vertex) const {
        ShadingPoint here = reader_.vertex(vertex);
        here.hit_error = end(vertex).hit_error;
        return here;
    }
    /// Returns the direction of the ray that found a vertex.
    Vector3f arrival(std::size_t vertex) const { return -outgoing(graph(), vertex); }
    float survival(std::size_t vertex) const { return graph().vertices.q.empty() ? 1.0f : graph().vertices.q[vertex]; }
    BsdfSample<float> redraw(const ShadingPoint& here, const Sampler& sampler, int depth) const {
        return draw(here, sampler, depth, sampler.pair(dimension(depth, Dimension::direction)));
    }
    /// Returns the ray from a vertex along its BSDF sample.
    Ray sampled_ray(std::size_t path, std::size_t vertex) const {
        const ShadingPoint here = shading_point(vertex);
        return spawn_ray(here.end(), here.frame.to_world(redraw(here, sampler(path), depth(path, vertex)).wi));
    }

  private:
    const Scene& scene_;
    const GraphReader& reader_;
    PathOptions options_;
};

/// The tracer's records of first hits of paths, depth up to rounding. State of one thread.
class FirstHits {
  public:
    explicit FirstHits(const StoredPaths& paths) : paths_(paths) {
        for (std::size_t i = 0; i < paths.graph().materials.kind.size(); ++i)
            for (const float side : {1.0f, -1.0f})
                diffuse_.push_back(albedo(Bsdf<float>(paths.reader().model(i)), {0, 0, side}));
    }

    FirstHit of(std::size_t path) {
        const PathGraph& g = paths_.graph();
        const std::size_t j = g.paths.first_vertex[path];
        if (j == g.paths.first_vertex[path + 1]) return {};
        const std::int16_t* const code = g.vertices.ns.data() + 2 * j;
        if (code[0] != last_code_[0] || code[1] != last_code_[1]) {
            last_normal_ = shading_normal(g, j);
            std::copy(code, code + 2, last_code_);
        }
        const Vector3f v = paths_.position(j) - paths_.camera(path);
        const std::size_t material = g.vertices.material[j];
        const bool diffuse =
            paths_.reader().model(material).kind == BsdfKind::diffuse && g.materials.textured[material] == 0;
        // An albedo depends on the angle to the normal only, a diffuse one on the side only.
        return {diffuse ? diffuse_[2 * material + (dot(v, last_normal_) > 0)]
                        : albedo(paths_.reader().bsdf(j), {0, 0, dot(-paths_.arrival(j), last_normal_)}),
                last_normal_, length(v)};
    }

  private:
    const StoredPaths& paths_;
    std::vector<Spectrum> diffuse_;  // [material and side] albedo of diffuse materials without texture
    // Code of the last normal, and that normal; consecutive first hits often lie on one surface.
    std::int16_t last_code_[2] = {0, 0};
    Normal3f last_normal_{0, 0, 1};
};

}  // namespace loom::residual
