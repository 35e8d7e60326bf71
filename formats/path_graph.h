#pragma once
// path_graph: paths as they were traced, with the data that a neighbour needs to reuse them.
//
// A path is one camera sample. Its vertices are consecutive rows: the continuation of vertex j is vertex j + 1 when its
// flag `continued` is set. A light edge joins a vertex to a light point found by next-event estimation or by the BSDF
// ray. Techniques that were attempted and failed are flags of the vertex: estimators that pool densities over neighbours
// must count them, too.

#include <array>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "formats/io/arena.h"
#include "formats/io/check.h"
#include "formats/io/documenter.h"
#include "formats/io/field.h"
#include "formats/io/mapped_file.h"
#include "formats/io/output_file.h"
#include "formats/io/provenance.h"

namespace loom {

/// Bits of `vertices/flags`. Bits 8 to 10 hold the Ending.
namespace vertex_flag {
inline constexpr std::uint16_t attempted_nee = 1;
inline constexpr std::uint16_t attempted_bsdf = 2;
inline constexpr std::uint16_t continued = 4;
}  // namespace vertex_flag

/// Bits of `materials/textured`: parameters that are stored per vertex.
namespace textured_parameter {
inline constexpr std::uint8_t diffuse = 1;
inline constexpr std::uint8_t specular = 2;
inline constexpr std::uint8_t transmittance = 4;
inline constexpr std::uint8_t alpha = 8;
inline constexpr std::uint8_t opacity = 16;
inline constexpr std::uint8_t exponent = 32;
inline constexpr std::uint8_t index = 64;  // eta_c and k_c
}  // namespace textured_parameter

/// Value of `vertices/medium` and `light_edges/medium` outside of all objects.
inline constexpr std::uint16_t no_medium = 65535;

/// Reason why a path ends at a vertex.
enum class Ending : std::uint8_t {
    none = 0,  // it does not end here
    escaped = 1,
    roulette = 2,
    invalid_sample = 3,
    max_depth = 4,
    hit_emitter = 5,  // an emitter without BSDF
};
inline constexpr int n_endings = 6;
std::string_view ending_name(Ending ending);

constexpr std::uint16_t flags_with_ending(std::uint16_t flags, Ending ending) {
    return static_cast<std::uint16_t>((flags & ~0x700u) | (static_cast<unsigned>(ending) << 8));
}
constexpr Ending ending_of(std::uint16_t flags) {
    return static_cast<Ending>((flags >> 8) & 7u);
}

/// Technique that found a light point; value of `light_edges/technique`.
enum class LightTechnique : std::uint8_t { next_event = 0, bsdf_hit = 1 };

/// Value of `emitters/kind`. Append only.
enum class EmitterKind : std::uint8_t {
    area = 0,
    point = 1,
    spot = 2,
    directional = 3,
    constant = 4,
    envmap = 5,
    projector = 6,
    laser_spot = 7,  // where the beam of a projector meets a surface, as a light of its own
};
inline constexpr int n_emitter_kinds = 8;
std::string_view emitter_kind_name(std::uint8_t kind);

/// Rows of paths, vertices, light edges and misses. ColumnOf is the memory layout of a column.
template <template <class> class ColumnOf>
struct PathRows {
    struct Paths {
        ColumnOf<std::uint64_t> first_vertex;
        ColumnOf<float> Le, origin;
    } paths;

    struct Vertices {
        ColumnOf<float> p, wo;
        ColumnOf<std::int16_t> ns, ng, n_side, tangent;
        ColumnOf<std::uint16_t> material, flags, medium;
        ColumnOf<std::uint32_t> shape, primitive;
        ColumnOf<std::uint8_t> lobe;
        ColumnOf<float> pdf_w, q, eta;
        ColumnOf<Half> diffuse, specular, transmittance, alpha, opacity, eta_c, k_c;
        ColumnOf<float> exponent;
    } vertices;

    struct LightEdges {
        ColumnOf<std::uint32_t> vertex;
        ColumnOf<std::uint8_t> technique;
        ColumnOf<float> y;
        ColumnOf<std::int16_t> n;
        ColumnOf<float> Li, pdf_nee_w, pdf_bsdf_w;
        ColumnOf<std::uint16_t> emitter, medium;
        ColumnOf<float> eta;
    } light_edges;

