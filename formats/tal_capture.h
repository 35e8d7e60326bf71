#pragma once
// An NLOS capture in the format of the TAL tools, not a format of this project. Names, types and enumeration values are
// those of the public package y-tal 0.20 ("HDF5_TAL").

#include <array>
#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include "formats/io/output_file.h"

namespace loom {

struct TalCapture {
    /// Points of a grid on the relay wall, x slowest: float[3] each.
    struct Grid {
        std::uint32_t width = 0, height = 0;
        std::vector<float> xyz, normals;
        std::size_t size() const { return std::size_t(width) * height; }
    };

    bool exhaustive = false;
    std::uint32_t n_bins = 0;
    std::vector<float> H;  // [t, sensor x, sensor y], or [t, laser x, laser y, sensor x, sensor y] when exhaustive
    Grid sensor_grid, laser_grid;
    std::array<float, 3> sensor{}, laser{};  // m, positions
    float delta_t = 0, t_start = 0;          // m of optical path length
    bool accounts_first_and_last = false;
    std::string scene_info;  // YAML

    /// Returns the index in H of one bin of a (laser, sensor) pair.
    std::size_t place(std::uint32_t bin, std::uint32_t laser_x, std::uint32_t laser_y, std::uint32_t sensor_x,
                      std::uint32_t sensor_y) const {
        std::size_t at = bin;
        if (exhaustive) at = (at * laser_grid.width + laser_x) * laser_grid.height + laser_y;
        return (at * sensor_grid.width + sensor_x) * sensor_grid.height + sensor_y;
    }
};

/// Writes by write-then-rename; equal data give equal bytes.
void write_tal_capture(const TalCapture& capture, const std::filesystem::path& path, Sync sync = Sync::yes);

}  // namespace loom
