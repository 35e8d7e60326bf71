#include "stages/derive/derive.h"

#include <fmt/format.h>
#include <tbb/enumerable_thread_specific.h>

#include <algorithm>

#include "formats/io/cost.h"
#include "formats/io/error.h"
#include "stages/core/app/command.h"
#include "stages/core/compute/huge_array.h"
#include "stages/core/compute/parallel.h"
#include "stages/core/graph/graph_reader.h"
#include "stages/core/graph/own_samples.h"
#include "stages/core/sampling/streams.h"
#include "stages/core/scene/build.h"
#include "stages/core/scene/nlos.h"
#include "stages/derive/boundary.h"
#include "stages/derive/interior_pilot.h"
#include "stages/derive/reverse_boundary.h"
#include "stages/derive/temporal.h"

namespace loom::derive {
namespace {

/// Rows of the interior. Memory that no row reaches is never touched.
struct InteriorRows {
    HugeArray<std::uint32_t> row;  // light edge, or path
    HugeArray<float> dL, dopl;
    std::size_t n_parameters;

    InteriorRows(std::size_t most, std::size_t n) : row(most), dL(3 * n * most), dopl(n * most), n_parameters(n) {}
    InteriorWalker::RowWriter writer(std::size_t at) {
        return {row.data() + at, dL.data() + 3 * n_parameters * at, dopl.data() + n_parameters * at};
    }
    /// Moves n rows to lower ones.
    void move(std::size_t from, std::size_t to, std::size_t n) {
        shift(row, 1, from, to, n), shift(dL, 3 * n_parameters, from, to, n), shift(dopl, n_parameters, from, to, n);
    }
    template <class T>
    static void shift(HugeArray<T>& column, std::size_t width, std::size_t from, std::size_t to, std::size_t n) {
        if (from != to) std::copy_n(column.data() + width * from, width * n, column.data() + width * to);
    }
    template <class T>
    static Column<T> first(const HugeArray<T>& column, std::size_t n) {
        return Column<T>::borrow(std::span<const T>(column).first(n));
    }
};

void differentiate_interior(const PathGraph& graph, const Scene& scene, const SceneTangents& tangents,
                            const Attached& attached, const WholeLightOptions& whole, int threads, app::Report& report,
                            Derivative& out, std::uint64_t& n_touched) {
    constexpr std::uint64_t chunk = 4096;
    struct Rows {
        std::size_t edges = 0, paths = 0;  // touched: at most as many rows
        std::size_t first_edge = 0, first_path = 0;
        std::size_t n_edges = 0, n_seen = 0, n_points = 0;  // written
    };
    std::vector<Rows> chunks((graph.n_paths() + chunk - 1) / chunk);
    std::vector<std::uint8_t> touched(graph.n_paths());
    app::Progress progress(report, "interior", graph.n_paths());
    tbb::enumerable_thread_specific<InteriorWalker> walkers(
        [&] { return InteriorWalker(graph, scene, tangents, attached, whole); });

    // Find the paths with a derivative, and where the rows of each chunk may begin.
    parallel_chunks(graph.n_paths(), chunk, threads, [&](std::uint64_t i, std::uint64_t begin, std::uint64_t end) {
        const InteriorWalker& walker = walkers.local();
        std::size_t edge = first_light_edge(graph, graph.paths.first_vertex[begin]);
        for (std::size_t path = begin; path < end; ++path) {
            const std::size_t next = next_path_edge(graph, path, edge);
            touched[path] = walker.touches(path);
            if (touched[path]) chunks[i].edges += next - edge, ++chunks[i].paths;
            edge = next;
        }
    });
    std::size_t n_edges = 0, n_paths = 0;
    for (Rows& rows : chunks) {
        rows.first_edge = n_edges, rows.first_path = n_paths;
        n_edges += rows.edges, n_paths += rows.paths;
    }
    n_touched += n_paths;

    // Write the rows of each chunk, then close the gaps.
    struct Storage {
        InteriorRows edges, seen, points;
        HugeArray<float> to_light, L;  // of the points
    };
    const std::size_t points_per_path = whole.on() ? std::size_t(whole.n_points()) : 0,
                      most = points_per_path * n_paths;
    const auto storage = std::make_shared<Storage>(
        Storage{InteriorRows(n_edges, tangents.n()), InteriorRows(n_paths, tangents.n()),
                InteriorRows(most, tangents.n()), HugeArray<float>(most), HugeArray<float>(3 * most)});
    parallel_chunks(graph.n_paths(), chunk, threads, [&](std::uint64_t i, std::uint64_t begin, std::uint64_t end) {
        Rows& rows = chunks[i];
        InteriorWalker::RowWriter edges = storage->edges.writer(rows.first_edge);
        InteriorWalker::RowWriter seen = storage->seen.writer(rows.first_path);
        const std::size_t first_point = points_per_path * rows.first_path;
        InteriorWalker::PointWriter points{storage->points.writer(first_point), storage->to_light.data() + first_point,
                                           storage->L.data() + 3 * first_point};
        walkers.local().walk_all(begin, end, touched, edges, seen, &points);
        rows.n_edges = edges.n, rows.n_seen = seen.n, rows.n_points = points.rows.n;
        progress.add(end - begin);
    });
    n_edges = n_paths = 0;
    std::size_t n_points = 0;
    for (const Rows& rows : chunks) {
        storage->edges.move(rows.first_edge, n_edges, rows.n_edges);
        storage->seen.move(rows.first_path, n_paths, rows.n_seen);
        const std::size_t first_point = points_per_path * rows.first_path;
        storage->points.move(first_point, n_points, rows.n_points);
        InteriorRows::shift(storage->to_light, 1, first_point, n_points, rows.n_points);
        InteriorRows::shift(storage->L, 3, first_point, n_points, rows.n_points);
        n_edges += rows.n_edges, n_paths += rows.n_seen, n_points += rows.n_points;
    }
    out.interior.edge = InteriorRows::first(storage->edges.row, n_edges);
    out.interior.dL = InteriorRows::first(storage->edges.dL, 3 * tangents.n() * n_edges);
    out.interior.dopl = InteriorRows::first(storage->edges.dopl, tangents.n() * n_edges);
    out.light_points.edge = InteriorRows::first(storage->points.row, n_points);
    out.light_points.to_light = InteriorRows::first(storage->to_light, n_points);
    out.light_points.L = InteriorRows::first(storage->L, 3 * n_points);
    out.light_points.dL = InteriorRows::first(storage->points.dL, 3 * tangents.n() * n_points);
    out.light_points.dopl = InteriorRows::first(storage->points.dopl, tangents.n() * n_points);
    out.seen.path = InteriorRows::first(storage->seen.row, n_paths);
    out.seen.dLe = InteriorRows::first(storage->seen.dL, 3 * tangents.n() * n_paths);
    out.seen.dopl = InteriorRows::first(storage->seen.dopl, tangents.n() * n_paths);
    out.storage = storage;
}

/// Returns the bins of a delta pulse: by the options, else those of the graph's film.
TemporalBins bins_of(const Options& options, const PathGraph& graph) {
    const auto& film = graph.transient;
    const bool has_film = !film.n_bins.empty();
    if (!has_film && !(options.start && options.width && options.bins))
        throw InputError(fmt::format("--temporal exact: {} has no time-resolved film; give --start, --width and --bins",
                                     options.graph));
    TemporalBins bins;
    bins.n = options.bins.value_or(has_film ? film.n_bins[0] : 0);
    if (bins.n > max_temporal_bins)
        throw InputError(fmt::format("--temporal exact: {} bins; at most {}", bins.n, max_temporal_bins));
    bins.start = options.start ? *options.start : film.start_opl[0];
    bins.width = options.width ? *options.width : film.bin_width_opl[0];
    bins.camera_segment = !has_film || film.camera_segment[0] != 0;
    return bins;
}

std::string shares_in_words(const Derivative& d) {
    std::string text;
    for (std::size_t p = 0; p < d.n_parameters(); ++p) {
        const double exact = d.temporal_bins.exact_energy[p], all = exact + d.temporal_bins.widened_energy[p];
        if (all > 0)
            text += fmt::format("{}{} {:.4g} %", text.empty() ? "" : ", ", d.parameters.name[p], 100 * exact / all);
    }
    return text.empty() ? "no arrival time changes" : text;
}

/// Whether a texture jumps within a surface.
bool jumps(const Scene& scene, int texture_idx) {
    if (texture_idx < 0) return false;
    const Texture& t = scene.textures[std::size_t(texture_idx)];
    return t.kind == TextureKind::checkerboard || (t.kind == TextureKind::bitmap && t.nearest);
}

/// Whether the look of a shape jumps where its texture does. A mask counts, as the interior has no rate of it beyond the
/// first hit.
bool has_jumping_texture(const Scene& scene, const Shape& shape) {
    for (int m = int(shape.material_idx); m >= 0;) {
        const Material& material = scene.materials[std::size_t(m)];
        if (material.opacity_idx >= 0 &&
            scene.textures[std::size_t(material.opacity_idx)].kind != TextureKind::constant)
            return true;
        for (const int t : {material.diffuse_idx, material.specular_idx, material.transmittance_idx,
                            material.alpha_u_idx, material.alpha_v_idx, material.exponent_idx, material.eta_c_idx,
                            material.k_c_idx, material.normal_map_idx, material.bump_map_idx})
            if (jumps(scene, t)) return true;
        m = m == int(shape.material_idx) ? material.back_idx : -1;
    }
    return false;
}

/// Returns pairs of shapes whose common line is not sampled, as text.
std::string round_seams(const Scene& scene, const SeamQuery& query) {
    constexpr std::size_t most = 3;
    const auto pairs = find_round_seams(scene.shapes, query, most + 1);
    std::string text;
    const auto name = [&](std::uint32_t shape) {
        return scene.shapes[shape].id.empty() ? fmt::format("shape {}", shape) : scene.shapes[shape].id;
    };
    for (std::size_t i = 0; i < std::min(pairs.size(), most); ++i)
        text += fmt::format("{}{} and {}", i > 0 ? "; " : "", name(pairs[i][0]), name(pairs[i][1]));
    return text + (pairs.size() > most ? "; others" : "");
}

/// Returns the kind of an NLOS capture whose edges no part looks for; empty: another, or none.
const char* capture_without_edges(const Scene& scene) {
    if (!scene.nlos) return "";
    if (scene.nlos->relay_wall == NlosCapture::no_wall) return "an NLOS capture by a camera";
    return scene.nlos->laser_sampling ? "" : "an NLOS capture without laser sampling";
}

/// Returns the borders that may move and that no part of those on looks for, in words.
std::string borders_not_sampled(const Scene& scene, const SceneTangents& tangents, const Parts& parts, int depth,
                                const Attached& attached) {
    std::string text;
    const auto add = [&](bool may_be, const char* what) {
        if (may_be) text += (text.empty() ? "" : ", ") + std::string(what);
    };
    add(tangents.any_shape_moves() && *capture_without_edges(scene),
        "edges in an NLOS capture by a camera or without laser sampling");
    if (!parts.any_boundary()) return text;
    const bool beyond_first_hit = depth < 0 || depth >= 3;
    add(std::any_of(scene.emitters.begin(), scene.emitters.end(),
                    [&](const Emitter& e) {
                        return (e.kind == EmitterKind::projector && !scene.nlos) ||
                               (e.kind == EmitterKind::spot && !(e.beam_rad < e.cutoff_rad));
                    }),
        "sharp borders of beams");
    add(scene.features.delta_lobes, "silhouettes in mirrors and clear glass");
    add(beyond_first_hit && scene.features.smooth_normals, "terminators of smooth normals beyond the first hit");
    if (!parts.primary && !parts.indirect) return text;
    // First hits slide over what moves, and over all where the camera does; beyond, points slide unless they keep their
    // places.
    const bool all_slide = tangents.camera_moves() || (beyond_first_hit && attached.any_slides());
    bool textures = false;
    for (std::uint32_t k = 0; k < scene.shapes.size(); ++k) {
        const Shape& shape = scene.shapes[k];
        if (!all_slide && !tangents.moves(k)) continue;
        textures |= has_jumping_texture(scene, shape) ||
                    (shape.emitter_idx >= 0 && (tangents.camera_moves() || tangents.moves(k)) &&
                     jumps(scene, scene.emitters[std::size_t(shape.emitter_idx)].texture_idx));
    }
    add(textures, "borders within textures (nearest, checkerboard, masks)");
    SeamQuery query = moving_pairs(scene, tangents);
    query.resting = all_slide;
    const std::string pairs = round_seams(scene, query);
    if (!pairs.empty()) text += fmt::format("{}lines where {} cut each other", text.empty() ? "" : ", ", pairs);
    return text;
}

/// Whether a mesh cuts an area light that moves relative to it.
bool emitter_is_cut(const Scene& scene, const SceneTangents& tangents) {
    if (std::none_of(scene.emitters.begin(), scene.emitters.end(),
                     [](const Emitter& e) { return e.kind == EmitterKind::area; }))
        return false;
    const SeamSet found = find_seams(scene.shapes, moving_pairs(scene, tangents));
    return std::any_of(found.seams.begin(), found.seams.end(),
                       [&](const Seam& seam) { return cuts_emitter(scene, seam); });
}

}  // namespace

namespace {

/// Returns the size of the flat parts of a mesh, or of a sphere or disk, m: the mean over the surface of the root of
/// twice a triangle's area.
double size_of_facets(const Shape& shape) {
    if (shape.kind != ShapeKind::mesh) return double(shape.round.radius);
    double area = 0, sum = 0;
    for (const TriangleRecord& t : shape.triangles) {
        const double twice = length(cross(Vector3<double>(t.e1), Vector3<double>(t.e2)));
        area += twice, sum += twice * std::sqrt(twice);
    }
    return area > 0 ? sum / area : 0;
}

}  // namespace

Attached attached_of(const Scene& scene, Attachment attachment) {
    if (scene.nlos || attachment == Attachment::surface) return {};
    if (attachment == Attachment::ray) return {std::vector<double>(scene.shapes.size(), INFINITY)};
    // Surfaces that meet are nearer than this share of the scene's size, most others farther. Points that slide farther
    // than a facet cross creases, and each makes noise.
    constexpr double share_of_radius = 0.3, share_of_facet = 0.1;
    Attached attached;
    for (const Shape& shape : scene.shapes)
        attached.reach.push_back(
            std::min(share_of_radius * double(scene.radius), share_of_facet * size_of_facets(shape)));
    return attached;
}

Parts required_parts(const Scene& scene, const PathGraph& graph, const SceneTangents& tangents,
                     const std::vector<std::string>& off, Attachment attachment) {
    Parts parts;
    std::string on, out;
    const auto left_out = [&](const char* part) { return std::find(off.begin(), off.end(), part) != off.end(); };
    const auto add = [&](const char* part, const char* why_not) {
        const bool wanted = !*why_not && !left_out(part);
        (wanted ? on : out) += fmt::format("{}{}{}", (wanted ? on : out).empty() ? "" : ", ", part,
                                           wanted ? "" : fmt::format(" ({})", *why_not ? why_not : "--off"));
        return wanted;
    };
    const bool geometry = tangents.geometry();
    const bool surfaces = tangents.any_shape_moves() || tangents.camera_moves();
    const int depth = graph.tracing.max_depth;
    const char* still = geometry ? "" : "nothing moves";
    // Light of a capture is reflected at least at the wall, by a hidden surface and by the laser spot.
    const int fewest_edges = scene.nlos ? 4 : 3;
    const char* capture = capture_without_edges(scene);
    parts.interior = add("interior", "");
    parts.primary = add("primary", *still       ? still
                                   : *capture   ? capture
                                   : scene.nlos ? "an NLOS capture"
                                   : surfaces   ? ""
                                                : "only lights move");
    parts.direct = add("direct", *still                    ? still
                                 : *capture                ? capture
                                 : scene.emitters.empty()  ? "no emitter"
                                 : depth >= 0 && depth < 2 ? "no reflected light"
                                                           : "");
    // An emitter that is cut by a surface belongs to this part, too.
    const bool deep_enough =
        depth < 0 || depth >= fewest_edges || (depth == 2 && surfaces && emitter_is_cut(scene, tangents));
    parts.indirect = add("indirect", *still         ? still
                                     : !surfaces    ? "only lights move"
                                     : *capture     ? capture
                                     : !deep_enough ? "light is reflected once"
                                                    : "");
    bool index = false;
    for (const auto& effects : tangents.materials)
        for (const auto& [p, t] : effects) index |= t.int_ior != 0;
    parts.media = add("media", index ? "" : "no index of refraction changes");
    parts.plan = fmt::format("on: {}; off: {}", on.empty() ? "nothing" : on, out.empty() ? "nothing" : out);
    parts.not_sampled = borders_not_sampled(scene, tangents, parts, depth, attached_of(scene, attachment));
    if (!parts.not_sampled.empty()) parts.plan += "; not sampled: " + parts.not_sampled;
    return parts;
}

Derivative differentiate(const PathGraph& graph, const Scene& scene, const SceneTangents& tangents, const Parts& parts,
                         const BoundaryOptions& boundary, app::Report& report, DeriveCounts& counts) {
    Derivative d;
    d.n_light_edges = graph.n_light_edges();
    d.n_paths = graph.n_paths();
    describe_parameters(tangents, d.parameters);
    d.boundary_samples = std::vector<std::uint64_t>(n_boundary_families, 0);
    BoundaryOptions of_boundary = boundary;
    std::optional<BoundaryScene> of_edges;
    if (parts.any_boundary()) of_edges.emplace(graph, scene, tangents, of_boundary);
    if (parts.interior) {
        const Attached attached = attached_of(scene, boundary.attachment);
        WholeLightOptions whole{nullptr, 1, streams::family(boundary.seed, 9)};
        std::optional<EdgeTree> edges;
        const std::optional<int> points = boundary.light_points_per_side;
        if (points.value_or(0) != 1) whole.lights = usable_lights(scene);
        if (std::any_of(whole.lights.begin(), whole.lights.end(), [](char usable) { return usable != 0; }))
            whole.edges = of_edges ? &of_edges->all_edges : &edges.emplace(find_edges(scene.shapes));
        if (!points || !boundary.effort) {
            const InteriorPilot pilot = look_at_interior(graph, scene, tangents, attached, whole, points);
            whole.points_per_side = pilot.points_per_side;
            of_boundary.interior_variance = pilot.variance;
        } else {
            whole.points_per_side = *points;
        }
        if (whole.on()) report.info("points of each light that a first hit sees wholly: {}", whole.n_points());
        differentiate_interior(graph, scene, tangents, attached, whole, boundary.threads, report, d,
                               counts.touched_paths);
    }
    if (of_edges) differentiate_boundary(*of_edges, parts, report, d, counts);
    return d;
}

void declare(app::Command& command, Options& options) {
    command.file("scene", options.scene, "scene file of the graph (Mitsuba XML)");
    command.file("graph", options.graph, "path graph (.h5)");
    command.output("-o,--output", options.output, "derivatives (.h5), for loom-transient --derivative");
    command.option("--wrt", options.wrt,
                   "parameter: a $NAME of the scene file, or a part: shape:ID/pose, shape:ID/scale, shape:ID/normals, "
                   "shape:ID/vertices, shape:ID/radiance, shape:ID/bsdf/PARAMETER, bsdf:ID/PARAMETER, emitter:ID/pose, "
                   "emitter:ID/radiance, sensor/pose; may be repeated");
    command.file(
        "--adjoint", options.adjoint,
        "weights of a histogram: a transient_cube (.h5) whose radiance is d loss / d bin; the output is then the "
        "gradient of the loss (.h5) by any number of parameters, also bsdf:ID/reflectance/texels");
    command.option("-D,--define", options.defines, "NAME=VALUE of a scene parameter $NAME, as for the graph");
    command.option("--sensor", options.sensor,
                   "sensor of the graph, by id or by number from 0 in the order of the file (default: the first)");
    command.option("--off", options.off, "part to leave out: interior, primary, direct, indirect; may be repeated");
    command.option(
        "--effort", options.effort,
        "effort of boundary samples, as a share of that of tracing and binning the graph (default: that of the "
        "least variance times cost, at most 1.3; with --adjoint 0.25)",
        app::Range<double>{1e-6, 1e6});
    command.choice(
        "--direct", options.direct,
        "sampling of the shadow edges of area lights at first hits: by a pilot for each emitter, from stored "
        "vertices, or from points of the emitter",
        {{"auto", Direct::automatic}, {"vertices", Direct::vertices}, {"lights", Direct::lights}});
    command.choice("--attach", options.attachment,
                   "what a vertex keeps while the scene moves: its place on its surface, or the sampled direction that "
                   "leads to it; auto: whichever has less variance",
                   {{"auto", Attachment::automatic}, {"surface", Attachment::surface}, {"ray", Attachment::ray}});
    command.choice("--light-points", options.light_points_per_side,
                   "points of a light without texture that a first hit sees wholly, in place of one: light that moves "
                   "between bins has much less noise; auto: those of the least variance times cost",
                   {{"auto", std::nullopt}, {"1", 1}, {"4", 2}, {"9", 3}, {"16", 4}});
    command.option("--seed", options.seed, "seed of the samples that are drawn");
    command.choice("--temporal", options.exact_times,
                   "light that a delta pulse moves between bins: leave it to loom-transient, which widens its "
                   "response, or sample it exactly at the borders of these bins",
                   {{"widen", false}, {"exact", true}});
    command.option("--start", options.start, "exact: start of the first bin, m of optical path (default: the film's)");
    command.option("--width", options.width, "exact: width of a bin, m (default: the film's)",
                   app::Range<double>{1e-12, 1e12});
    command.option("--bins", options.bins, "exact: number of bins (default: the film's)",
                   app::Range<std::uint32_t>{1, max_temporal_bins});
    command.threads(options.threads);
    command.flag("--plan", options.plan, "print the plan and stop");
    declare_doppler(command, options.doppler);
    command.example("loom-derive scenes/edits.xml graph.h5 --wrt x -o d.h5");
    command.example(
        "loom-derive scenes/edits.xml graph.h5 --adjoint weights.h5 --wrt shape:short-box/vertices -o gradient.h5");
}

namespace {

/// Writes the gradient of a loss.
void run_backward(const Options& options, const PathGraph& graph, const InputId& graph_id, const Scene& scene,
                  const SceneTangents& tangents, const WantedParts& wanted, const Parts& parts, double load_s,
                  app::Report& report) {
    const Adjoint adjoint(read_transient_cube(options.adjoint), graph, options.adjoint);
    GradientSums sums(scene);
    std::vector<double> by_vertex, by_texel;
    DeriveCounts counts;
    std::string plan = fmt::format("reverse; {}", parts.plan);
    if (parts.interior)
        counts.touched_paths =
            sweep_paths(graph, scene, tangents, wanted, adjoint, options.threads, report, sums, by_vertex, by_texel);
    by_vertex.resize(3 * wanted.n_vertices);
    by_texel.resize(3 * wanted.n_texels);
    if (parts.primary || parts.direct || parts.indirect) {
        if (!adjoint.timing().camera_segment)
            throw InputError(fmt::format(
                "{}: counts lengths from the first hit, but boundary terms count from the camera; leave them out with "
                "--off primary --off direct --off indirect",
                options.adjoint));
        const MotionBasis basis(scene, tangents, wanted);
        plan += fmt::format("; boundaries by {} motions in {} passes", basis.n_columns(), basis.n_blocks());
        if (!basis.left_out().empty())
            report.warn("boundary terms of {} are left out: more than {} motions", basis.left_out(),
                        MotionBasis::max_columns);
        if (!basis.left_out().empty()) plan += fmt::format(", without {}", basis.left_out());
        report.info("plan: {}", plan);
        basis.add_boundary(
            graph, scene, options.off,
            {options.effort, options.seed, options.threads, options.direct, Attachment::surface, &adjoint}, report,
            sums, by_vertex, counts);
    }
    Gradient gradient = gradient_of(tangents, wanted, sums, std::move(by_vertex), std::move(by_texel));
    gradient.graph = graph_id.hash;
    gradient.provenance = report.provenance(
        options.seed,
        {{app::base_name(options.scene), graph.provenance.inputs[0].hash}, graph_id, identify(options.adjoint)}, plan);
    write_gradient(gradient, options.output);

    Cost cost = report.cost(plan);
    cost.samples = graph.n_paths();
    cost.rays = counts.rays;
    cost.load_s = load_s;
    cost.sources = {options.scene, options.adjoint};
    write_cost_of(options.output, cost, {options.graph});
    report.done("loss {:.9g}; {} parameters, {} vertices, {} texels; {} of {} paths touched", gradient.loss,
                tangents.n(), wanted.n_vertices, wanted.n_texels, counts.touched_paths, graph.n_paths());
}

}  // namespace

void run(const Options& options, app::Report& report) {
    if (!options.doppler.output.empty()) {
        if (options.wrt.empty()) throw InputError("--wrt: missing; name a parameter of the scene");
        run_doppler(options, report);
        return;
    }
    const DopplerRequest& doppler = options.doppler;
    if (!doppler.graphs.empty() || !doppler.speeds.empty() || doppler.numbers.chirp != 0)
        throw InputError("--with, --speed, --chirp: need --doppler");
    if (options.output.empty() && !options.plan) throw InputError("--output: missing (an .h5 file)");
    if (options.wrt.empty()) throw InputError("--wrt: missing; name a parameter of the scene");
    for (const std::string& part : options.off)
        if (part != "interior" && part != "primary" && part != "direct" && part != "indirect")
            throw InputError(fmt::format("--off {}: expected interior, primary, direct or indirect", part));
    if (!options.exact_times && (options.start || options.width || options.bins))
        throw InputError("--start, --width, --bins: need --temporal exact");
    if (!options.plan) check_output_path(options.output);
    const PathGraph graph = read_path_graph(options.graph);
    const InputId graph_id = identify_by_header(graph, options.graph);

    // Find what the parameters change.
    const double before_s = report.cost().cpu_s;
    const Defines defines = parse_defines(options.defines);
    const SceneDescription description = read_scene(options.scene, defines, options.sensor);
    const std::unique_ptr<Scene> scene = build_scene(description);
    require_scene_of(graph, options.graph, *scene, options.scene);
    const bool backward = !options.adjoint.empty();
    SceneTangents tangents = find_tangents(*scene, description, options.scene, defines, options.sensor,
                                           backward ? without_parts(options.wrt) : options.wrt);
    const WantedParts wanted = backward ? find_parts(*scene, options.wrt, tangents) : WantedParts{};
    if (!backward && tangents.n() > max_parameters)
        throw InputError(
            fmt::format("--wrt: {} parameters, but one run differentiates the light by {} at most; --adjoint "
                        "differentiates a loss by any number",
                        tangents.n(), max_parameters));
    const double load_s = report.cost().cpu_s - before_s;
    // The reverse sweep attaches to surfaces.
    const Attached attached = attached_of(*scene, backward ? Attachment::surface : options.attachment);
    if (const std::string missing = missing_columns(graph, *scene, tangents, attached); !missing.empty())
        throw InputError(
            fmt::format("{}: lacks columns for these parameters; trace it with loom-trace {}", options.graph, missing));
    Parts parts =
        required_parts(*scene, graph, tangents, options.off, backward ? Attachment::surface : options.attachment);
    TemporalBins bins;
    if (options.exact_times) {
        bins = bins_of(options, graph);
        parts.plan +=
            fmt::format("; temporal: exact for {} bins of {:.6g} m from {:.6g} m", bins.n, bins.width, bins.start);
    } else if (tangents.geometry() || parts.media) {
        parts.plan += "; temporal: a delta pulse is widened";
    }
    if (options.plan) {
        report.answer(parts.plan + "\n");
        return;
    }
    report.info("plan: {}", parts.plan);
    if (!parts.not_sampled.empty())
        report.warn("biased where these move, for they are not sampled: {}", parts.not_sampled);

    if (backward) {
        run_backward(options, graph, graph_id, *scene, tangents, wanted, parts, load_s, report);
        return;
    }
    DeriveCounts counts;
    Derivative derivative =
        differentiate(graph, *scene, tangents, parts,
                      {options.effort, options.seed, options.threads, options.direct, options.attachment, nullptr,
                       options.exact_times ? std::optional<int>(1) : options.light_points_per_side},
                      report, counts);
    if (options.exact_times) {
        differentiate_temporal(graph, *scene, tangents, attached, bins, options.threads, report, derivative);
        report.info("exact between bins, of the light whose arrival time changes: {}", shares_in_words(derivative));
    }
    derivative.graph = graph_id.hash;
    derivative.provenance = report.provenance(
        options.seed, {{app::base_name(options.scene), graph.provenance.inputs[0].hash}, graph_id}, parts.plan);
    write_derivative(derivative, options.output);

    Cost cost = report.cost(parts.plan);
    cost.samples = graph.n_paths();
    cost.rays = counts.rays;
    cost.load_s = load_s;
    cost.sources = {options.scene};
    write_cost_of(options.output, cost, {options.graph});
    report.done("{} parameters; {} of {} paths touched, {} edges; {} boundary rows", tangents.n(), counts.touched_paths,
                graph.n_paths(), derivative.interior.edge.size(), derivative.boundary.pixel.size());
}

}  // namespace loom::derive
