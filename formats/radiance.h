#pragma once
// radiance: reflected radiance of each vertex of a path graph towards its previous vertex, refined with its neighbours.

#include <cstdint>
#include <filesystem>
#include <memory>
#include <string>

#include "formats/io/documenter.h"
#include "formats/io/field.h"
#include "formats/io/mapped_file.h"
#include "formats/io/output_file.h"
#include "formats/io/provenance.h"

namespace loom {

struct PathGraph;

struct Radiance {
    static constexpr FormatId format{"radiance", 1, 0};

    std::string graph, clusters;       // content hashes, as in Provenance::inputs; clusters empty when none were used
    std::uint64_t graph_vertices = 0;  // vertices of that graph

    struct Settings {
        std::string method = "fixed-point";  // or "west"
        std::string reuse = "directions";    // or "points"
        std::string clamp = "column";        // or "none", "cluster"
        std::string start = "paths";         // or "zero"
        std::int32_t iterations = 0;
        float epsilon = 1e-3f;
        std::uint8_t as_printed = 0;
    } settings;

    Column<float> L;                        // reflected radiance, without emission
    Column<float> direct;                   // direct part of L at first vertices; required by a gather
    Column<float> indirect_path;            // estimate of the rest by the path's own samples alone; absent for "west"
    Column<double> residual, image_change;  // [iteration]
    double clamped_share = 0;

    Provenance provenance;
    std::shared_ptr<const MappedFile> storage;

    /// Checks the invariants beyond types, lengths and finite floats. Returns the first violation; empty when all hold.
    std::string problem() const;

    template <class Self, class Visitor>
    static void fields(Self& r, Visitor& v);
};

/// needs:   columns that share an axis have the same length
void write_radiance(const Radiance& radiance, const std::filesystem::path& path, Sync sync = Sync::yes);
/// Reads, maps and checks the whole file.
/// throws:  InputError naming the file and the dataset
Radiance read_radiance(const std::filesystem::path& path);

/// Refuses radiance of another graph than `graph`, whose content is `graph_id`, and radiance without the direct light
/// of every path.
/// throws:  InputError naming both files and the command that makes matching radiance
void require_radiance_of(const PathGraph& graph, const InputId& graph_id, const Radiance& radiance,
                         const std::filesystem::path& radiance_path);

template <class Self, class Visitor>
void Radiance::fields(Self& r, Visitor& v) {
    v.value("graph/hash", r.graph, "", "1", "content hash (XXH64, 16 hexadecimal digits) of the path graph");
    v.value("graph/n_vertices", r.graph_vertices, "", "1", "vertices of the path graph");
    v.value("clusters/hash", r.clusters, "", "1", "content hash of the clusters; empty when none were used");

    auto& s = r.settings;
    v.value("settings/method", s.method, "", "1",
            "fixed-point: aggregation and propagation; west: one aggregation over nearest neighbours");
    v.value("settings/reuse", s.reuse, "", "1",
            "points: continuations of neighbours are reconnected; directions: only their direction is taken");
    v.value("settings/clamp", s.clamp, "", "1", "none; column: once, per edge; cluster: per cluster and iteration");
    v.value("settings/start", s.start, "", "1", "paths: from the radiance of the paths; zero: from zero");
    v.value("settings/iterations", s.iterations, "", "1", "requested number of Jacobi steps");
    v.value("settings/epsilon", s.epsilon, "", "1", "margin of the clamp: gains are limited to 1 - epsilon");
    v.value("settings/as_printed", s.as_printed, "", "1", "1: the paper's equations as printed (biased)");

    v.field("vertices/L", r.L, 3, "vertex,rgb", "W m^-2 sr^-1",
            "radiance that the vertex reflects towards wo, without its own emission; where steps from zero count "
            "bounces, it has one bounce less at vertices other than first hits",
            Finite::counted);
    v.optional("paths/direct", r.direct, 3, "path,rgb", "W m^-2 sr^-1",
               "part of L at the first vertex that is reflected light of emitters; 0 for paths without vertices",
               Finite::counted);
    v.optional("paths/indirect_path", r.indirect_path, 3, "path,rgb", "W m^-2 sr^-1",
               "indirect light that the first vertex reflects, estimated by the path's own samples alone; 0 for paths "
               "without vertices",
               Finite::counted);
    v.field("iterations/residual", r.residual, 1, "iteration", "1", "sum |X' - X| / sum |X'| over vertices",
            Finite::counted);
    v.field("iterations/image_change", r.image_change, 1, "iteration", "1",
            "sum |X' - X| / sum |X'| over first vertices", Finite::counted);
    v.value("clamped_share", r.clamped_share, "", "1", "share of the energy that the clamp removed");
}

}  // namespace loom
