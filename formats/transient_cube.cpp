#include "formats/transient_cube.h"

#include <fmt/format.h>

#include <cmath>

#include "formats/io/hdf5_format.h"

namespace loom {

std::string difference_in_words(const TransientCubeHeader& a, const TransientCubeHeader& b, double slack) {
    if (a.film.width != b.film.width || a.film.height != b.film.height)
        return fmt::format("is {} x {} pixels, not {} x {}", a.film.width, a.film.height, b.film.width, b.film.height);
    const auto &t = a.time, &u = b.time;
    if (t.n_bins != u.n_bins) return fmt::format("has {} bins, not {}", t.n_bins, u.n_bins);
    const double far = slack * u.bin_width_opl;
    const bool apart = std::abs(t.start_opl - u.start_opl) > far || std::abs(t.n_bins * (t.bin_width_opl - u.bin_width_opl)) > far;
    if (apart || std::abs(t.gate_opl - u.gate_opl) > far)
        return fmt::format("has bins of {:.9g} m (gate {:.9g}) from {:.9g}, not of {:.9g} m (gate {:.9g}) from {:.9g}", t.bin_width_opl, t.gate_opl, t.start_opl,
                           u.bin_width_opl, u.gate_opl, u.start_opl);
    if (t.camera_segment != u.camera_segment)
        return t.camera_segment ? "counts lengths from the camera, not from the first hit" : "counts lengths from the first hit, not from the camera";
    const auto &r = a.response, &s = b.response;
    if (r.pulse != s.pulse || r.length_opl != s.length_opl || r.tail_opl != s.tail_opl || r.period_opl != s.period_opl)
        return fmt::format("has a {} pulse (length {:.9g}, tail {:.9g}, period {:.9g}), not {} (length {:.9g}, tail {:.9g}, period {:.9g})", r.pulse, r.length_opl,
                           r.tail_opl, r.period_opl, s.pulse, s.length_opl, s.tail_opl, s.period_opl);
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

void TransientCubeWriter::commit(Sync sync) { writer_->commit(sync); }

TransientCube read_transient_cube(const std::filesystem::path& path) { return read_format<TransientCube>(path); }

}  // namespace loom
