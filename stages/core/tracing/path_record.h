#pragma once
// Paths as the tracer records them: vertices and light edges in the order of tracing, which for a batch of paths is depth
// by depth. GraphBuilder sorts them by path, into columns.

#include <array>
#include <cstdint>
#include <vector>

#include "formats/io/octahedral.h"
#include "formats/path_graph.h"
#include "stages/core/scene/scene.h"
#include "stages/core/scene/shading.h"

namespace loom {

/// Unit vector and colour in the types of their columns.
using NormalCode = std::array<std::int16_t, 2>;
using HalfColor = std::array<Half, 3>;

template <class Kind>
NormalCode normal_code(const Triple<float, Kind>& v) {
    return octahedral_from_unit(v.x, v.y, v.z);
}
inline HalfColor half_color(const Spectrum& v) {
    return {half_from_float(v.r), half_from_float(v.g), half_from_float(v.b)};
}

/// A vertex in the types of the columns. Values that the scene does not need keep their defaults.
struct VertexRecord {
    Point3f p;
    Vector3f wo;
    NormalCode ns{}, ng{}, n_side{}, tangent{};
    HalfColor diffuse{}, specular{}, transmittance{};
    std::array<Half, 2> alpha{};
    Half opacity{};
    HalfColor eta_c{}, k_c{};
    float exponent = 0;
    std::uint16_t material_idx = 0, flags = 0;
    Lobe lobe = Lobe::none;
    std::uint16_t medium_idx = Medium::outside;  // Medium::material_idx of the arriving segment
    std::uint32_t shape_idx = 0, primitive_idx = 0, path_idx = 0;
    float pdf_w = 0;  // density of the BSDF sample, roulette folded in
    float q = 1;      // survival probability of roulette
    float eta = 1;    // absolute refractive index of the arriving segment

    void end(Ending ending) { flags = flags_with_ending(flags, ending); }
    /// Fills the values that depend on the arriving ray, apart from textures.
    /// in:  arriving  medium of the arriving segment
    void set_arrival(const Point3f& p_, const Vector3f& wo_, const Normal3f& shading, const Normal3f& geometric,
                     const Normal3f& unperturbed, const Medium& arriving, const SceneFeatures& features) {
        p = p_;
        wo = wo_;
        ns = normal_code(shading);
        if (features.smooth_normals) ng = normal_code(geometric);
        if (features.perturbed_normals) n_side = unperturbed == shading ? ns : normal_code(unperturbed);
        eta = arriving.ior;
        medium_idx = arriving.material_idx;
    }
    /// Fills the values that the shape and its material determine.
    void set_surface(std::uint32_t shape_, std::uint32_t material_, const Bsdf<float>& bsdf,
                     const SceneFeatures& features) {
        shape_idx = shape_;
        material_idx = std::uint16_t(material_);
        if (features.textured_diffuse) diffuse = half_color(bsdf.diffuse);
        if (features.textured_specular) specular = half_color(bsdf.specular);
        if (features.textured_transmittance) transmittance = half_color(bsdf.transmittance);
        if (features.textured_alpha) alpha = {half_from_float(bsdf.alpha_u), half_from_float(bsdf.alpha_v)};
        if (features.textured_opacity) opacity = half_from_float(bsdf.opacity);
        if (features.textured_exponent) exponent = bsdf.exponent;
        if (features.textured_index) eta_c = half_color(bsdf.eta_c), k_c = half_color(bsdf.k_c);
    }
};

struct LightEdgeRecord {
    std::uint32_t path_idx = 0, vertex_idx = 0;  // vertex: within the path
    LightTechnique technique = LightTechnique::next_event;
    bool at_infinity = false;
    std::uint16_t emitter_idx = 0;
    Point3f y;  // or the direction towards it
    NormalCode n{};
    Spectrum Li;
    float pdf_nee_w = 0, pdf_bsdf_w = 0;
    Medium medium;
};

/// A light edge of vertex number `vertex` of a path.
/// in:  light       point, normal, emitter and Li; density() of next-event estimation, 0 where it does not find the point
///      pdf_bsdf_w  of BSDF sampling, roulette folded in
///      medium      of the edge
inline LightEdgeRecord light_edge(std::uint32_t vertex, LightTechnique technique, const LightSample& light,
                                  float pdf_bsdf_w, const Medium& medium) {
    LightEdgeRecord edge;
    edge.vertex_idx = vertex;
    edge.technique = technique;
    edge.at_infinity = light.at_infinity;
    edge.emitter_idx = light.emitter_idx;
    edge.y = light.y;
    edge.n = normal_code(light.n == Normal3f{} ? Normal3f{0, 0, 1} : light.n);
    edge.Li = light.Li;
    edge.pdf_nee_w = light.density();
    edge.pdf_bsdf_w = pdf_bsdf_w;
    edge.medium = medium;
    return edge;
}

/// A sample of a vertex that found no light: an occluded light sample or a BSDF sample that hit no emitter.
struct MissRecord {
    std::uint32_t path_idx = 0, vertex_idx = 0;  // vertex: within the path
    LightTechnique technique = LightTechnique::next_event;
    std::uint16_t emitter_idx = 0;
    bool at_infinity = false;
    // end of the shadow ray, or its direction; direction of the BSDF sample; the vertex itself where no ray was traced
    Point3f y;
};

struct PathRecords {
    struct Path {
        Point3f origin;
        Spectrum Le;  // of the directly visible emitter
        std::uint32_t n_vertices = 0, n_light_edges = 0, n_misses = 0;
        std::uint32_t last_idx = 0;  // latest vertex, among those of all paths
    };
    std::vector<Path> paths;
    std::vector<VertexRecord> vertices;
    std::vector<LightEdgeRecord> light_edges;
    std::vector<MissRecord> misses;
    bool keeps_misses = false;  // else they are not recorded

