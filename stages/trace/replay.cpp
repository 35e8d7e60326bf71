#include "stages/trace/replay.h"

#include <fmt/format.h>

#include "formats/io/error.h"

namespace loom::trace {
namespace {

template <class Kind>
std::string text(const Triple<float, Kind>& v) {
    return fmt::format("({:.6g}, {:.6g}, {:.6g})", v.x, v.y, v.z);
}
std::string text(const NormalCode& code) {
    const auto n = unit_from_octahedral(code[0], code[1]);
    return text(Vector3f{n[0], n[1], n[2]});
}
std::string text(const Spectrum& v) {
    return fmt::format("({:.6g}, {:.6g}, {:.6g})", v.r, v.g, v.b);
}

std::string_view lobe_name(Lobe lobe) {
    static constexpr std::string_view names[] = {
        "none", "diffuse", "glossy reflection", "glossy transmission", "delta reflection", "delta transmission",
        "null"};
    return names[int(lobe)];
}

}  // namespace

std::string replay(const Scene& scene, const PathOptions& options, const std::string& place) {
    unsigned long long x = 0, y = 0, sample = 0;
    char tail = 0;
    if (std::sscanf(place.c_str(), "%llu,%llu,%llu%c", &x, &y, &sample, &tail) != 3)
        throw InputError(fmt::format("--replay {}: expected X,Y,SAMPLE", place));
    if (x >= scene.sensor.width || y >= scene.sensor.height)
        throw InputError(
            fmt::format("--replay {}: the film has {} x {} pixels", place, scene.sensor.width, scene.sensor.height));
    PathRecords record;
    const PathResult r = trace_path(scene, options, {y * scene.sensor.width + x, sample}, record);
    std::string out = fmt::format("pixel ({}, {}), sample {}: L = {}, directly visible {}; {} vertices, {} rays\n", x,
                                  y, sample, text(r.L), text(record.paths[0].Le), r.n_vertices, r.n_rays);
    std::size_t edge = 0;
    for (std::size_t j = 0; j < record.vertices.size(); ++j) {
        const VertexRecord& v = record.vertices[j];
        out += fmt::format("x{}  p {}  n {}  shape {}  material {}\n", j + 1, text(v.p), text(v.ns),
                           scene.shapes[v.shape_idx].id, scene.materials[v.material_idx].id);
        out +=
            fmt::format("    wo {}  lobe {}  pdf_w {:.6g}  q {:.4g}  eta {:.5g}  {}\n", text(v.wo), lobe_name(v.lobe),
                        v.pdf_w, v.q, v.eta,
                        (v.flags & vertex_flag::continued) ? "continued"
                                                           : fmt::format("ends: {}", ending_name(ending_of(v.flags))));
        for (; edge < record.light_edges.size() && record.light_edges[edge].vertex_idx == j; ++edge) {
            const LightEdgeRecord& e = record.light_edges[edge];
            out += fmt::format("    light {}  y {}{}  Li {}  pdf_nee_w {:.6g}  pdf_bsdf_w {:.6g}  emitter {}\n",
                               e.technique == LightTechnique::next_event ? "by next event" : "by BSDF", text(e.y),
                               e.at_infinity ? " (direction)" : "", text(e.Li), e.pdf_nee_w, e.pdf_bsdf_w,
                               scene.emitters[e.emitter_idx].id);
        }
    }
    return out;
}

}  // namespace loom::trace
