#include "formats/radiance.h"

#include <fmt/format.h>

#include "formats/io/error.h"
#include "formats/io/hdf5_format.h"
#include "formats/path_graph.h"

namespace loom {

std::string Radiance::problem() const {
    if (settings.method != "fixed-point" && settings.method != "west")
        return fmt::format("settings/method: is {}, expected fixed-point or west", settings.method);
    if (settings.clamp != "none" && settings.clamp != "column" && settings.clamp != "cluster")
        return fmt::format("settings/clamp: is {}, expected none, column or cluster", settings.clamp);
    if (settings.reuse != "directions" && settings.reuse != "points")
        return fmt::format("settings/reuse: is {}, expected directions or points", settings.reuse);
    if (settings.start != "paths" && settings.start != "zero")
        return fmt::format("settings/start: is {}, expected paths or zero", settings.start);
    if (L.size() != 3 * graph_vertices)
        return fmt::format("vertices/L: has {} rows, but the graph has {} vertices", L.size() / 3, graph_vertices);
    return {};
}

void write_radiance(const Radiance& radiance, const std::filesystem::path& path, Sync sync) {
    write_format(radiance, path, sync);
}

Radiance read_radiance(const std::filesystem::path& path) {
    return read_format<Radiance>(path);
}

void require_radiance_of(const PathGraph& graph, const InputId& graph_id, const Radiance& radiance,
                         const std::filesystem::path& radiance_path) {
    if (radiance.graph == graph_id.hash && radiance.graph_vertices == graph.n_vertices()) {
        if (radiance.direct.size() == 3 * graph.n_paths()) return;
        throw InputError(fmt::format("{}: paths/direct has {} rows, but the graph has {} paths", radiance_path.native(),
                                     radiance.direct.size() / 3, graph.n_paths()));
    }
    const std::string made_from =
        radiance.provenance.inputs.empty() ? "another graph" : radiance.provenance.inputs[0].name;
    throw InputError(
        fmt::format("{}: made from {} (content {}), not from {} (content {}); run: loom-refine {} CLUSTERS -o {}",
                    radiance_path.native(), made_from, radiance.graph, graph_id.name, graph_id.hash, graph_id.name,
                    radiance_path.native()));
}

}  // namespace loom
