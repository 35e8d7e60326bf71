// Names, types and shapes as y-tal 0.20 writes and reads them.
#include "formats/tal_capture.h"

#include <gtest/gtest.h>
#include <unistd.h>

#include "formats/io/hdf5_handle.h"

namespace loom {
namespace {

class TalFile : public ::testing::Test {
  protected:
    void SetUp() override {
        path_ = std::filesystem::temp_directory_path() / ("loom-tal-" + std::to_string(getpid()) + ".h5");
    }
    void TearDown() override { std::filesystem::remove(path_); }

    static TalCapture small(bool exhaustive) {
        TalCapture c;
        c.exhaustive = exhaustive;
        c.n_bins = 5;
        c.sensor_grid = {2, 3, std::vector<float>(18, 0.5f), std::vector<float>(18, 1)};
        c.laser_grid = {exhaustive ? 4u : 1u, 1, {}, {}};
        c.laser_grid.xyz = c.laser_grid.normals = std::vector<float>(3 * c.laser_grid.size(), 0.25f);
        c.H.resize(5 * 6 * (exhaustive ? 4 : 1));
        for (std::size_t i = 0; i < c.H.size(); ++i) c.H[i] = float(i);
        c.delta_t = 0.003f;
        c.t_start = 1.5f;
        c.scene_info = "{\"a\": 1}\n";
        return c;
    }
    Hdf5Handle open(const char* name) {
        if (!file_) file_ = open_hdf5(path_);
        return {H5Dopen2(file_.get(), name, H5P_DEFAULT), H5Dclose};
    }
    std::vector<std::size_t> extents(const char* name) {
        const Hdf5Handle set = open(name), space(H5Dget_space(set.get()), H5Sclose);
        return extents_of(space.get());
    }
    std::vector<float> floats(const char* name) {
        const Hdf5Handle set = open(name), space(H5Dget_space(set.get()), H5Sclose);
        std::vector<float> values(std::size_t(H5Sget_simple_extent_npoints(space.get())));
        EXPECT_GE(H5Dread(set.get(), H5T_NATIVE_FLOAT, H5S_ALL, H5S_ALL, H5P_DEFAULT, values.data()), 0);
        return values;
    }
    /// Name of the value of an enumeration.
    std::string chosen(const char* name) {
        const Hdf5Handle set = open(name), type(H5Dget_type(set.get()), H5Tclose);
        std::int32_t value = 0;
        char text[64] = "";
        EXPECT_GE(H5Dread(set.get(), type.get(), H5S_ALL, H5S_ALL, H5P_DEFAULT, &value), 0);
        EXPECT_GE(H5Tenum_nameof(type.get(), &value, text, sizeof text), 0);
        return text;
    }
    std::filesystem::path path_;
    Hdf5Handle file_;
};

using Extents = std::vector<std::size_t>;

TEST_F(TalFile, SingleCapture) {
    write_tal_capture(small(false), path_, Sync::no);
    EXPECT_EQ(extents("H"), (Extents{5, 2, 3}));
    EXPECT_EQ(floats("H")[7], 7);
    EXPECT_EQ(chosen("H_format"), "T_Sx_Sy");
    EXPECT_EQ(extents("sensor_grid_xyz"), (Extents{2, 3, 3}));
    EXPECT_EQ(extents("sensor_grid_normals"), (Extents{2, 3, 3}));
    EXPECT_EQ(chosen("sensor_grid_format"), "X_Y_3");
    EXPECT_EQ(extents("laser_grid_xyz"), (Extents{1, 1, 3}));
    EXPECT_EQ(chosen("laser_grid_format"), "X_Y_3");
    EXPECT_EQ(extents("sensor_xyz"), (Extents{3}));
    EXPECT_EQ(extents("laser_xyz"), (Extents{3}));
    EXPECT_EQ(extents("delta_t"), Extents{});
    EXPECT_EQ(floats("delta_t")[0], 0.003f);
    EXPECT_EQ(floats("t_start")[0], 1.5f);
    EXPECT_EQ(chosen("t_accounts_first_and_last_bounces"), "FALSE");
    EXPECT_TRUE(open("scene_info"));
    EXPECT_TRUE(open("volume_format"));
}

TEST_F(TalFile, ExhaustiveCapture) {
    const TalCapture c = small(true);
    write_tal_capture(c, path_, Sync::no);
    EXPECT_EQ(extents("H"), (Extents{5, 4, 1, 2, 3}));
    EXPECT_EQ(chosen("H_format"), "T_Lx_Ly_Sx_Sy");
    EXPECT_EQ(extents("laser_grid_xyz"), (Extents{4, 1, 3}));
    EXPECT_EQ(c.place(1, 2, 0, 1, 2), 24u + 2 * 6 + 3 + 2);
}

TEST_F(TalFile, WrongSizesAreRefused) {
    TalCapture c = small(false);
    c.H.pop_back();
    EXPECT_THROW(write_tal_capture(c, path_, Sync::no), std::logic_error);
    EXPECT_FALSE(std::filesystem::exists(path_));
}

}  // namespace
}  // namespace loom
