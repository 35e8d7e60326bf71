#include "stages/core/transport/graph_builder.h"

#include <tbb/parallel_for.h>

#include "formats/io/octahedral.h"

namespace loom {
namespace {

template <class Kind>
void push(std::vector<float>& column, const Triple<float, Kind>& v) {
    column.insert(column.end(), {v.x, v.y, v.z});
}
void push(std::vector<float>& column, const Spectrum& v) { column.insert(column.end(), {v.r, v.g, v.b}); }
void push(std::vector<Half>& column, const Spectrum& v) {
    column.insert(column.end(), {half_from_float(v.r), half_from_float(v.g), half_from_float(v.b)});
}
template <class Kind>
void push_direction(std::vector<std::int16_t>& column, const Triple<float, Kind>& v) {
    const auto code = octahedral_from_unit(v.x, v.y, v.z);
    column.insert(column.end(), code.begin(), code.end());
}

template <class T>
Column<T> join(std::vector<GraphPiece>& pieces, std::vector<T> GraphPiece::*member) {
    std::vector<std::size_t> start(pieces.size() + 1, 0);
    for (std::size_t i = 0; i < pieces.size(); ++i) start[i + 1] = start[i] + (pieces[i].*member).size();
    std::vector<T> joined(start.back());
    tbb::parallel_for(std::size_t(0), pieces.size(), [&](std::size_t i) {
        std::copy((pieces[i].*member).begin(), (pieces[i].*member).end(), joined.begin() + start[i]);
        std::vector<T>().swap(pieces[i].*member);
    });
    return joined;
}

template <class T, class Get>
Column<T> gather(const std::vector<Material>& materials, Get get) {
    std::vector<T> values;
    for (const Material& m : materials)
        for (const auto& v : get(m.model)) values.push_back(T(v));
    return values;
}

std::array<float, 3> triple(const Spectrum& s) { return {s.r, s.g, s.b}; }

void describe_scene(const Scene& scene, PathGraph& g) {
    const Sensor& s = scene.sensor;
    const bool perspective = s.kind == SensorKind::perspective;
    g.sensor.kind = perspective ? "perspective" : "orthographic";
    g.sensor.width = s.width;
    g.sensor.height = s.height;
    for (int row = 0; row < 4; ++row)
        for (int k = 0; k < 4; ++k) g.sensor.world_from_camera[row][k] = s.world_from_camera[4 * row + k];
    for (int k = 0; k < 3; ++k) g.sensor.origin[k] = s.world_from_camera[4 * k + 3];
    g.sensor.fov_x_deg = perspective ? 2 * std::atan(s.tan_half_fov_x) * 180 / pi_double : 0;
    g.sensor.principal_point = {s.principal_x, s.principal_y};
    g.sensor.near_clip = s.near_clip;
    g.sensor.far_clip = s.far_clip;
    g.sensor.rfilter = s.filter == Filter::box ? "box" : s.filter == Filter::tent ? "tent" : "gaussian";
    g.sensor.rfilter_radius = s.filter_radius;

    auto& out = g.materials;
    const auto& in = scene.materials;
    using M = BsdfModel;
    for (const Material& m : in) out.id.push_back(m.id);
    const auto one = [](auto member) { return [member](const M& m) { return std::array{m.*member}; }; };
    const auto three = [](auto member) { return [member](const M& m) { return triple(m.*member); }; };
    out.kind = gather<std::uint8_t>(in, one(&M::kind));
    out.distribution = gather<std::uint8_t>(in, one(&M::distribution));
    out.two_sided = gather<std::uint8_t>(in, one(&M::two_sided));
    out.nonlinear = gather<std::uint8_t>(in, one(&M::nonlinear));
    out.sample_visible = gather<std::uint8_t>(in, one(&M::sample_visible));
    out.int_ior = gather<float>(in, one(&M::int_ior));
    out.ext_ior = gather<float>(in, one(&M::ext_ior));
    out.opacity = gather<float>(in, one(&M::opacity));
    out.exponent = gather<float>(in, one(&M::exponent));
    out.alpha = gather<float>(in, [](const M& m) { return std::array{m.alpha_u, m.alpha_v}; });
    out.diffuse = gather<float>(in, three(&M::diffuse));
    out.specular = gather<float>(in, three(&M::specular));
    out.transmittance = gather<float>(in, three(&M::transmittance));
    out.eta_c = gather<float>(in, three(&M::eta_c));
    out.k_c = gather<float>(in, three(&M::k_c));
    out.fdr_int = gather<float>(in, one(&M::fdr_int));
    out.fdr_ext = gather<float>(in, one(&M::fdr_ext));
    std::vector<std::uint8_t> textured;
    for (const Material& m : in)
        textured.push_back((m.diffuse >= 0 ? textured_parameter::diffuse : 0) |
                           (m.specular >= 0 ? textured_parameter::specular : 0) |
                           (m.transmittance >= 0 ? textured_parameter::transmittance : 0) |
                           (m.alpha_u >= 0 || m.alpha_v >= 0 ? textured_parameter::alpha : 0) |
                           (m.opacity >= 0 ? textured_parameter::opacity : 0));
    out.textured = std::move(textured);
    const bool rough_plastic =
        std::any_of(in.begin(), in.end(), [](const Material& m) { return m.model.kind == BsdfKind::rough_plastic; });
    if (rough_plastic)
        out.external_transmittance = gather<float>(in, [](const M& m) { return m.external_transmittance; });

    std::vector<std::uint8_t> kinds;
    std::vector<float> pmfs;
    for (std::size_t i = 0; i < scene.emitters.size(); ++i) {
        g.emitters.id.push_back(scene.emitters[i].id);
        kinds.push_back(std::uint8_t(scene.emitters[i].kind));
        pmfs.push_back(scene.emitter_pmf.pmf(i));
    }
    g.emitters.kind = std::move(kinds);
    g.emitters.pmf = std::move(pmfs);
    for (const Shape& shape : scene.shapes) g.shapes.id.push_back(shape.id);
}

}  // namespace

void GraphPiece::append(const PathRecord& path, const Scene& scene, bool roulette) {
    const SceneFeatures& f = scene.features;
    const auto first = std::uint32_t(flags.size());
    vertices_per_path.push_back(std::uint32_t(path.vertices.size()));
    push(Le, path.Le);
    if (scene.sensor.kind != SensorKind::perspective) push(origin, path.origin);
    for (const VertexRecord& v : path.vertices) {
        const ShadingPoint& at = v.at;
        push(p, at.p);
        push(wo, at.wo);
        push_direction(ns, at.frame.n);
        if (f.smooth_normals) push_direction(ng, at.ng);
        if (f.perturbed_normals) push_direction(n_side, at.n_side);
        if (f.anisotropic) push_direction(tangent, at.frame.s);
        material.push_back(v.material);
        shape.push_back(v.shape);
        std::uint16_t bits = (v.attempted_nee ? vertex_flag::attempted_nee : 0) |
                             (v.attempted_bsdf ? vertex_flag::attempted_bsdf : 0) |
                             (v.continued ? vertex_flag::continued : 0);
        flags.push_back(flags_with_ending(bits, v.ending));
        lobe.push_back(std::uint8_t(v.lobe));
        pdf_w.push_back(v.pdf_w);
        if (roulette) q.push_back(v.q);
        if (f.dielectric) eta.push_back(v.eta);
        if (f.textured_diffuse) push(diffuse, at.bsdf.diffuse);
        if (f.textured_specular) push(specular, at.bsdf.specular);
        if (f.textured_transmittance) push(transmittance, at.bsdf.transmittance);
        if (f.textured_alpha)
            alpha.insert(alpha.end(), {half_from_float(at.bsdf.alpha_u), half_from_float(at.bsdf.alpha_v)});
        if (f.textured_opacity) opacity.push_back(half_from_float(at.bsdf.opacity));
    }
    for (const LightEdgeRecord& e : path.light_edges) {
        edge_vertex.push_back(first + e.vertex);
        edge_technique.push_back(std::uint8_t(e.technique));
        push(y, e.y);
        y.push_back(e.at_infinity ? 0.0f : 1.0f);
        push_direction(n, e.n == Normal3f{} ? Normal3f{0, 0, 1} : e.n);
        push(Li, e.Li);
        pdf_nee_w.push_back(e.pdf_nee_w);
        pdf_bsdf_w.push_back(e.pdf_bsdf_w);
        emitter.push_back(e.emitter);
        if (f.dielectric) edge_eta.push_back(e.eta);
    }
}

PathGraph join_pieces(std::vector<GraphPiece>& pieces, const Scene& scene, const PathOptions& options,
                      std::uint64_t first_sample, std::uint64_t samples) {
    PathGraph g;
    describe_scene(scene, g);
    g.tracing.first_sample = first_sample;
    g.tracing.samples_per_pixel = samples;
    g.tracing.max_depth = options.max_depth;
    g.tracing.roulette = roulette_name(options.roulette);
    g.tracing.roulette_depth = options.rr_depth;
    g.tracing.sampler = sampler_name(options.sampler);

    std::vector<std::uint64_t> first_vertex{0};
    first_vertex.reserve(scene.sensor.n_pixels() * samples + 1);
    std::uint32_t base = 0;
    for (GraphPiece& piece : pieces) {
        for (std::uint32_t count : piece.vertices_per_path) first_vertex.push_back(first_vertex.back() + count);
        for (std::uint32_t& vertex : piece.edge_vertex) vertex += base;
        base += std::uint32_t(piece.flags.size());
    }
    using P = GraphPiece;
    g.paths.first_vertex = std::move(first_vertex);
    g.paths.Le = join(pieces, &P::Le);
    g.paths.origin = join(pieces, &P::origin);
    auto& v = g.vertices;
    v.p = join(pieces, &P::p);
    v.wo = join(pieces, &P::wo);
    v.ns = join(pieces, &P::ns);
    v.ng = join(pieces, &P::ng);
    v.n_side = join(pieces, &P::n_side);
    v.tangent = join(pieces, &P::tangent);
    v.material = join(pieces, &P::material);
    v.shape = join(pieces, &P::shape);
    v.flags = join(pieces, &P::flags);
    v.lobe = join(pieces, &P::lobe);
    v.pdf_w = join(pieces, &P::pdf_w);
    v.q = join(pieces, &P::q);
    v.eta = join(pieces, &P::eta);
    v.diffuse = join(pieces, &P::diffuse);
    v.specular = join(pieces, &P::specular);
    v.transmittance = join(pieces, &P::transmittance);
    v.alpha = join(pieces, &P::alpha);
    v.opacity = join(pieces, &P::opacity);
    auto& e = g.light_edges;
    e.vertex = join(pieces, &P::edge_vertex);
    e.technique = join(pieces, &P::edge_technique);
    e.y = join(pieces, &P::y);
    e.n = join(pieces, &P::n);
    e.Li = join(pieces, &P::Li);
    e.pdf_nee_w = join(pieces, &P::pdf_nee_w);
    e.pdf_bsdf_w = join(pieces, &P::pdf_bsdf_w);
    e.emitter = join(pieces, &P::emitter);
    e.eta = join(pieces, &P::edge_eta);
    return g;
}

std::string_view roulette_name(Roulette roulette) {
    return roulette == Roulette::albedo ? "albedo" : roulette == Roulette::throughput ? "throughput" : "off";
}

std::string_view sampler_name(SamplerKind sampler) {
    return sampler == SamplerKind::sobol ? "sobol" : "independent";
}

}  // namespace loom
