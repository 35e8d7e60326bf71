#pragma once
// radiance_cache: outgoing radiance of the surfaces of a static scene, to be queried at any point of them. It is made
// of the refined vertices of path graphs, and biased.                                                 [HY] section 3.4
//
// It has one of two methods: `points`, means of the clusters of vertices, or `grid`, features on hashed grids of several
// resolutions and a small network that decodes them.

#include <array>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include "formats/io/documenter.h"
#include "formats/io/field.h"
#include "formats/io/mapped_file.h"
#include "formats/io/output_file.h"
#include "formats/io/provenance.h"

namespace loom {

struct RadianceCache {
    static constexpr FormatId format{"radiance_cache", 1, 0};
    static constexpr std::size_t features_per_level = 2;

    std::string scene;                // content hash of the static scene, as in Provenance::inputs
    std::vector<std::string> graphs;  // content hashes of the path graphs

    struct Settings {
        std::string method = "points";  // or "grid"
        std::uint64_t seed = 0, samples = 0, batches = 0;
        std::uint64_t nonfinite = 0;   // labels that were not learnt
        float smallest_roughness = 0;  // as Clusters::Settings::private_roughness
    } settings;

    struct Domain {
        std::array<float, 3> lo{};
        float size = 1;
    } domain;
    std::uint8_t demodulated = 0;

    /// Metric of the search for the nearest points; as in Clusters::Settings.
    struct Metric {
        float normal_weight = 0, length_scale = 1;
        float median_distance = 0;  // of a held-back vertex to the nearest point; 0: none was held back
    } metric;

    struct Points {
        Column<float> p;
        Column<std::int16_t> n;
        Column<float> E, var;
        Column<std::uint16_t> members;
    } points;

    struct Grid {
        Column<std::uint32_t> resolution, first;
        Column<float> features;
    } grid;

    struct Mlp {
        Column<float> weight;
        Column<std::uint32_t> rows, columns;
    } mlp;
    std::vector<std::string> inputs;

    struct Validation {
        std::vector<std::string> material;
        Column<std::uint64_t> vertices;
        Column<double> relative_l2, mean_ratio;
    } validation;

    struct Training {
        Column<double> loss;
        Column<std::uint64_t> samples;
    } training;

    Provenance provenance;
    std::shared_ptr<const MappedFile> storage;

    std::size_t n_points() const { return points.members.size(); }
    std::size_t n_levels() const { return grid.resolution.size(); }
    bool is_grid() const { return settings.method == "grid"; }

    /// Checks the invariants beyond types, lengths and finite floats. Returns the first violation; empty when all hold.
    std::string problem() const;

    template <class Self, class Visitor>
    static void fields(Self& c, Visitor& v);
};

/// needs:   columns that share an axis have the same length
void write_radiance_cache(const RadianceCache& cache, const std::filesystem::path& path, Sync sync = Sync::yes);
/// Reads, maps and checks the whole file.
/// throws:  InputError naming the file and the dataset
RadianceCache read_radiance_cache(const std::filesystem::path& path);

template <class Self, class Visitor>
void RadianceCache::fields(Self& c, Visitor& v) {
    v.value("scene/hash", c.scene, "", "1", "content hash (XXH64, 16 hexadecimal digits) of the static scene");
    v.names("graphs/hash", c.graphs, "graph", "content hash of each path graph that it was made of");

    auto& s = c.settings;
    v.value("settings/method", s.method, "", "1", "points: means of clusters; grid: hashed grids and a network");
    v.value("settings/seed", s.seed, "", "1", "seed of the choice of held-back vertices, and of training");
    v.value("settings/samples", s.samples, "", "1",
            "points: vertices in the means; grid: training samples, repeated "
            "ones included");
    v.value("settings/batches", s.batches, "", "1", "grid: training batches; points: 0");
    v.value("settings/nonfinite", s.nonfinite, "", "1",
            "vertices whose label was NaN or infinite: counted, not learnt");
    v.value(
        "settings/smallest_roughness", s.smallest_roughness, "", "1",
        "smallest microfacet roughness of a surface that the cache covers; smoother ones, and those with delta lobes "
        "alone, are to be followed to the next surface");

    v.value("domain/lo", c.domain.lo, "xyz", "m", "least corner of the cube that is mapped to [0, 1]^3");
    v.value("domain/size", c.domain.size, "", "m", "edge of that cube");
    v.value("demodulated", c.demodulated, "", "1",
            "1: values are radiance over reflectance, the albedo of the BSDF at the vertex for its wo; 0: values are "
            "radiance");

    auto& m = c.metric;
    v.value(
        "metric/normal_weight", m.normal_weight, "", "1",
        "points: weight w of normals in distance^2 = (dp / s)^2 + (w dn)^2 between positions p and shading normals n "
        "on the side of wo");
    v.value("metric/length_scale", m.length_scale, "", "m", "points: length scale s in distance^2");
    v.value("metric/median_distance", m.median_distance, "", "1",
            "points: median distance of a held-back vertex to the nearest point; 0: no vertex was held back");

    auto& x = c.points;
    v.optional("points/p", x.p, 3, "point,xyz", "m", "mean position of the members of a cluster");
    v.optional("points/n", x.n, 2, "point,uv", "1/32767",
               "mean shading normal of the members, on the side of wo, octahedral");
    v.optional(
        "points/E", x.E, 3, "point,rgb", "W m^-2 sr^-1",
        "mean of the outgoing radiance of the members, without their own emission; where demodulated, sum of it over "
        "sum of reflectances");
    v.optional("points/var", x.var, 3, "point,rgb", "W^2 m^-4 sr^-2", "variance of points/E; 0 for one member");
    v.optional("points/members", x.members, 1, "point", "1", "vertices in the mean; 65535: that many or more");

    auto& g = c.grid;
    v.optional("grid/resolution", g.resolution, 1, "level", "1", "cells per edge of the cube");
    v.optional("grid/first", g.first, 1, "level+1", "1", "offsets into grid/features");
    v.optional("grid/features", g.features, features_per_level, "entry,feature", "1",
               "features of the corners of cells; a level with fewer entries than corners is hashed");

    v.optional("mlp/weight", c.mlp.weight, 1, "weight", "1", "weights, layer after layer, row-major");
    v.optional("mlp/rows", c.mlp.rows, 1, "layer", "1", "outputs of each layer; 3 (rgb) of the last");
    v.optional("mlp/columns", c.mlp.columns, 1, "layer", "1", "inputs of each layer");
    v.optional_names("inputs", c.inputs, "input", "name of each input of the first layer");

    auto& h = c.validation;
    v.names("validation/material", h.material, "material", "id in the scene file, or a generated one");
    v.field("validation/vertices", h.vertices, 1, "material", "1", "vertices held back, 1 % of all");
    v.field("validation/relative_l2", h.relative_l2, 1, "material", "1",
            "mean over held-back vertices and channels of (y - t)^2 / (t^2 + 0.01) of cached radiance y and label t; 0 "
            "without vertices");
    v.field("validation/mean_ratio", h.mean_ratio, 1, "material", "1",
            "sum of y over sum of t on held-back vertices; 1 where the sum of t is 0");

    auto& t = c.training;
    v.optional("training/loss", t.loss, 1, "snapshot", "1", "mean loss since the last snapshot", Finite::counted);
    v.optional("training/samples", t.samples, 1, "snapshot", "1", "training samples up to the snapshot");
}

}  // namespace loom
