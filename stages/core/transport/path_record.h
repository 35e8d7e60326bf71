#pragma once
// One path as the tracer records it, vertex by vertex; GraphBuilder turns records into columns.

#include <cstdint>
#include <vector>

#include "formats/path_graph.h"
#include "stages/core/scattering/bsdf.h"
#include "stages/core/transport/shading.h"

namespace loom {

struct VertexRecord {
    ShadingPoint at;
    std::uint32_t shape = 0;
    std::uint16_t material = 0;
    bool attempted_nee = false, attempted_bsdf = false, continued = false;
    Ending ending = Ending::none;
    Lobe lobe = Lobe::none;
    float pdf_w = 0;  // of the BSDF sample, roulette folded in
    float q = 1;      // survival probability of roulette
    float eta = 1;    // absolute index of the segment that arrives here
};

struct LightEdgeRecord {
    std::uint32_t vertex = 0;  // within the path
    LightTechnique technique = LightTechnique::next_event;
    Point3f y;                 // or the direction towards it
    bool at_infinity = false;
    Normal3f n;
    Spectrum Li;
    float pdf_nee_w = 0, pdf_bsdf_w = 0;
    std::uint16_t emitter = 0;
    float eta = 1;
};

struct PathRecord {
    Point3f origin;
    Spectrum Le;  // seen directly
    std::vector<VertexRecord> vertices;
    std::vector<LightEdgeRecord> light_edges;

    void clear() {
        Le = Spectrum(0);
        vertices.clear();
        light_edges.clear();
    }
};

}  // namespace loom
