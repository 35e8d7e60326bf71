#pragma once
// The values that a cluster reads of its vertices and their light edges, in one cache line each. The graph would need
// one cache line in each of many columns.

#include <span>
#include <vector>

#include "stages/core/compute/huge_array.h"
#include "stages/core/graph/own_samples.h"

namespace loom {

/// Bits of VertexRow::bits in addition to the graph's own flags.
namespace vertex_bit {
inline constexpr std::uint16_t diffuse = 8;        // plain Lambertian material, without a bump or normal map
inline constexpr std::uint16_t perturbed = 16;     // shading normal changed by a bump or normal map
inline constexpr std::uint16_t delta = 32;         // the path continues by a delta lobe
inline constexpr std::uint16_t other_medium = 64;  // the path continues in a medium of another index
inline constexpr std::uint16_t ends_alone = 128;   // the path continues to a vertex without a cluster
inline constexpr std::uint16_t last_step = 2048;   // the next vertex must end the path: it draws no sample
}  // namespace vertex_bit

struct alignas(64) VertexRow {
    Point3f p;
    Vector3f wo, next;  // next: direction of the continuation, if any
    std::uint32_t ns;   // as on disk: two octahedral int16, u low
    float q, pdf_w, eta;
    std::uint16_t bits, material;
    Half diffuse[3];  // albedo of a texture

    /// Whether the light at the end of the continuation is unknown: that vertex drew no sample and has no neighbours.
    bool dead_end() const {
        return (bits & (vertex_bit::ends_alone | vertex_bit::last_step)) ==
               (vertex_bit::ends_alone | vertex_bit::last_step);
    }
    bool continues_shared() const {
        return (bits & (vertex_flag::continued | vertex_bit::delta)) == vertex_flag::continued;
    }
};

struct LightRow {
    Point3f y;        // or the direction
    std::uint32_t n;  // octahedral, like VertexRow::ns
    Spectrum Li;
    float pdf_nee, pdf_bsdf;  // sr^-1
    std::uint32_t edge;       // row of the graph's light edges
    EmitterKind kind;
    LightTechnique technique;
};

/// Makes one row at a time.
class RowMaker {
  public:
    explicit RowMaker(const GraphReader& reader);
    VertexRow vertex(std::size_t j) const;
    LightRow light(std::size_t edge) const;

  private:
    const PathGraph& graph_;
    std::vector<std::uint8_t> diffuse_;  // [material]
};

/// Rows in the order of clusters, for sequential reading: all vertices, and the light edges of some.
class ClusterRows {
  public:
    HugeArray<VertexRow> vertices;

    /// in:      place    position of each vertex in the order; rows of vertices at n_places and beyond stay zero
    ///          offsets  of light edges, by vertex
    ClusterRows(const GraphReader& reader, std::span<const std::uint32_t> place, std::size_t n_places,
                std::span<const std::uint32_t> offsets, int threads);

    /// Replaces the loaded light edges by those of the vertices at places begin to end.
    void load_lights(const GraphReader& reader, std::span<const std::uint32_t> place, std::size_t begin,
                     std::size_t end, std::span<const std::uint32_t> offsets, int threads);
    /// needs:   a place whose light edges are loaded
    std::span<const LightRow> lights_of(std::size_t place) const {
        return {lights_.data() + (first_light_[place] - first_loaded_), first_light_[place + 1] - first_light_[place]};
    }

  private:
    std::vector<std::uint32_t> first_light_;  // by place, plus one final entry
    std::uint32_t first_loaded_ = 0;
    HugeArray<LightRow> lights_;
};

/// Returns f cos Li w / pdf of a light edge, as own_light() of its graph.
/// in:      pdf_w  of the vertex
/// needs:   an edge that was not found by a delta lobe
inline Spectrum own_light(const LightRow& light, const Spectrum& f_cos, float pdf_w,
                          Heuristic heuristic = Heuristic::power) {
    const bool next_event = light.technique == LightTechnique::next_event;
    return own_light(f_cos, light.Li, next_event, light.pdf_nee, light.pdf_bsdf, pdf_w, heuristic);
}

}  // namespace loom
