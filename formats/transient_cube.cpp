#include "formats/transient_cube.h"

#include <fmt/format.h>

#include "formats/io/hdf5_format.h"

namespace loom {

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
