#pragma once
#include <cstdint>
#include <vector>

#include "formats/path_graph.h"
#include "stages/core/scene/scene.h"
#include "stages/core/transport/path_record.h"
#include "stages/core/transport/path_tracer.h"

namespace loom {

/// Columns of consecutive paths, as one worker fills them. Only the columns that the scene needs are filled.
struct GraphPiece {
    std::vector<std::uint32_t> vertices_per_path;
    std::vector<float> Le, origin;
    std::vector<float> p, wo;
    std::vector<std::int16_t> ns, ng, n_side, tangent;
    std::vector<std::uint16_t> material, flags;
    std::vector<std::uint32_t> shape;
    std::vector<std::uint8_t> lobe;
    std::vector<float> pdf_w, q, eta;
    std::vector<Half> diffuse, specular, transmittance, alpha, opacity;
    std::vector<std::uint32_t> edge_vertex;  // within the piece
    std::vector<std::uint8_t> edge_technique;
    std::vector<float> y;
    std::vector<std::int16_t> n;
    std::vector<float> Li, pdf_nee_w, pdf_bsdf_w;
    std::vector<std::uint16_t> emitter;
    std::vector<float> edge_eta;

    void append(const PathRecord& path, const Scene& scene, bool roulette);
};

/// Joins pieces, in their order, into a graph of `samples` samples per pixel, and adds what the graph says
/// of the scene. The pieces are emptied.
PathGraph join_pieces(std::vector<GraphPiece>& pieces, const Scene& scene, const PathOptions& options,
                      std::uint64_t first_sample, std::uint64_t samples);

/// Names as on disk and on command lines.
std::string_view roulette_name(Roulette roulette);
std::string_view sampler_name(SamplerKind sampler);

}  // namespace loom