    struct Misses {
        ColumnOf<std::uint32_t> vertex;
        ColumnOf<std::uint8_t> technique;
        ColumnOf<float> y;
        ColumnOf<std::uint16_t> emitter;
    } misses;

    std::size_t n_paths() const { return paths.first_vertex.empty() ? 0 : paths.first_vertex.size() - 1; }
    std::size_t n_vertices() const { return vertices.flags.size(); }
    std::size_t n_light_edges() const { return light_edges.vertex.size(); }
    std::size_t n_misses() const { return misses.vertex.size(); }

    template <class Self, class Visitor>
    static void row_fields(Self& g, Visitor& v);
};

/// Scene and settings of a graph.
struct PathGraphHeader {
    struct Sensor {
        std::string kind = "perspective";  // or "orthographic", "nlos_capture_meter"
        std::uint32_t width = 0, height = 0;
        std::array<std::array<double, 4>, 4> world_from_camera{};
        std::array<double, 3> origin{};
        double fov_x_deg = 0;
        std::array<double, 2> principal_point{};  // offset, in widths and heights
        double near_clip = 0, far_clip = 0;
        std::string rfilter = "box";
        double rfilter_radius = 0.5;
    } sensor;

    struct Tracing {
        std::uint64_t first_sample = 0, samples_per_pixel = 0;
        std::int32_t max_depth = -1;
        std::string roulette = "none";
        std::int32_t roulette_depth = 5;
        std::string sampler = "independent";
    } tracing;

    /// Settings of a time-resolved film; empty columns for any other.
    struct Transient {
        Column<std::uint32_t> n_bins;
        Column<double> start_opl, bin_width_opl, sigma_opl;
        Column<std::uint8_t> camera_segment;
    } transient;

    /// An NLOS capture: a sensor and a laser aim at points of a relay wall; empty columns for any other.
    struct Nlos {
        Column<std::uint8_t> capture, true_area;
        Column<std::uint32_t> grids;
        Column<double> laser;
        Column<float> sensor_points, sensor_normals, laser_points, laser_normals;
    } nlos;

    struct Materials {
        std::vector<std::string> id;
        Column<std::uint8_t> kind, distribution, two_sided, nonlinear, sample_visible, textured, variant,
            bump_shadowing;
        Column<float> int_ior, ext_ior, opacity, alpha, exponent;
        Column<float> diffuse, specular, transmittance, eta_c, k_c;
        Column<float> fdr_int, fdr_ext, external_transmittance;
    } materials;

    /// Interfaces of rough plastics with textured alpha, over alpha; empty columns without such materials.
    struct Coats {
        Column<std::uint16_t> material;
        Column<float> alpha, fdr_int, fdr_ext, external_transmittance;
    } coats;

    struct Emitters {
        std::vector<std::string> id;
        Column<std::uint8_t> kind;
        Column<float> pmf, position;
    } emitters;

    struct Shapes {
        std::vector<std::string> id;
    } shapes;

    Provenance provenance;

    std::size_t n_pixels() const { return std::size_t{sensor.width} * sensor.height; }
};

/// Declaration of the format, for every memory layout of the columns.
template <template <class> class ColumnOf>
struct PathGraphOf : PathGraphHeader, PathRows<ColumnOf> {
    static constexpr FormatId format{"path_graph", 2, 1, 1};
    /// Version of a graph that uses nothing newer, so that older readers accept it.
    static constexpr FormatId format_of_most{"path_graph", 1, 2};

    template <class Self, class Visitor>
    static void fields(Self& g, Visitor& v);
};

struct PathGraph : PathGraphOf<Column> {
    std::shared_ptr<const MappedFile> storage;  // file that the columns are borrowed from, if any