    void start(std::size_t n_paths) {
        paths.assign(n_paths, {});
        vertices.clear();
        light_edges.clear();
        misses.clear();
    }
};

/// Appends to the records of one path.
class PathRecorder {
  public:
    PathRecorder() = default;
    PathRecorder(PathRecords& records, std::uint32_t path) : records_(&records), path_(path) {}

    PathRecords::Path& path() const { return records_->paths[path_]; }
    VertexRecord& last() const { return records_->vertices[path().last_idx]; }
    std::uint32_t last_number() const { return path().n_vertices - 1; }

    /// Adds a vertex on a surface.
    /// in:  arriving  medium of the arriving segment
    VertexRecord& add(const Scene& scene, const SurfacePoint& at, const ShadingPoint& here,
                      const Medium& arriving) const {
        VertexRecord& vertex = add(VertexRecord{});
        vertex.set_arrival(here.p, here.wo, here.frame.n, here.ng, here.n_side, arriving, scene.features);
        vertex.primitive_idx = at.primitive_idx;
        if (scene.features.anisotropic) vertex.tangent = normal_code(here.frame.s);
        vertex.set_surface(at.shape_idx, at.material_idx, here.bsdf, scene.features);
        return vertex;
    }
    VertexRecord& add(const VertexRecord& like) const {
        PathRecords::Path& mine = path();
        mine.last_idx = std::uint32_t(records_->vertices.size());
        ++mine.n_vertices;
        VertexRecord& vertex = records_->vertices.emplace_back(like);
        vertex.path_idx = path_;
        return vertex;
    }
    void add(const LightEdgeRecord& edge) const {
        ++path().n_light_edges;
        records_->light_edges.emplace_back(edge).path_idx = path_;
    }
    /// A light sample without a shadow ray, as it contributes zero.
    void miss(std::uint16_t emitter) const {
        keep({.vertex_idx = last_number(), .emitter_idx = emitter, .y = last().p});
    }
    /// An occluded light sample.
    void miss(const LightEdgeRecord& edge) const {
        keep({.vertex_idx = edge.vertex_idx,
              .emitter_idx = edge.emitter_idx,
              .at_infinity = edge.at_infinity,
              .y = edge.y});
    }
    /// A BSDF sample that hit no emitter.
    void miss(const Vector3f& d) const {
        keep(
            {.vertex_idx = last_number(), .technique = LightTechnique::bsdf_hit, .at_infinity = true, .y = Point3f(d)});
    }

  private:
    void keep(const MissRecord& miss) const {
        if (!records_->keeps_misses) return;
        ++path().n_misses;
        records_->misses.emplace_back(miss).path_idx = path_;
    }

    PathRecords* records_ = nullptr;
    std::uint32_t path_ = 0;
};

}  // namespace loom
