#include "stages/core/transport/graph_builder.h"

#include <tbb/parallel_for.h>

#include "formats/io/octahedral.h"

namespace loom {
namespace {

template <class Kind>
void push(GrowingColumn<float>& column, const Triple<float, Kind>& v) {
    column.insert(column.end(), {v.x, v.y, v.z});
}
void push(GrowingColumn<float>& column, const Spectrum& v) { column.insert(column.end(), {v.r, v.g, v.b}); }
void push(GrowingColumn<Half>& column, const Spectrum& v) {
    column.insert(column.end(), {half_from_float(v.r), half_from_float(v.g), half_from_float(v.b)});
}
template <class Kind>
void push_direction(GrowingColumn<std::int16_t>& column, const Triple<float, Kind>& v) {
    const auto code = octahedral_from_unit(v.x, v.y, v.z);
    column.insert(column.end(), code.begin(), code.end());
}

/// Bytes of all columns.
struct RowsSize : FieldVisitor<RowsSize> {
    std::size_t n_bytes = 0;
    template <class T>
    void column_of(const Field&, const GrowingColumn<T>& column) {
        n_bytes += padded(column.size() * sizeof(T));
    }
    /// Every column of a piece begins where any number may.
    static std::size_t padded(std::size_t n) { return (n + 7) / 8 * 8; }
};

/// Moves columns behind one another into a block.
struct RowsPacker : FieldVisitor<RowsPacker> {
    std::span<std::byte> block;
    std::vector<std::span<std::byte>> columns;
    explicit RowsPacker(std::span<std::byte> to) : block(to) {}
    template <class T>
    void column_of(const Field&, GrowingColumn<T>& column) {
        const auto bytes = std::as_bytes(std::span(column));
        std::copy(bytes.begin(), bytes.end(), block.begin());
        columns.push_back(block.first(bytes.size()));
        block = block.subspan(RowsSize::padded(bytes.size()));
        column.clear();
    }
};

/// Hands the k-th column of every piece to the k-th column of the graph.
struct RowsCollector : FieldVisitor<RowsCollector> {
    const std::vector<std::vector<std::span<std::byte>>>& pieces;
    std::size_t k = 0;
    explicit RowsCollector(const std::vector<std::vector<std::span<std::byte>>>& from) : pieces(from) {}
    template <class T>
    void column_of(const Field&, PiecedColumn<T>& column) {
        for (const auto& piece : pieces)
            column.add({reinterpret_cast<T*>(piece[k].data()), piece[k].size() / sizeof(T)});
        ++k;
    }
};

template <class T, class Get>
Column<T> gather(const std::vector<Material>& materials, Get get) {
    std::vector<T> values;
    for (const Material& m : materials)
        for (const auto& v : get(m.model)) values.push_back(T(v));
    return values;
}

std::array<float, 3> triple(const Spectrum& s) { return {s.r, s.g, s.b}; }

void describe_scene(const Scene& scene, PathGraphHeader& g) {
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

void GraphRows::append(const PathRecord& path, const Scene& scene, bool roulette) {
    const SceneFeatures& f = scene.features;
    auto& v = vertices;
    auto& e = light_edges;
    const auto first = std::uint32_t(v.flags.size());
    paths.first_vertex.push_back(first + path.vertices.size());
    push(paths.Le, path.Le);
    if (scene.sensor.kind != SensorKind::perspective) push(paths.origin, path.origin);
    for (const VertexRecord& r : path.vertices) {
        const ShadingPoint& at = r.at;
        push(v.p, at.p);
        push(v.wo, at.wo);
        push_direction(v.ns, at.frame.n);
        if (f.smooth_normals) push_direction(v.ng, at.ng);
        if (f.perturbed_normals) push_direction(v.n_side, at.n_side);
        if (f.anisotropic) push_direction(v.tangent, at.frame.s);
        v.material.push_back(r.material);
        v.shape.push_back(r.shape);
        std::uint16_t bits = (r.attempted_nee ? vertex_flag::attempted_nee : 0) |
                             (r.attempted_bsdf ? vertex_flag::attempted_bsdf : 0) |
                             (r.continued ? vertex_flag::continued : 0);
        v.flags.push_back(flags_with_ending(bits, r.ending));
        v.lobe.push_back(std::uint8_t(r.lobe));
        v.pdf_w.push_back(r.pdf_w);
        if (roulette) v.q.push_back(r.q);
        if (f.dielectric) v.eta.push_back(r.eta);
        if (f.textured_diffuse) push(v.diffuse, at.bsdf.diffuse);
        if (f.textured_specular) push(v.specular, at.bsdf.specular);
        if (f.textured_transmittance) push(v.transmittance, at.bsdf.transmittance);
        if (f.textured_alpha)
            v.alpha.insert(v.alpha.end(), {half_from_float(at.bsdf.alpha_u), half_from_float(at.bsdf.alpha_v)});
        if (f.textured_opacity) v.opacity.push_back(half_from_float(at.bsdf.opacity));
    }
    for (const LightEdgeRecord& r : path.light_edges) {
        e.vertex.push_back(first + r.vertex);
        e.technique.push_back(std::uint8_t(r.technique));
        push(e.y, r.y);
        e.y.push_back(r.at_infinity ? 0.0f : 1.0f);
        push_direction(e.n, r.n == Normal3f{} ? Normal3f{0, 0, 1} : r.n);
        push(e.Li, r.Li);
        e.pdf_nee_w.push_back(r.pdf_nee_w);
        e.pdf_bsdf_w.push_back(r.pdf_bsdf_w);
        e.emitter.push_back(r.emitter);
        if (f.dielectric) e.eta.push_back(r.eta);
    }
}

void GraphBuilder::set(std::size_t i, GraphRows& rows) {
    RowsSize size;
    GraphRows::row_fields(rows, size);
    RowsPacker packer(arena_->allocate(size.n_bytes));
    GraphRows::row_fields(rows, packer);
    pieces_[i] = std::move(packer.columns);
}

PathGraphInPieces GraphBuilder::finish(const Scene& scene, const PathOptions& options, std::uint64_t first_sample,
                                       std::uint64_t samples) && {
    PathGraphInPieces g;
    describe_scene(scene, g);
    g.tracing.first_sample = first_sample;
    g.tracing.samples_per_pixel = samples;
    g.tracing.max_depth = options.max_depth;
    g.tracing.roulette = roulette_name(options.roulette);
    g.tracing.roulette_depth = options.rr_depth;
    g.tracing.sampler = sampler_name(options.sampler);

    const auto zero = arena_->allocate(sizeof(std::uint64_t));
    g.paths.first_vertex.add({reinterpret_cast<std::uint64_t*>(zero.data()), 1});
    RowsCollector collector(pieces_);
    PathGraphInPieces::row_fields(g, collector);
    std::vector<std::uint64_t> base(pieces_.size(), 0);  // vertices before each piece
    for (std::size_t i = 0; i + 1 < pieces_.size(); ++i) base[i + 1] = base[i] + g.vertices.flags.pieces()[i].size();
    tbb::parallel_for(std::size_t(0), pieces_.size(), [&](std::size_t i) {
        for (std::uint64_t& vertex : g.paths.first_vertex.pieces()[i + 1]) vertex += base[i];
        for (std::uint32_t& vertex : g.light_edges.vertex.pieces()[i]) vertex += std::uint32_t(base[i]);
    });
    g.storage = std::move(arena_);
    return g;
}

std::string_view roulette_name(Roulette roulette) {
    return roulette == Roulette::albedo ? "albedo" : roulette == Roulette::throughput ? "throughput" : "off";
}

std::string_view sampler_name(SamplerKind sampler) {
    return sampler == SamplerKind::sobol ? "sobol" : "independent";
}

}  // namespace loom
