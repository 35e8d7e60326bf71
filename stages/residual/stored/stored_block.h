#pragma once
// What walks along stored paths need of their vertices, computed when it is first asked for: once for all new scenes.

#include <cstdint>
#include <deque>
#include <span>
#include <vector>

#include "stages/residual/stored/stored_paths.h"

namespace loom::residual {

/// A vertex as the tracer left it. A plain diffuse surface needs cosines alone, without a frame.
struct StoredVertex {
    static constexpr std::uint32_t none = ~0u;
    RayEnd end;
    float q = 1;             // probability to survive roulette
    Spectrum weight;         // of the tracer's BSDF sample
    Lobe lobe{};             // of that sample
    bool diffuse = false;    // without frame; else whole() has all
    Spectrum reflectance;    // diffuse
    Normal3f n;              // diffuse: on the side of wo
    float cos_o = 0;         // diffuse: of wo to n
    Point2f u_light{-1, 0};  // random numbers of the light sample; negative: not yet drawn
    std::uint32_t whole = none;

    /// Returns f |cos| and density of a diffuse vertex.
    BsdfValue<float> f_cos_pdf(const Vector3f& wi) const {
        return DiffuseFamily::f_cos_pdf(reflectance, cos_o, dot(wi, n));
    }
};

/// A diffuse vertex, for sample_next_event().
struct DiffusePoint {
    const StoredVertex& vertex;
    Point3f p;
    explicit DiffusePoint(const StoredVertex& v) : vertex(v), p(v.end.p) {}
    const RayEnd& end() const { return vertex.end; }
};
inline BsdfValue<float> f_cos_pdf(const DiffusePoint& at, const Vector3f& wi) {
    return at.vertex.f_cos_pdf(wi);
}

/// Vertices of consecutive paths of a graph. State of one thread.
class StoredBlock {
  public:
    /// Starts paths [begin, end).
    void start(const StoredPaths& paths, std::size_t begin, std::size_t end);

    const StoredPaths& paths() const { return *paths_; }
    /// Returns the vertices of a path.
    /// in:      sampler  its random numbers
    std::span<StoredVertex> path(std::size_t path, const Sampler& sampler) {
        const auto& first = paths_->graph().paths.first_vertex;
        if (!known_[path - begin_]) read(path, sampler);
        return std::span(vertices_).subspan(first[path] - first_vertex_, first[path + 1] - first[path]);
    }
    /// Returns a whole vertex, identical to the tracer's.
    /// in:  j  its row
    const ShadingPoint& whole(StoredVertex& vertex, std::size_t j) { return read_whole(vertex, j).point; }
    /// Returns the tracer's BSDF sample; of a diffuse vertex only weight and lobe.
    BsdfSample<float> sample(const StoredVertex& vertex) const {
        if (!vertex.diffuse) return wholes_[vertex.whole].sample;
        BsdfSample<float> s;
        s.weight = vertex.weight, s.lobe = vertex.lobe;
        return s;
    }
    /// Returns the direction of that sample.
    Vector3f direction(StoredVertex& vertex, std::size_t j, const Sampler& sampler, int depth) {
        const Whole& whole = read_whole(vertex, j);
        return whole.point.frame.to_world(vertex.diffuse ? paths_->redraw(whole.point, sampler, depth).wi
                                                         : whole.sample.wi);
    }
    Spectrum f_cos(StoredVertex& vertex, std::size_t j, const Vector3f& wi) {
        return vertex.diffuse ? vertex.f_cos_pdf(wi).f_cos : f_cos_pdf(whole(vertex, j), wi).f_cos;
    }
    /// Returns the random numbers of a light sample.
    static Point2f u_light(StoredVertex& vertex, const Sampler& sampler, int depth) {
        if (vertex.u_light.x < 0) vertex.u_light = sampler.pair(dimension(depth, Dimension::light));
        return vertex.u_light;
    }
    /// What a path brings in the old scene; null: not yet known.
    const Spectrum* known_light(std::size_t path) const {
        return has_light_[path - begin_] ? &light_[path - begin_] : nullptr;
    }
    void set_light(std::size_t path, const Spectrum& light) {
        light_[path - begin_] = light;
        has_light_[path - begin_] = 1;
    }

  private:
    struct Whole {
        ShadingPoint point;
        BsdfSample<float> sample;  // unless diffuse
    };
    Whole& read_whole(StoredVertex& vertex, std::size_t j) {
        if (vertex.whole == StoredVertex::none) {
            vertex.whole = std::uint32_t(wholes_.size());
            wholes_.push_back({paths_->shading_point(j), {}});
        }
        return wholes_[vertex.whole];
    }
    void read(std::size_t path, const Sampler& sampler);
    void read(std::size_t j, const Sampler& sampler, int depth, StoredVertex& vertex);

    const StoredPaths* paths_ = nullptr;
    std::size_t begin_ = 0, first_vertex_ = 0;
    std::vector<StoredVertex> vertices_;
    std::deque<Whole> wholes_;
    std::vector<std::uint8_t> known_, has_light_;  // [path]
    std::vector<Spectrum> light_;                  // [path]
};

}  // namespace loom::residual
