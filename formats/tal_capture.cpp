#include "formats/tal_capture.h"

#include <fmt/format.h>

#include <stdexcept>
#include <utility>

#include "formats/io/field_checker.h"
#include "formats/io/hdf5_handle.h"

namespace loom {
namespace {

using Names = std::vector<std::pair<const char*, std::int32_t>>;

const Names h_formats{{"UNKNOWN", 0}, {"T_Sx_Sy", 1}, {"T_Lx_Ly_Sx_Sy", 2}, {"T_Si", 3}, {"T_Li_Si", 4}};
const Names grid_formats{{"UNKNOWN", 0}, {"N_3", 1}, {"X_Y_3", 2}};
const Names volume_formats{{"UNKNOWN", 0}, {"N_3", 1}, {"X_Y_Z_3", 2}, {"X_Y_3", 3}};

class TalWriter {
  public:
    explicit TalWriter(const std::filesystem::path& path) : output_(path) {
        start_hdf5();
        const Hdf5Handle creation(H5Pcreate(H5P_FILE_CREATE), H5Pclose);
        H5Pset_obj_track_times(creation.get(), false);
        file_ = Hdf5Handle(H5Fcreate(output_.partial().c_str(), H5F_ACC_TRUNC, creation.get(), H5P_DEFAULT), H5Fclose);
        if (!file_) fail("the file");
    }

    void dataset(const char* name, const std::vector<hsize_t>& extents, hid_t type, const void* data) {
        const Hdf5Handle creation(H5Pcreate(H5P_DATASET_CREATE), H5Pclose);
        H5Pset_obj_track_times(creation.get(), false);
        const Hdf5Handle space(
            extents.empty() ? H5Screate(H5S_SCALAR) : H5Screate_simple(int(extents.size()), extents.data(), nullptr),
            H5Sclose);
        const Hdf5Handle made(
            H5Dcreate2(file_.get(), name, type, space.get(), H5P_DEFAULT, creation.get(), H5P_DEFAULT), H5Dclose);
        if (!made || H5Dwrite(made.get(), type, H5S_ALL, H5S_ALL, H5P_DEFAULT, data) < 0) fail(name);
    }
    void floats(const char* name, const std::vector<hsize_t>& extents, const float* data) {
        dataset(name, extents, H5T_IEEE_F32LE, data);
    }
    void choice(const char* name, const Names& names, std::int32_t value) {
        const Hdf5Handle type(H5Tenum_create(H5T_STD_I32LE), H5Tclose);
        for (const auto& [text, number] : names) H5Tenum_insert(type.get(), text, &number);
        dataset(name, {1}, type.get(), &value);
    }
    /// Writes a boolean as h5py does.
    void truth(const char* name, bool value) {
        const Hdf5Handle type(H5Tenum_create(H5T_STD_I8LE), H5Tclose);
        const std::int8_t no = 0, yes = 1, said = value;
        H5Tenum_insert(type.get(), "FALSE", &no);
        H5Tenum_insert(type.get(), "TRUE", &yes);
        dataset(name, {}, type.get(), &said);
    }
    void text(const char* name, const std::string& value) {
        const Hdf5Handle type(H5Tcopy(H5T_C_S1), H5Tclose);
        H5Tset_size(type.get(), H5T_VARIABLE);
        H5Tset_cset(type.get(), H5T_CSET_UTF8);
        const char* const data = value.c_str();
        dataset(name, {}, type.get(), &data);
    }
    void grid(const std::string& of, const TalCapture::Grid& grid) {
        if (grid.xyz.size() != 3 * grid.size() || grid.normals.size() != 3 * grid.size())
            throw std::logic_error(output_.path().native() + ": " + of +
                                   "_grid: width x height is not its number of points");
        const std::vector<hsize_t> extents{grid.width, grid.height, 3};
        floats((of + "_grid_xyz").c_str(), extents, grid.xyz.data());
        floats((of + "_grid_normals").c_str(), extents, grid.normals.data());
        choice((of + "_grid_format").c_str(), grid_formats, 2);
    }
    void commit(Sync sync, const std::string& nonfinite) {
        if (H5Fflush(file_.get(), H5F_SCOPE_LOCAL) < 0 || !file_.close()) fail("the file");
        output_.commit(sync, nonfinite);
    }

  private:
    [[noreturn]] void fail(std::string_view what) const {
        throw std::runtime_error(
            fmt::format("{}: cannot write {}: {}", output_.path().native(), what, hdf5_error_text()));
    }
    OutputFile output_;
    Hdf5Handle file_;
};

}  // namespace

void write_tal_capture(const TalCapture& c, const std::filesystem::path& path, Sync sync) {
    const std::size_t pairs = c.sensor_grid.size() * (c.exhaustive ? c.laser_grid.size() : 1);
    if (c.H.size() != c.n_bins * pairs)
        throw std::logic_error(path.native() + ": H has not as many values as its grids have points");
    TalWriter writer(path);
    std::vector<hsize_t> extents{c.n_bins};
    if (c.exhaustive) extents.insert(extents.end(), {c.laser_grid.width, c.laser_grid.height});
    extents.insert(extents.end(), {c.sensor_grid.width, c.sensor_grid.height});
    writer.floats("H", extents, c.H.data());
    writer.choice("H_format", h_formats, c.exhaustive ? 2 : 1);
    writer.floats("sensor_xyz", {3}, c.sensor.data());
    writer.grid("sensor", c.sensor_grid);
    writer.floats("laser_xyz", {3}, c.laser.data());
    writer.grid("laser", c.laser_grid);
    writer.choice("volume_format", volume_formats, 2);
    writer.floats("delta_t", {}, &c.delta_t);
    writer.floats("t_start", {}, &c.t_start);
    writer.truth("t_accounts_first_and_last_bounces", c.accounts_first_and_last);
    writer.text("scene_info", c.scene_info);
    const std::size_t n_nonfinite = count_nonfinite(c.H);
    writer.commit(sync, n_nonfinite > 0 ? fmt::format("{} of H", n_nonfinite) : "");
}

}  // namespace loom