    /// Returns the first violated invariant beyond types, lengths and finite floats; empty: none.
    std::string problem(Check check = Check::everything) const;
};

/// A traced graph to be written. Its columns are the pieces in which they were filled.
struct PathGraphInPieces : PathGraphOf<PiecedColumn> {
    std::shared_ptr<const Arena> storage;  // memory of the pieces
};

/// needs:   columns of one axis of one length
void write_path_graph(const PathGraph& graph, const std::filesystem::path& path, Sync sync = Sync::yes);
/// Writes the same bytes as for joined columns.
void write_path_graph(const PathGraphInPieces& graph, const std::filesystem::path& path, Sync sync = Sync::yes);
/// Maps and checks a file.
/// throws:  InputError that names the file and the dataset
PathGraph read_path_graph(const std::filesystem::path& path, Check check = Check::everything);
/// Identifies a graph by file name and by a hash of its header: command, seed, build, scene, numbers of rows. Equal paths
/// have equal headers, and hashing all columns would cost more than some stages that read them.
InputId identify_by_header(const PathGraph& graph, const std::filesystem::path& path);

/// Bytes of each column that is present.
std::vector<ColumnBytes> column_bytes(const PathGraph& graph);
std::vector<ColumnBytes> column_bytes(const PathGraphInPieces& graph);

template <template <class> class ColumnOf>
template <class Self, class Visitor>
void PathRows<ColumnOf>::row_fields(Self& g, Visitor& v) {
    auto& p = g.paths;
    v.field("paths/first_vertex", p.first_vertex, 1, "path+1", "1",
            "offsets into vertices; path i is sample first_sample + i / (width height) of pixel i mod (width "
            "height), pixel = y width + x, row 0 on top");
    v.field("paths/Le", p.Le, 3, "path,rgb", "W m^-2 sr^-1",
            "directly visible radiance: emitter at the first hit, or environment of a camera ray that escaped",
            Finite::counted);
    v.optional("paths/origin", p.origin, 3, "path,xyz", "m", "origin of the camera ray; absent: sensor/origin");

    auto& x = g.vertices;
    v.field("vertices/p", x.p, 3, "vertex,xyz", "m", "position, world space");
    v.field("vertices/wo", x.wo, 3, "vertex,xyz", "1",
            "unit direction in which light leaves, towards the previous vertex or the camera");
    v.field("vertices/ns", x.ns, 2, "vertex,uv", "1/32767", "shading normal, octahedral");
    v.optional("vertices/ng", x.ng, 2, "vertex,uv", "1/32767", "geometric normal, octahedral; absent: ns");
    v.optional("vertices/n_side", x.n_side, 2, "vertex,uv", "1/32767",
               "shading normal before bump or normal maps, octahedral; absent: ns");
    v.optional("vertices/tangent", x.tangent, 2, "vertex,uv", "1/32767",
               "first tangent of the shading frame, octahedral; absent: the frame follows from ns alone");
    v.field("vertices/material", x.material, 1, "vertex", "1", "row of materials");
    v.field("vertices/shape", x.shape, 1, "vertex", "1", "row of shapes");
    v.field("vertices/flags", x.flags, 1, "vertex", "1",
            "bit 0 next-event estimation attempted, bit 1 BSDF sample attempted, bit 2 continued by the next "
            "row; bits 8-10 ending: 0 none, 1 escaped, 2 roulette, 3 invalid sample, 4 max depth, 5 hit an "
            "emitter without BSDF");
    v.field("vertices/lobe", x.lobe, 1, "vertex", "1",
            "lobe of the BSDF sample: 0 none, 1 diffuse, 2 glossy reflection, 3 glossy transmission, 4 delta "
            "reflection, 5 delta transmission, 6 null");
    v.field("vertices/pdf_w", x.pdf_w, 1, "vertex", "sr^-1",
            "density of the BSDF sample, survival of roulette folded in; for a delta lobe its probability (1)");
    v.optional("vertices/q", x.q, 1, "vertex", "1", "survival probability of roulette; absent: 1");
    v.optional("vertices/eta", x.eta, 1, "vertex", "1",
               "absolute refractive index along the segment from the previous vertex; absent: 1");
    v.optional(
        "vertices/medium", x.medium, 1, "vertex", "1",
        "row of materials of the dielectric that contains the segment from the previous vertex; 65535: outside of "
        "all objects; absent: not stored, or no dielectric");
    v.optional("vertices/primitive", x.primitive, 1, "vertex", "1",
               "triangle of the shape's mesh; 0 on a sphere or disk; absent: not stored");
    v.optional("vertices/diffuse", x.diffuse, 3, "vertex,rgb", "1",
               "diffuse reflectance, for materials where it is textured");
    v.optional("vertices/specular", x.specular, 3, "vertex,rgb", "1",
               "factor on specular reflection, for materials where it is textured");
    v.optional("vertices/transmittance", x.transmittance, 3, "vertex,rgb", "1",
               "factor on specular transmission, for materials where it is textured");
    v.optional("vertices/alpha", x.alpha, 2, "vertex,uv", "1",
               "microfacet roughness, for materials where it is textured");
    v.optional("vertices/opacity", x.opacity, 1, "vertex", "1",
               "1 - probability of passing straight on, for materials where it is textured");
    v.optional("vertices/exponent", x.exponent, 1, "vertex", "1", "Phong exponent, for materials where it is textured");
    v.optional("vertices/eta_c", x.eta_c, 3, "vertex,rgb", "1",
               "conductor: real part of the index, over outside, for materials where it or k_c is textured");
    v.optional("vertices/k_c", x.k_c, 3, "vertex,rgb", "1",
               "conductor: imaginary part of the index, over outside, for materials where it or eta_c is textured");

    auto& e = g.light_edges;
    v.field("light_edges/vertex", e.vertex, 1, "edge", "1", "row of vertices; never decreasing");
    v.field("light_edges/technique", e.technique, 1, "edge", "1",
            "0 next-event estimation, 1 BSDF sample that hit the light; in this order for a vertex");
    v.field("light_edges/y", e.y, 4, "edge,xyzw", "m, or 1 at infinity",
            "homogeneous light point: w = 1 position; w = 0 unit direction towards the light. Found by the BSDF "
            "sample it lies exactly in the sampled direction, off the light by the ray's offset at most");
    v.optional("light_edges/n", e.n, 2, "edge,uv", "1/32767", "normal at the light point, octahedral");
    v.field("light_edges/Li", e.Li, 3, "edge,rgb", "W m^-2 sr^-1",
            "radiance that arrives at the vertex; for point, spot and directional lights, projectors and laser spots "
            "the irradiance on a plane facing the light, so that f cos Li / pdf_nee_w is the estimate",
            Finite::counted);
    v.field("light_edges/pdf_nee_w", e.pdf_nee_w, 1, "edge", "sr^-1",
            "density of next-event estimation at the vertex, choice of emitter included; the probability (1) "
            "for delta lights; 0 where it cannot find this point");
    v.field("light_edges/pdf_bsdf_w", e.pdf_bsdf_w, 1, "edge", "sr^-1",
            "density of the BSDF sample, roulette folded in; 0 where it cannot find this point");
    v.field("light_edges/emitter", e.emitter, 1, "edge", "1", "row of emitters");
    v.optional("light_edges/eta", e.eta, 1, "edge", "1", "absolute refractive index along the edge; absent: 1");
    v.optional("light_edges/medium", e.medium, 1, "edge", "1",
               "row of materials of the dielectric that contains the edge, as vertices/medium");

    auto& m = g.misses;
    v.optional("misses/vertex", m.vertex, 1, "miss", "1",
               "row of vertices of failed light samples, never decreasing; misses holds all of them or is absent");
    v.optional("misses/technique", m.technique, 1, "miss", "1",
               "0 next-event estimation, 1 the BSDF sample that ended the path; in this order for a vertex");
    v.optional("misses/y", m.y, 4, "miss,xyzw", "m, or 1 at infinity",
               "target of the ray, as light_edges/y, or w = 0 and the unit direction of the BSDF sample; the vertex's "
               "own position: no ray was traced, because nothing could arrive");
    v.optional("misses/emitter", m.emitter, 1, "miss", "1", "row of the chosen emitter; 0 for a BSDF sample");
}

template <template <class> class ColumnOf>
template <class Self, class Visitor>
void PathGraphOf<ColumnOf>::fields(Self& g, Visitor& v) {
    auto& s = g.sensor;
    v.value("sensor/kind", s.kind, "", "1",
            "perspective, orthographic or nlos_capture_meter: the sensor measures the points of a relay wall (nlos) "
            "from its origin, one per pixel; width x height is the number of sensor points, or in an exhaustive "
            "capture of laser points x sensor points");
    v.value("sensor/width", s.width, "", "px", "image width");
    v.value("sensor/height", s.height, "", "px", "image height");
    v.value("sensor/world_from_camera", s.world_from_camera, "row,column", "1 and m",
            "world from camera; the camera looks along +z, +y is up, +x is left");
    v.value("sensor/origin", s.origin, "xyz", "m", "pinhole, world space");
    v.value("sensor/fov_x_deg", s.fov_x_deg, "", "degree", "full horizontal field of view; 0 for orthographic");
    v.value("sensor/principal_point", s.principal_point, "xy", "1",
            "offset of the principal point in image widths and heights");
    v.value("sensor/near_clip", s.near_clip, "", "m", "near clip distance along the optical axis");
    v.value("sensor/far_clip", s.far_clip, "", "m", "far clip distance along the optical axis");
    v.value("sensor/rfilter", s.rfilter, "", "1", "pixel filter of the scene");
    v.value("sensor/rfilter_radius", s.rfilter_radius, "", "px", "radius of the pixel filter");

    auto& t = g.tracing;
    v.value("tracing/first_sample", t.first_sample, "", "1", "index of the first sample of each pixel");
    v.value("tracing/samples_per_pixel", t.samples_per_pixel, "", "1", "samples of each pixel in this file");
    v.value("tracing/max_depth", t.max_depth, "", "1", "largest number of edges of a path; -1 for no limit");
    v.value("tracing/roulette", t.roulette, "", "1", "rule of Russian roulette");
    v.value("tracing/roulette_depth", t.roulette_depth, "", "1", "first vertex at which roulette may end a path");
    v.value("tracing/sampler", t.sampler, "", "1",
            "sampler; its numbers are a function of (seed, pixel, sample, dimension)");

    auto& w = g.transient;
    v.optional("transient/n_bins", w.n_bins, 1, "film", "1", "time-resolved film: number of bins");
    v.optional("transient/start_opl", w.start_opl, 1, "film", "m", "optical path length at the start of the first bin");
    v.optional("transient/bin_width_opl", w.bin_width_opl, 1, "film", "m", "width of a bin in optical path length");
    v.optional("transient/sigma_opl", w.sigma_opl, 1, "film", "m",
               "standard deviation of the film's Gaussian temporal filter; 0: box");
    v.optional("transient/camera_segment", w.camera_segment, 1, "film", "1",
               "1: lengths count from the camera, 0: from the first hit, and with nlos up to the laser spot");

    auto& c = g.nlos;
    v.optional("nlos/capture", c.capture, 1, "film", "1",
               "0 single: one laser point; 1 confocal: the laser point is the sensor point; 2 exhaustive: every laser "
               "point for every sensor point");
    v.optional("nlos/grids", c.grids, 4, "film,count", "1",
               "width and height of the grid of sensor points, then of laser points; points go row by row, x first");
    v.optional("nlos/true_area", c.true_area, 1, "film", "1",
               "0: a laser spot has unit area, 1: that of the beam's section");
    v.optional("nlos/laser", c.laser, 3, "film,xyz", "m", "position of the laser");
    v.optional("nlos/sensor_points", c.sensor_points, 3, "sensor_point,xyz", "m",
               "measured points of the relay wall; absent for a camera");
    v.optional("nlos/sensor_normals", c.sensor_normals, 3, "sensor_point,xyz", "1",
               "geometric normal at the sensor point");
    v.optional("nlos/laser_points", c.laser_points, 3, "laser_point,xyz", "m", "points that the laser hits");
    v.optional("nlos/laser_normals", c.laser_normals, 3, "laser_point,xyz", "1",
               "geometric normal at the laser point; (0, 0, 0): the laser hits nothing");

    PathRows<ColumnOf>::row_fields(g, v);

    auto& m = g.materials;
    v.names("materials/id", m.id, "material", "id in the scene file, or a generated one");
    v.field("materials/kind", m.kind, 1, "material", "1",
            "0 diffuse, 1 rough diffuse, 2 conductor, 3 rough conductor, 4 dielectric, 5 thin dielectric, 6 "
            "rough dielectric, 7 plastic, 8 rough plastic, 9 phong, 10 ward, 11 null");
    v.field("materials/distribution", m.distribution, 1, "material", "1", "microfacets: 0 GGX, 1 Beckmann");
    v.field("materials/two_sided", m.two_sided, 1, "material", "1", "1: both sides reflect alike");
    v.field("materials/nonlinear", m.nonlinear, 1, "material", "1",
            "1: internal scattering of a plastic shifts its colour");
    v.field("materials/sample_visible", m.sample_visible, 1, "material", "1",
            "1: microfacets are sampled by their visible area");
    v.field("materials/textured", m.textured, 1, "material", "1",
            "textured parameters, whose values are stored per vertex: bit 0 diffuse, bit 1 specular, bit 2 "
            "transmittance, bit 3 alpha, bit 4 opacity, bit 5 exponent, bit 6 eta_c and k_c");
    v.optional("materials/variant", m.variant, 1, "material", "1",
               "ward: 0 Ward's own normalisation, 1 Duer's, 2 balanced; absent: 2");
    v.optional("materials/bump_shadowing", m.bump_shadowing, 1, "material", "1",
               "bump or normal map: 1 darkens light from near the horizon, 0 does not; absent: 1");
    v.field("materials/int_ior", m.int_ior, 1, "material", "1", "absolute refractive index behind the normal");
    v.field("materials/ext_ior", m.ext_ior, 1, "material", "1", "absolute refractive index outside");
    v.field("materials/opacity", m.opacity, 1, "material", "1", "1 - probability of passing straight on");
    v.field("materials/alpha", m.alpha, 2, "material,uv", "1", "microfacet roughness");
    v.field("materials/exponent", m.exponent, 1, "material", "1", "Phong exponent");
    v.field("materials/diffuse", m.diffuse, 3, "material,rgb", "1", "diffuse reflectance");
    v.field("materials/specular", m.specular, 3, "material,rgb", "1", "factor on specular reflection");
    v.field("materials/transmittance", m.transmittance, 3, "material,rgb", "1", "factor on specular transmission");
    v.field("materials/eta_c", m.eta_c, 3, "material,rgb", "1", "conductor: real part of the index, over outside");
    v.field("materials/k_c", m.k_c, 3, "material,rgb", "1", "conductor: imaginary part of the index, over outside");
    v.field("materials/fdr_int", m.fdr_int, 1, "material", "1", "plastic: diffuse Fresnel reflectance from inside");
    v.field("materials/fdr_ext", m.fdr_ext, 1, "material", "1", "plastic: diffuse Fresnel reflectance from outside");
    v.optional("materials/external_transmittance", m.external_transmittance, 64, "material,cos_theta", "1",
               "rough plastic: transmittance of the interface, at cosines evenly spaced in [0, 1]");

    auto& r = g.coats;
    v.optional(
        "coats/material", r.material, 1, "coat", "1",
        "rough plastic with textured alpha: row of materials; rows of one material follow one another, evenly spaced "
        "in alpha; the interface of a vertex is interpolated linearly between two rows and clamped to the nearest end");
    v.optional("coats/alpha", r.alpha, 1, "coat", "1", "microfacet roughness");
    v.optional("coats/fdr_int", r.fdr_int, 1, "coat", "1",
               "diffuse Fresnel reflectance from inside, at this roughness");
    v.optional("coats/fdr_ext", r.fdr_ext, 1, "coat", "1",
               "diffuse Fresnel reflectance from outside, at this roughness");
    v.optional("coats/external_transmittance", r.external_transmittance, 64, "coat,cos_theta", "1",
               "transmittance of the interface at this roughness, at cosines evenly spaced in [0, 1]");

    auto& l = g.emitters;
    v.names("emitters/id", l.id, "emitter", "id in the scene file, or a generated one");
    v.field("emitters/kind", l.kind, 1, "emitter", "1",
            "0 area, 1 point, 2 spot, 3 directional, 4 constant, 5 envmap, 6 projector, 7 laser spot");
    v.field("emitters/pmf", l.pmf, 1, "emitter", "1", "probability that next-event estimation chooses it");
    v.optional("emitters/position", l.position, 3, "emitter,xyz", "m",
               "projector and laser spot: origin of the beam (the segment from it to the spot is no edge); (0, 0, 0) "
               "for others");

    v.names("shapes/id", g.shapes.id, "shape", "id in the scene file, or a generated one");
}

}  // namespace loom
