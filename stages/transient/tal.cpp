#include "stages/transient/tal.h"

#include "formats/io/json.h"
#include "formats/io/provenance.h"

namespace loom::transient {
namespace {

/// Converts rows of y to columns of x.
TalCapture::Grid grid_of(std::uint32_t width, std::uint32_t height, const Column<float>& points,
                         const Column<float>& normals, double metres) {
    TalCapture::Grid grid{width, height, {}, {}};
    for (std::uint32_t x = 0; x < width; ++x)
        for (std::uint32_t y = 0; y < height; ++y)
            for (int k = 0; k < 3; ++k) {
                const std::size_t i = 3 * (std::size_t(y) * width + x) + k;
                grid.xyz.push_back(float(points[i] * metres));
                grid.normals.push_back(normals[i]);
            }
    return grid;
}

}  // namespace

TalCapture start_capture(const PathGraph& graph, const TransientCubeHeader& header) {
    const auto& c = graph.nlos;
    const double metres = header.time.metres_per_unit;
    TalCapture tal;
    tal.exhaustive = c.capture[0] == 2;
    tal.n_bins = header.time.n_bins;
    tal.sensor_grid = grid_of(c.grids[0], c.grids[1], c.sensor_points, c.sensor_normals, metres);
    tal.laser_grid = grid_of(c.grids[2], c.grids[3], c.laser_points, c.laser_normals, metres);
    for (int k = 0; k < 3; ++k) {
        tal.sensor[k] = float(graph.sensor.origin[k] * metres);
        tal.laser[k] = float(c.laser[k] * metres);
    }
    tal.delta_t = float(header.time.bin_width_opl * metres);
    tal.t_start = float(header.time.start_opl * metres);
    tal.accounts_first_and_last = header.time.camera_segment != 0;
    JsonWriter info;  // JSON is YAML
    info.begin_object();
    info.begin_object("pathloom");
    info.text("producer", producer_text(header.provenance));
    info.text("command", header.provenance.command);
    info.text("plan", header.provenance.plan);
    info.integer("samples_per_pixel", header.film.samples_per_pixel);
    info.begin_array("inputs");
    for (const InputId& input : header.provenance.inputs) info.text({}, input_text(input));
    info.end_array();
    info.end_object();
    info.end_object();
    tal.scene_info = info.str();
    tal.H.assign(tal.n_bins * header.n_pixels(), 0.0f);
    return tal;
}

void add_rows(const PathGraph& graph, std::uint32_t first_row, const TransientRows& rows, TalCapture& capture) {
    const std::uint32_t width = graph.sensor.width, n_bins = capture.n_bins;
    const std::uint32_t sensor_width = capture.sensor_grid.width, laser_width = capture.laser_grid.width;
    const std::size_t n = rows.radiance.size() / (3 * std::size_t(n_bins));
    for (std::size_t i = 0; i < n; ++i) {
        const std::uint32_t y = first_row + std::uint32_t(i / width), x = std::uint32_t(i % width);
        const float* value = &rows.radiance[i * n_bins * 3];
        for (std::uint32_t t = 0; t < n_bins; ++t, value += 3) {
            const std::size_t at = capture.exhaustive ? capture.place(t, x % laser_width, x / laser_width,
                                                                      y % sensor_width, y / sensor_width)
                                                      : capture.place(t, 0, 0, x, y);
            capture.H[at] = value[0] + value[1] + value[2];
        }
    }
}

}  // namespace loom::transient
