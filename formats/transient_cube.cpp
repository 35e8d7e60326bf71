#include "formats/transient_cube.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <cmath>
#include <tuple>

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

std::string parameter_difference_in_words(const TransientCubeHeader& a, const TransientCubeHeader& b) {
    const auto &p = a.parameters, &q = b.parameters;
    if (a.n_parameters() != b.n_parameters())
        return fmt::format("has derivatives by {} parameters, not by {}", a.n_parameters(), b.n_parameters());
    for (std::size_t i = 0; i < a.n_parameters(); ++i) {
        if (p.name[i] != q.name[i]) return fmt::format("has parameter {} in place {}, not {}", p.name[i], i, q.name[i]);
        if (p.unit[i] != q.unit[i])
            return fmt::format("has parameter {} in {}, not in {}", p.name[i], p.unit[i], q.unit[i]);
        if (p.value[i] != q.value[i])
            return fmt::format("has parameter {} at {:.9g}, not at {:.9g}", p.name[i], p.value[i], q.value[i]);
    }
    return {};
}

namespace {

std::string bad_derivative(const TransientCube& cube) {
    const auto& p = cube.parameters;
    const auto& d = cube.derivative;
    const std::size_t n = cube.n_parameters();
    if (p.unit.size() != n || p.value.size() != n || p.temporal.size() != n)
        return fmt::format("parameters: {} names, {} units, {} values and {} of temporal", n, p.unit.size(),
                           p.value.size(), p.temporal.size());
    const std::size_t bins = n * cube.radiance.size(), pixels = n * cube.steady.size();
    for (const auto& [name, column, size] :
         {std::tuple{"derivative", &d.bins, bins}, std::tuple{"derivative_var_mean", &d.var_mean, bins},
          std::tuple{"derivative_before", &d.before, pixels}, std::tuple{"derivative_after", &d.after, pixels},
          std::tuple{"derivative_never", &d.never, pixels}, std::tuple{"derivative_steady", &d.steady, pixels},
          std::tuple{"derivative_steady_var_mean", &d.steady_var_mean, pixels}})
        if (column->size() != size)
            return fmt::format("{}: has {} numbers, but {} parameters need {}", name, column->size(), n, size);
    for (std::size_t i = 0; i < n; ++i)
        if (const std::string& t = p.temporal[i]; t != "none" && t != "widened" && t != "exact" && t != "partly")
            return fmt::format("parameters/temporal: row {} is {}, expected none, widened, exact or partly", i, t);
    return {};
}

}  // namespace

std::string TransientCube::problem() const {
    if (film.width == 0 || film.height == 0) return "film/width, film/height: the film has no pixels";
    if (time.n_bins == 0) return "time/n_bins: is 0";
    // In double precision: the product of hostile extents may not fit an integer.
    if (3.0 * film.width * film.height * time.n_bins != double(radiance.size()))
        return fmt::format("radiance: has {} numbers, but film and time/n_bins need {:.17g}", radiance.size(),
                           3.0 * film.width * film.height * time.n_bins);
    if (!(time.bin_width_opl > 0)) return "time/bin_width_opl: is not positive";
    if (time.unit != "opl" && time.unit != "ns") return fmt::format("time/unit: is {}, expected opl or ns", time.unit);
    if (!(time.metres_per_unit > 0)) return "time/metres_per_unit: is not positive";
    return bad_derivative(*this);
}

TransientCubeWriter::TransientCubeWriter(const std::filesystem::path& path, const TransientCubeHeader& header) {
    static_cast<TransientCubeHeader&>(cube_) = header;
    const std::size_t bins = header.row_size() * header.film.height, pixels = 3 * header.n_pixels();
    const std::size_t n = header.n_parameters();
    auto& d = cube_.derivative;
    cube_.radiance = cube_.var_mean = LateColumn<float>(bins);
    cube_.before = cube_.after = cube_.never = cube_.steady = LateColumn<float>(pixels);
    d.bins = d.var_mean = LateColumn<float>(n * bins);
    d.before = d.after = d.never = d.steady = d.steady_var_mean = LateColumn<float>(n * pixels);
    writer_ = std::make_unique<Hdf5Writer>(path, n > 0 ? cube_.format : cube_.format_of_most, header.provenance);
    TransientCubeOf<LateColumn>::fields(cube_, *writer_);
}

TransientCubeWriter::~TransientCubeWriter() = default;

void TransientCubeWriter::write_rows(std::uint32_t first_row, const TransientRows& rows) {
    const std::size_t bins = first_row * cube_.row_size(), pixels = first_row * 3 * std::size_t{cube_.film.width};
    writer_->fill("radiance", bins, rows.radiance);
    writer_->fill("var_mean", bins, rows.var_mean);
    writer_->fill("before", pixels, rows.before);
    writer_->fill("after", pixels, rows.after);
    writer_->fill("never", pixels, rows.never);
    writer_->fill("steady", pixels, rows.steady);
    const std::size_t n = cube_.n_parameters(), height = cube_.film.height;
    const auto fill = [&](std::string_view name, std::size_t first, std::size_t row_size,
                          std::span<const float> values) {
        const std::size_t n_values = values.size() / n;
        for (std::size_t p = 0; p < n; ++p)
            writer_->fill(name, p * height * row_size + first, values.subspan(p * n_values, n_values));
    };
    if (n == 0) return;
    const auto& d = rows.derivative;
    const std::size_t width = 3 * std::size_t{cube_.film.width};
    fill("derivative", bins, cube_.row_size(), d.bins);
    fill("derivative_var_mean", bins, cube_.row_size(), d.var_mean);
    fill("derivative_before", pixels, width, d.before);
    fill("derivative_after", pixels, width, d.after);
    fill("derivative_never", pixels, width, d.never);
    fill("derivative_steady", pixels, width, d.steady);
    fill("derivative_steady_var_mean", pixels, width, d.steady_var_mean);
}

