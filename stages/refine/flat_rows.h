#pragma once
#include <span>
#include <vector>

#include "stages/core/transport/graph_reader.h"
#include "stages/core/transport/huge_array.h"

namespace loom::refine {

/// What a flat matte cluster asks of a vertex: one line of the cache, where the graph has one in each of ten columns.
struct alignas(64) VertexRow {
    Point3f p;
    Vector3f wo, next;  // next: where the path goes on, if it does
    std::uint32_t ns;   // as on disk: two octahedral int16, u low
    float q, pdf_w;
    std::uint16_t flags, material;
    Half diffuse[3];  // of a texture
    std::uint8_t matte;
    std::uint32_t vertex;
};

struct LightRow {
    Point3f y;        // or the direction
    std::uint32_t n;  // as ns
    Spectrum Li;
    float pdf_nee, pdf_bsdf;  // sr^-1
    EmitterKind kind;
    LightTechnique technique;
};

/// Vertices and their light edges in the order of clusters, to be read from front to back. Rows of vertices that are
/// not plain matte are left zero: they are in no flat matte cluster.
struct FlatRows {
    HugeArray<VertexRow> vertices;           // as many as there are vertices at all
    std::vector<std::uint32_t> first_light;  // vertex+1 offsets into lights
    HugeArray<LightRow> lights;

    /// in:      place    of each vertex; n_places and more: none
    ///          offsets  of light edges, by vertex
    FlatRows(const GraphReader& reader, std::span<const std::uint32_t> place, std::size_t n_places,
             std::span<const std::uint32_t> offsets, int threads);
};

}  // namespace loom::refine
