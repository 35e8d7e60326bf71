#include "stages/core/tracing/graph_builder.h"

#include <tbb/parallel_for.h>

#include <utility>

#include "stages/core/scene/nlos.h"

namespace loom {
namespace {

using PlacedRows = PathRows<PlacedColumn>;
using Piece = std::vector<std::span<std::byte>>;  // columns in the order of their declaration

/// Places columns behind one another in a block: first their sizes are summed, then they get their places.
struct RowsPlacer : FieldVisitor<RowsPlacer> {
    std::size_t n_paths, n_vertices, n_light_edges, n_misses;
    std::size_t n_bytes = 0;
    std::span<std::byte> block;  // empty: sum only
    Piece columns;

    explicit RowsPlacer(const PathRecords& records)
        : n_paths(records.paths.size()),
          n_vertices(records.vertices.size()),
          n_light_edges(records.light_edges.size()),
          n_misses(records.misses.size()) {}

    template <class T>
    void column_of(const Field& field, PlacedColumn<T>& column) {
        const std::size_t rows = field.axes == "path+1"             ? n_paths + 1
                                 : field.axes.starts_with("path")   ? n_paths
                                 : field.axes.starts_with("vertex") ? n_vertices
                                 : field.axes.starts_with("edge")   ? n_light_edges
                                                                    : n_misses;
        const std::size_t n = column.wanted ? rows * field.row_size() : 0;
        if (!block.empty()) {
            const auto bytes = block.subspan(n_bytes, n * sizeof(T));
            column.values = {reinterpret_cast<T*>(bytes.data()), n};
            columns.push_back(bytes);
        }
        n_bytes += (n * sizeof(T) + 7) / 8 * 8;  // every column begins where any number may
    }
};

template <class T>
std::span<T> values_of(std::span<std::byte> column) {
    return {reinterpret_cast<T*>(column.data()), column.size() / sizeof(T)};
}

/// Hands the k-th column of every piece to the k-th column of the graph.
struct RowsCollector : FieldVisitor<RowsCollector> {
    const std::vector<Piece>& pieces;
    std::size_t k = 0;
    explicit RowsCollector(const std::vector<Piece>& from) : pieces(from) {}
    template <class T>
    void column_of(const Field& field, PiecedColumn<T>& column) {
        const std::size_t n_shared = field.axes == "path+1" ? 1 : 0;  // row that the piece before ends with
        for (const Piece& piece : pieces) column.add(values_of<T>(piece[k]).subspan(n_shared));
        ++k;
    }
};

/// Lends the k-th column of a piece to the k-th column of the graph.
struct RowsLender : FieldVisitor<RowsLender> {
    const Piece& piece;
    std::size_t k = 0;
    explicit RowsLender(const Piece& from) : piece(from) {}
    template <class T>
    void column_of(const Field&, Column<T>& column) {
        column = Column<T>::borrow(values_of<T>(piece[k++]));
    }
};

PlacedRows wanted_rows(const Scene& scene, const PathOptions& options, const OptionalColumns& columns) {
    PlacedRows wanted;
    const SceneFeatures& f = scene.features;
    auto& v = wanted.vertices;
    wanted.paths.origin.wanted = scene.sensor.kind == SensorKind::orthographic;
    v.ng.wanted = f.smooth_normals;
    v.n_side.wanted = f.perturbed_normals;
    v.tangent.wanted = f.anisotropic;
    v.q.wanted = options.roulette != Roulette::off;
    v.eta.wanted = wanted.light_edges.eta.wanted = f.dielectric;
    v.medium.wanted = wanted.light_edges.medium.wanted = columns.media && f.dielectric;
    v.primitive.wanted = columns.primitives;
    v.diffuse.wanted = f.textured_diffuse;
    v.specular.wanted = f.textured_specular;
    v.transmittance.wanted = f.textured_transmittance;
    v.alpha.wanted = f.textured_alpha;
    v.opacity.wanted = f.textured_opacity;
    v.exponent.wanted = f.textured_exponent;
    v.eta_c.wanted = v.k_c.wanted = f.textured_index;
    auto& m = wanted.misses;
    m.vertex.wanted = m.technique.wanted = m.y.wanted = m.emitter.wanted = columns.misses;
    return wanted;
}

template <class T, class Get>
Column<T> gather(const std::vector<Material>& materials, Get get) {
    std::vector<T> values;
    for (const Material& m : materials)
        for (const auto& v : get(m.model)) values.push_back(T(v));
    return values;
}

std::array<float, 3> triple(const Spectrum& s) {
    return {s.r, s.g, s.b};
}

template <class Points>
void put_points(const Points& points, Column<float>& p, Column<float>& n) {
    std::vector<float> positions, normals;
    for (const auto& at : points)
        for (int k = 0; k < 3; ++k) {
            positions.push_back(at.hit ? at.p[k] : 0.0f);
            normals.push_back(at.hit ? at.flat[k] : 0.0f);
        }
    p = std::move(positions);
    n = std::move(normals);
}

void describe_capture(const Scene& scene, const NlosCapture& capture, bool true_area, PathGraphHeader::Nlos& out) {
    out.capture = {std::uint8_t(capture.type)};
    out.true_area = {std::uint8_t(true_area)};
    out.grids = {capture.sensor_grid.width, capture.sensor_grid.height, capture.laser_grid.width,
                 capture.laser_grid.height};
    const Point3f& laser = scene.emitters[0].position;
    out.laser = {laser.x, laser.y, laser.z};
    put_points(capture.sensor_points, out.sensor_points, out.sensor_normals);
    put_points(capture.laser_points, out.laser_points, out.laser_normals);
}

/// Tables of the rough plastics whose alpha is textured.
void describe_coats(const std::vector<Material>& materials, PathGraphHeader::Coats& out) {
    std::vector<std::uint16_t> material;
    std::vector<float> alpha, fdr_int, fdr_ext, transmittance;
    for (std::size_t i = 0; i < materials.size(); ++i) {
        const RoughCoats* coats = materials[i].model.coats;
        if (!coats) continue;
        for (std::size_t k = 0; k < coats->rows.size(); ++k) {
            const RoughCoat& row = coats->rows[k];
            material.push_back(std::uint16_t(i));
            alpha.push_back(coats->alpha(k));
            fdr_int.push_back(row.fdr_int);
            fdr_ext.push_back(row.fdr_ext);
            transmittance.insert(transmittance.end(), row.external_transmittance.begin(),
                                 row.external_transmittance.end());
        }
    }
    if (material.empty()) return;
    out.material = std::move(material);
    out.alpha = std::move(alpha);
    out.fdr_int = std::move(fdr_int);
    out.fdr_ext = std::move(fdr_ext);
    out.external_transmittance = std::move(transmittance);
}

void describe_sensor(const Sensor& s, PathGraphHeader::Sensor& out) {
    const bool perspective = s.kind == SensorKind::perspective;
    out.kind = s.kind == SensorKind::nlos_capture_meter ? "nlos_capture_meter"
               : perspective                            ? "perspective"
                                                        : "orthographic";
    out.width = s.width;
    out.height = s.height;
    for (int row = 0; row < 4; ++row)
        for (int k = 0; k < 4; ++k) out.world_from_camera[row][k] = s.world_from_camera[4 * row + k];
    for (int k = 0; k < 3; ++k) out.origin[k] = s.world_from_camera[4 * k + 3];
    out.fov_x_deg = perspective ? 2 * std::atan(s.tan_half_fov_x) * 180 / pi_double : 0;
    out.principal_point = {s.principal_x, s.principal_y};
    out.near_clip = s.near_clip;
    out.far_clip = s.far_clip;
    out.rfilter = s.filter == Filter::box ? "box" : s.filter == Filter::tent ? "tent" : "gaussian";
    out.rfilter_radius = s.filter_radius;
}

void describe_film(const TransientFilm& film, PathGraphHeader::Transient& out) {
    if (film.n_bins == 0) return;
    out.n_bins = {film.n_bins};
    out.start_opl = {film.start_opl};
    out.bin_width_opl = {film.bin_width_opl};
    out.sigma_opl = {film.sigma_opl};
    out.camera_segment = {std::uint8_t(film.camera_segment)};
}

/// Bits of textured_parameter, by material.
std::vector<std::uint8_t> textured_parameters(const std::vector<Material>& in) {
    std::vector<std::uint8_t> textured;
    for (const Material& m : in)
        textured.push_back((m.diffuse_idx >= 0 ? textured_parameter::diffuse : 0) |
                           (m.specular_idx >= 0 ? textured_parameter::specular : 0) |
                           (m.transmittance_idx >= 0 ? textured_parameter::transmittance : 0) |
                           (m.alpha_u_idx >= 0 || m.alpha_v_idx >= 0 ? textured_parameter::alpha : 0) |
                           (m.opacity_idx >= 0 ? textured_parameter::opacity : 0) |
                           (m.exponent_idx >= 0 ? textured_parameter::exponent : 0) |
                           (m.textured_index() ? textured_parameter::index : 0));
    return textured;
}

void describe_materials(const std::vector<Material>& in, PathGraphHeader::Materials& out) {
    using M = BsdfModel;
    for (const Material& m : in) out.id.push_back(m.id);
    const auto one = [](auto member) { return [member](const M& m) { return std::array{m.*member}; }; };
    const auto three = [](auto member) { return [member](const M& m) { return triple(m.*member); }; };
    out.kind = gather<std::uint8_t>(in, one(&M::kind));
    out.distribution = gather<std::uint8_t>(in, one(&M::distribution));
    out.two_sided = gather<std::uint8_t>(in, one(&M::two_sided));
    out.nonlinear = gather<std::uint8_t>(in, one(&M::nonlinear));
    out.sample_visible = gather<std::uint8_t>(in, one(&M::sample_visible));
    const auto any_material = [&in](auto differs) {
        return std::any_of(in.begin(), in.end(), [&](const Material& m) { return differs(m.model); });
    };
    if (any_material([](const M& m) { return m.variant != WardVariant::balanced; }))
        out.variant = gather<std::uint8_t>(in, one(&M::variant));
    if (any_material([](const M& m) { return !m.bump_shadowing; }))
        out.bump_shadowing = gather<std::uint8_t>(in, one(&M::bump_shadowing));
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
    out.fdr_int = gather<float>(in, [](const M& m) { return std::array{m.coat.fdr_int}; });
    out.fdr_ext = gather<float>(in, [](const M& m) { return std::array{m.coat.fdr_ext}; });
    out.textured = textured_parameters(in);
    const bool rough_plastic =
        std::any_of(in.begin(), in.end(), [](const Material& m) { return m.model.kind == BsdfKind::rough_plastic; });
    if (rough_plastic)
        out.external_transmittance = gather<float>(in, [](const M& m) { return m.coat.external_transmittance; });
}

void describe_emitters(const Scene& scene, PathGraphHeader::Emitters& out) {
    std::vector<std::uint8_t> kinds;
    std::vector<float> pmfs, positions;
    bool has_projector = false;
    for (std::size_t i = 0; i < scene.emitters.size(); ++i) {
        const Emitter& e = scene.emitters[i];
        const bool projector = e.kind == EmitterKind::projector;
        has_projector |= projector;
        out.id.push_back(e.id);
        kinds.push_back(
            std::uint8_t(projector && scene.nlos && scene.nlos->laser_sampling ? EmitterKind::laser_spot : e.kind));
        pmfs.push_back(scene.emitter_pmf.pmf(i));
        for (int k = 0; k < 3; ++k) positions.push_back(projector ? e.position[k] : 0.0f);
    }
    if (has_projector) out.position = std::move(positions);
    out.kind = std::move(kinds);
    out.pmf = std::move(pmfs);
}

void describe(const Scene& scene, const PathOptions& options, PathGraphHeader& g) {
    describe_sensor(scene.sensor, g.sensor);
    describe_film(scene.transient, g.transient);
    describe_materials(scene.materials, g.materials);
    describe_coats(scene.materials, g.coats);
    describe_emitters(scene, g.emitters);
    for (const Shape& shape : scene.shapes) g.shapes.id.push_back(shape.id);
    if (scene.nlos) describe_capture(scene, *scene.nlos, options.laser_spot == LaserSpot::true_area, g.nlos);
    g.tracing.max_depth = options.max_depth;
    g.tracing.roulette = roulette_name(options.roulette);
    g.tracing.roulette_depth = options.rr_depth;
    g.tracing.sampler = sampler_name(options.sampler);
}

/// Fills the columns of a batch; they lie one behind the other in a block of the arena.
/// in:      rows  the columns that are wanted, not yet placed
Piece fill(PlacedRows rows, const PathRecords& records, Arena& arena) {
    RowsPlacer placer(records);
    PlacedRows::row_fields(rows, placer);
    placer.block = arena.allocate(std::exchange(placer.n_bytes, 0));
    PlacedRows::row_fields(rows, placer);

    // Records come depth by depth, rows go path by path.
    std::vector<std::uint32_t> first_vertex, next_vertex, next_edge, next_miss;
    std::uint32_t vertex = 0, edge = 0, miss = 0;
    rows.paths.first_vertex.put(0, vertex);
    for (std::size_t path = 0; path < records.paths.size(); ++path) {
        const PathRecords::Path& r = records.paths[path];
        first_vertex.push_back(vertex);
        next_edge.push_back(edge);
        next_miss.push_back(miss);
        vertex += r.n_vertices;
        edge += r.n_light_edges;
        miss += r.n_misses;
        rows.paths.first_vertex.put(path + 1, vertex);
        rows.paths.Le.put(path, r.Le.r, r.Le.g, r.Le.b);
        rows.paths.origin.put(path, r.origin.x, r.origin.y, r.origin.z);
    }
    next_vertex = first_vertex;
    const auto& v = rows.vertices;
    for (const VertexRecord& r : records.vertices) {
        const std::size_t row = next_vertex[r.path_idx]++;
        v.p.put(row, r.p.x, r.p.y, r.p.z);
        v.wo.put(row, r.wo.x, r.wo.y, r.wo.z);
        v.ns.put(row, r.ns);
        v.ng.put(row, r.ng);
        v.n_side.put(row, r.n_side);
        v.tangent.put(row, r.tangent);
        v.material.put(row, r.material_idx);
        v.shape.put(row, r.shape_idx);
        v.flags.put(row, r.flags);
        v.lobe.put(row, std::uint8_t(r.lobe));
        v.pdf_w.put(row, r.pdf_w);
        v.q.put(row, r.q);
        v.eta.put(row, r.eta);
        v.medium.put(row, r.medium_idx);
        v.primitive.put(row, r.primitive_idx);
        v.diffuse.put(row, r.diffuse);
        v.specular.put(row, r.specular);
        v.transmittance.put(row, r.transmittance);
        v.alpha.put(row, r.alpha);
        v.opacity.put(row, r.opacity);
        v.exponent.put(row, r.exponent);
        v.eta_c.put(row, r.eta_c);
        v.k_c.put(row, r.k_c);
    }
    const auto& e = rows.light_edges;
    for (const LightEdgeRecord& r : records.light_edges) {
        const std::size_t row = next_edge[r.path_idx]++;
        e.vertex.put(row, first_vertex[r.path_idx] + r.vertex_idx);
        e.technique.put(row, std::uint8_t(r.technique));
        e.y.put(row, r.y.x, r.y.y, r.y.z, r.at_infinity ? 0.0f : 1.0f);
        e.n.put(row, r.n);
        e.Li.put(row, r.Li.r, r.Li.g, r.Li.b);
        e.pdf_nee_w.put(row, r.pdf_nee_w);
        e.pdf_bsdf_w.put(row, r.pdf_bsdf_w);
        e.emitter.put(row, r.emitter_idx);
        e.eta.put(row, r.medium.ior);
        e.medium.put(row, r.medium.material_idx);
    }
    const auto& m = rows.misses;
    for (const MissRecord& r : records.misses) {
        const std::size_t row = next_miss[r.path_idx]++;
        m.vertex.put(row, first_vertex[r.path_idx] + r.vertex_idx);
        m.technique.put(row, std::uint8_t(r.technique));
        m.y.put(row, r.y.x, r.y.y, r.y.z, r.at_infinity ? 0.0f : 1.0f);
        m.emitter.put(row, r.emitter_idx);
    }
    return std::move(placer.columns);
}

}  // namespace

GraphBuilder::GraphBuilder(const Scene& scene, const PathOptions& options, std::size_t n_pieces,
                           std::shared_ptr<Arena> memory, const OptionalColumns& columns)
    : scene_(scene),
      options_(options),
      wanted_(wanted_rows(scene, options, columns)),
      pieces_(n_pieces),
      arena_(std::move(memory)) {
    arena_->reset();
}

void GraphBuilder::set(std::size_t i, const PathRecords& records) {
    pieces_[i] = fill(wanted_, records, *arena_);
}

PathGraphInPieces GraphBuilder::finish(std::uint64_t first_sample, std::uint64_t samples) && {
    PathGraphInPieces g;
    describe(scene_, options_, g);
    g.tracing.first_sample = first_sample;
    g.tracing.samples_per_pixel = samples;

    auto* const zero = reinterpret_cast<std::uint64_t*>(arena_->allocate(sizeof(std::uint64_t)).data());
    *zero = 0;
    g.paths.first_vertex.add({zero, 1});
    RowsCollector collector(pieces_);
    PathGraphInPieces::row_fields(g, collector);
    std::vector<std::uint64_t> base(pieces_.size(), 0);  // vertices before each piece
    for (std::size_t i = 0; i + 1 < pieces_.size(); ++i) base[i + 1] = base[i] + g.vertices.flags.pieces()[i].size();
    tbb::parallel_for(std::size_t(0), pieces_.size(), [&](std::size_t i) {
        for (std::uint64_t& vertex : g.paths.first_vertex.pieces()[i + 1]) vertex += base[i];
        for (std::uint32_t& vertex : g.light_edges.vertex.pieces()[i]) vertex += std::uint32_t(base[i]);
        for (std::uint32_t& vertex : g.misses.vertex.pieces()[i]) vertex += std::uint32_t(base[i]);
    });
    g.storage = std::move(arena_);
    return g;
}

BatchGraph::BatchGraph(const Scene& scene, const PathOptions& options, const OptionalColumns& columns)
    : wanted_(wanted_rows(scene, options, columns)) {
    wanted_.paths.origin.wanted = true;
    describe(scene, options, graph_);
}

const PathGraph& BatchGraph::set(const PathRecords& records) {
    arena_.reset();
    const Piece columns = fill(wanted_, records, arena_);
    RowsLender lender(columns);
    PathGraph::row_fields(graph_, lender);
    return graph_;
}

std::string_view roulette_name(Roulette roulette) {
    return roulette == Roulette::albedo ? "albedo" : roulette == Roulette::throughput ? "throughput" : "off";
}

std::string_view sampler_name(SamplerKind sampler) {
    return sampler == SamplerKind::sobol ? "sobol" : "independent";
}

}  // namespace loom
