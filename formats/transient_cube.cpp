#include "formats/transient_cube.h"

#include <fmt/format.h>

#include <cmath>

#include "formats/io/hdf5_format.h"
#include "formats/io/hdf5_handle.h"

namespace loom {

std::string difference_in_words(const TransientCubeHeader& a, const TransientCubeHeader& b, double slack) {
    if (a.film.width != b.film.width || a.film.height != b.film.height)
        return fmt::format("is {} x {} pixels, not {} x {}", a.film.width, a.film.height, b.film.width, b.film.height);
    const auto &t = a.time, &u = b.time;
    if (t.n_bins != u.n_bins) return fmt::format("has {} bins, not {}", t.n_bins, u.n_bins);
    const double far = slack * u.bin_width_opl;
    const bool apart =
        std::abs(t.start_opl - u.start_opl) > far || std::abs(t.n_bins * (t.bin_width_opl - u.bin_width_opl)) > far;
    const bool told = !a.response.pulse.empty() && !b.response.pulse.empty();
    if (apart || (told && std::abs(t.gate_opl - u.gate_opl) > far))
        return fmt::format("has bins of {:.9g} m (gate {:.9g}) from {:.9g}, not of {:.9g} m (gate {:.9g}) from {:.9g}",
                           t.bin_width_opl, t.gate_opl, t.start_opl, u.bin_width_opl, u.gate_opl, u.start_opl);
    if (!told) return {};
    if (t.camera_segment != u.camera_segment)
        return t.camera_segment ? "counts lengths from the camera, not from the first hit"
                                : "counts lengths from the first hit, not from the camera";
    const auto &r = a.response, &s = b.response;
    if (r.pulse != s.pulse || r.length_opl != s.length_opl || r.tail_opl != s.tail_opl || r.period_opl != s.period_opl)
        return fmt::format(
            "has a {} pulse (length {:.9g}, tail {:.9g}, period {:.9g}), not {} (length {:.9g}, tail {:.9g}, period "
            "{:.9g})",
            r.pulse, r.length_opl, r.tail_opl, r.period_opl, s.pulse, s.length_opl, s.tail_opl, s.period_opl);
    return {};
}

std::string TransientCube::problem() const {
    if (film.width == 0 || film.height == 0) return "film/width, film/height: the film has no pixels";
    if (time.n_bins == 0) return "time/n_bins: is 0";
    if (!(time.bin_width_opl > 0)) return "time/bin_width_opl: is not positive";
    if (time.unit != "opl" && time.unit != "ns") return fmt::format("time/unit: is {}, expected opl or ns", time.unit);
    if (!(time.metres_per_unit > 0)) return "time/metres_per_unit: is not positive";
    if (radiance.size() != film.height * row_size())
        return fmt::format("radiance: has {} rows, but film/height is {}", radiance.size() / row_size(), film.height);
    return {};
}

TransientCubeWriter::TransientCubeWriter(const std::filesystem::path& path, const TransientCubeHeader& header)
    : row_size_(header.row_size()), width_(header.film.width) {
    TransientCubeOf<LateColumn> cube;
    static_cast<TransientCubeHeader&>(cube) = header;
    cube.radiance = cube.var_mean = LateColumn<float>(row_size_ * header.film.height);
    cube.before = cube.after = cube.never = cube.steady = LateColumn<float>(3 * header.n_pixels());
    writer_ = std::make_unique<Hdf5Writer>(path, cube.format, header.provenance);
    TransientCubeOf<LateColumn>::fields(cube, *writer_);
}

TransientCubeWriter::~TransientCubeWriter() = default;

void TransientCubeWriter::write_rows(std::uint32_t first_row, const TransientRows& rows) {
    const std::size_t bins = first_row * row_size_, pixels = first_row * 3 * width_;
    writer_->fill("radiance", bins, rows.radiance);
    writer_->fill("var_mean", bins, rows.var_mean);
    writer_->fill("before", pixels, rows.before);
    writer_->fill("after", pixels, rows.after);
    writer_->fill("never", pixels, rows.never);
    writer_->fill("steady", pixels, rows.steady);
}

void TransientCubeWriter::commit(Sync sync) {
    writer_->commit(sync);
}

TransientCube read_transient_cube(const std::filesystem::path& path) {
    return read_format<TransientCube>(path);
}

namespace {

/// Reads the numbers of a foreign dataset [y, x, bin, channel]; a single channel is copied to three.
std::vector<float> foreign_numbers(const std::filesystem::path& path, hid_t file, const char* name,
                                   std::vector<std::size_t>& extents) {
    const auto refuse = [&](const std::string& why) { throw InputError(fmt::format("{}: {}", path.native(), why)); };
    if (H5Lexists(file, name, H5P_DEFAULT) <= 0)
        refuse(fmt::format("is no transient_cube, and has no dataset {}", name));
    const Hdf5Handle dataset(H5Dopen2(file, name, H5P_DEFAULT), H5Dclose);
    if (!dataset) refuse(fmt::format("{}: not a dataset, or damaged", name));
    const Hdf5Handle space(H5Dget_space(dataset.get()), H5Sclose);
    extents = extents_of(space.get());
    if (extents.size() != 4 || (extents[3] != 1 && extents[3] != 3) || extents[0] * extents[1] * extents[2] == 0)
        refuse(fmt::format("{}: expected axes y, x, bin, channel, with one channel or three", name));
    const std::size_t n = extents[0] * extents[1] * extents[2];
    std::vector<float> values(n * extents[3]);
    if (H5Dread(dataset.get(), H5T_NATIVE_FLOAT, H5S_ALL, H5S_ALL, H5P_DEFAULT, values.data()) < 0)
        refuse(fmt::format("{}: cannot read: {}", name, hdf5_error_text()));
    if (extents[3] == 3) return values;
    std::vector<float> triples(3 * n);
    for (std::size_t i = 0; i < 3 * n; ++i) triples[i] = values[i / 3];
    return triples;
}

double foreign_attribute(const std::filesystem::path& path, hid_t file, const char* name) {
    double value = 0;
    const Hdf5Handle attribute(H5Aopen(file, name, H5P_DEFAULT), H5Aclose);
    if (!attribute || H5Aread(attribute.get(), H5T_NATIVE_DOUBLE, &value) < 0)
        throw InputError(
            fmt::format("{}: is no transient_cube, and has no number {} among its attributes", path.native(), name));
    return value;
}

}  // namespace

bool is_transient_cube(const std::filesystem::path& path) {
    try {
        const auto filetype = text_attribute(open_hdf5(path).get(), "filetype");
        return filetype && filetype->size() == 1 && filetype->front() == TransientCube::format.name;
    } catch (const InputError&) {
        return false;
    }
}

TransientCube read_any_cube(const std::filesystem::path& path) {
    const Hdf5Handle file = open_hdf5(path);
    if (text_attribute(file.get(), "filetype")) return read_transient_cube(path);
    TransientCube cube;
    std::vector<std::size_t> extents, of_variance;
    cube.radiance = foreign_numbers(path, file.get(), "mean", extents);
    cube.var_mean = foreign_numbers(path, file.get(), "var_mean", of_variance);
    if (extents != of_variance)
        throw InputError(fmt::format("{}: mean and var_mean differ in their extents", path.native()));
    cube.film = {std::uint32_t(extents[1]), std::uint32_t(extents[0]),
                 std::uint64_t(foreign_attribute(path, file.get(), "spp"))};
    cube.time.n_bins = std::uint32_t(extents[2]);
    cube.time.start_opl = foreign_attribute(path, file.get(), "start_opl");
    cube.time.bin_width_opl = cube.time.gate_opl = foreign_attribute(path, file.get(), "bin_width_opl");
    cube.response.pulse.clear();
    if (const std::string problem = cube.problem(); !problem.empty())
        throw InputError(fmt::format("{}: {}", path.native(), problem));
    return cube;
}

}  // namespace loom