void TransientCubeWriter::commit(Sync sync) {
    writer_->commit(sync);
}

TransientCube read_transient_cube(const std::filesystem::path& path) {
    return read_format<TransientCube>(path);
}

namespace {

/// Reads the numbers of a foreign dataset [y, x, bin, channel] or [y, x, bin]; a single channel is copied to three.
std::vector<float> foreign_numbers(const std::filesystem::path& path, hid_t file, const char* name,
                                   std::vector<std::size_t>& extents) {
    const auto refuse = [&](const std::string& why) { throw InputError(fmt::format("{}: {}", path.native(), why)); };
    if (H5Lexists(file, name, H5P_DEFAULT) <= 0)
        refuse(fmt::format("is no transient_cube, and has no dataset {}", name));
    const Hdf5Handle dataset(H5Dopen2(file, name, H5P_DEFAULT), H5Dclose);
    if (!dataset) refuse(fmt::format("{}: not a dataset, or damaged", name));
    const Hdf5Handle space(H5Dget_space(dataset.get()), H5Sclose);
    extents = extents_of(space.get());
    if (extents.size() == 3) extents.push_back(1);
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
    return filetype_of(path) == TransientCube::format.name;
}

namespace {

/// Reads a cube of another program: two datasets and the attributes.
TransientCube read_foreign_cube(const std::filesystem::path& path, hid_t file, const char* mean, const char* var_mean) {
    TransientCube cube;
    std::vector<std::size_t> extents, of_variance;
    cube.radiance = foreign_numbers(path, file, mean, extents);
    cube.var_mean = foreign_numbers(path, file, var_mean, of_variance);
    if (extents != of_variance)
        throw InputError(fmt::format("{}: {} and {} differ in their extents", path.native(), mean, var_mean));
    cube.film = {std::uint32_t(extents[1]), std::uint32_t(extents[0]),
                 std::uint64_t(foreign_attribute(path, file, "spp"))};
    cube.time.n_bins = std::uint32_t(extents[2]);
    cube.time.start_opl = foreign_attribute(path, file, "start_opl");
    cube.time.bin_width_opl = cube.time.gate_opl = foreign_attribute(path, file, "bin_width_opl");
    cube.response.pulse.clear();
    if (const std::string problem = cube.problem(); !problem.empty())
        throw InputError(fmt::format("{}: {}", path.native(), problem));
    return cube;
}

}  // namespace

TransientCube read_any_cube(const std::filesystem::path& path) {
    const Hdf5Handle file = open_hdf5(path);
    if (text_attribute(file.get(), "filetype")) return read_transient_cube(path);
    return read_foreign_cube(path, file.get(), "mean", "var_mean");
}

TransientCube read_any_derivative(const std::filesystem::path& path, const std::string& parameter) {
    {
        const Hdf5Handle file = open_hdf5(path);
        if (!text_attribute(file.get(), "filetype")) {
            if (const auto by = text_attribute(file.get(), "parameter"); by && *by != std::vector{parameter})
                throw InputError(fmt::format("{}: is a derivative by {}, not by {}", path.native(),
                                             fmt::join(*by, ", "), parameter));
            return read_foreign_cube(path, file.get(), "derivative", "derivative_var_mean");
        }
    }
    TransientCube cube = read_transient_cube(path);
    const auto& names = cube.parameters.name;
    const std::size_t row = std::size_t(std::find(names.begin(), names.end(), parameter) - names.begin());
    if (row == names.size())
        throw InputError(names.empty() ? fmt::format("{}: has no derivatives; make it with loom-transient --derivative",
                                                     path.native())
                                       : fmt::format("{}: has no derivative by {}, only by {}", path.native(),
                                                     parameter, fmt::join(names, ", ")));
    // Copies, because short columns do not borrow the mapped file.
    const auto of_parameter = [row](const Column<float>& all, const Column<float>& one) {
        return Column<float>(std::vector<float>(all.begin() + row * one.size(), all.begin() + (row + 1) * one.size()));
    };
    auto& d = cube.derivative;
    cube.var_mean = of_parameter(d.var_mean, cube.radiance);
    cube.radiance = of_parameter(d.bins, cube.radiance);
    cube.before = of_parameter(d.before, cube.steady);
    cube.after = of_parameter(d.after, cube.steady);
    cube.never = of_parameter(d.never, cube.steady);
    cube.steady = of_parameter(d.steady, cube.steady);
    cube.derivative = {};
    cube.parameters = {};
    return cube;
}

}  // namespace loom
