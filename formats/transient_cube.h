#pragma once
// transient_cube: an image whose pixels are histograms over optical path length.

#include <cstdint>
#include <filesystem>
#include <memory>
#include <span>
#include <string>

#include "formats/io/documenter.h"
#include "formats/io/field.h"
#include "formats/io/mapped_file.h"
#include "formats/io/output_file.h"
#include "formats/io/provenance.h"

namespace loom {

class Hdf5Writer;

/// Unit: m/ns.
inline constexpr double speed_of_light = 0.299792458;

/// Header of a cube. Lengths are optical path lengths in scene units of metres_per_unit each.
struct TransientCubeHeader {
    struct Film {
        std::uint32_t width = 0, height = 0;
        std::uint64_t samples_per_pixel = 0;
    } film;

    struct Time {
        std::uint32_t n_bins = 0;
        double start_opl = 0, bin_width_opl = 0, gate_opl = 0;
        std::string unit = "opl";  // or "ns": unit of the labels
        double metres_per_unit = 1;
        std::uint8_t camera_segment = 1;
    } time;

    struct Response {
        std::string pulse = "delta";  // empty: not stored, in a file of another program
        double length_opl = 0, tail_opl = 0, period_opl = 0;
    } response;

    /// Parameters of the derivatives; empty columns for a cube without derivatives.
    struct Parameters {
        std::vector<std::string> name, unit, temporal;
        CopiedColumn<double> value;
    } parameters;

    Provenance provenance;

    std::size_t n_parameters() const { return parameters.name.size(); }
    std::size_t n_pixels() const { return std::size_t{film.width} * film.height; }
    std::size_t row_size() const { return std::size_t{film.width} * time.n_bins * 3; }  // numbers of one row y
    /// Converts an optical path length into the unit of the labels: length or time, by `unit`.
    double in_unit(double opl) const { return time.unit == "ns" ? opl * time.metres_per_unit / speed_of_light : opl; }
};

/// Describes why the bins of `a` and `b` differ in meaning; empty when they agree. Labels (unit, length of a unit) may
/// differ. A response that one cube does not store (empty pulse) is not compared.
/// in:      slack  allowed offset between their windows, as a share of a bin
std::string difference_in_words(const TransientCubeHeader& a, const TransientCubeHeader& b, double slack = 0);

/// Describes why the parameters of `a` differ from those of `b`: number, names, units or values; empty when they agree.
std::string parameter_difference_in_words(const TransientCubeHeader& a, const TransientCubeHeader& b);

template <template <class> class ColumnOf>
struct TransientCubeOf : TransientCubeHeader {
    static constexpr FormatId format{"transient_cube", 1, 1};
    /// Version of a cube without derivatives, so that older readers accept it.
    static constexpr FormatId format_of_most{"transient_cube", 1, 0};

    ColumnOf<float> radiance, var_mean;            // [y, x, bin, channel]
    ColumnOf<float> before, after, never, steady;  // [y, x, channel]

    struct Derivative {
        ColumnOf<float> bins, var_mean;                                 // [parameter, y, x, bin, channel]
        ColumnOf<float> before, after, never, steady, steady_var_mean;  // [parameter, y, x, channel]
    } derivative;

    template <class Self, class Visitor>
    static void fields(Self& c, Visitor& v);
};

struct TransientCube : TransientCubeOf<Column> {
    std::shared_ptr<const MappedFile> storage;

    /// The invariants that go beyond types, lengths and finite floats; empty when all hold.
    std::string problem() const;
};

/// Rows y of a cube; each array has `row_size()` or 3 width numbers per row.
struct TransientRows {
    std::span<const float> radiance, var_mean, before, after, never, steady;
    /// The same rows of all parameters, [parameter, row, …]; empty without derivatives.
    struct Derivative {
        std::span<const float> bins, var_mean, before, after, never, steady, steady_var_mean;
    } derivative{};
};

/// Writes a cube row by row, in any order, without holding it in memory.
class TransientCubeWriter {
  public:
    TransientCubeWriter(const std::filesystem::path& path, const TransientCubeHeader& header);
    ~TransientCubeWriter();
    /// needs:   one caller at a time
    void write_rows(std::uint32_t first_row, const TransientRows& rows);
    /// Syncs the file and renames it to its final name, after all rows are written. Without commit() no file remains.
    void commit(Sync sync = Sync::yes);

  private:
    TransientCubeOf<LateColumn> cube_;
    std::unique_ptr<Hdf5Writer> writer_;
};

/// Reads, maps and checks the whole file.
/// throws:  InputError naming the file and the dataset
TransientCube read_transient_cube(const std::filesystem::path& path);

/// Reads any HDF5 file with float datasets `mean` and `var_mean` [y, x, bin, channel] and numeric attributes
/// `start_opl`, `bin_width_opl`, `spp`. A single channel, or none, is copied to all three. Before, after, never, steady and the
/// pulse stay empty.
TransientCube read_any_cube(const std::filesystem::path& path);
/// Reads the derivative by one parameter in place of the radiance, with its variance and its shares outside of the bins.
/// Another program's file has it in float datasets `derivative` and `derivative_var_mean` [y, x, bin, channel]; its text
/// attribute `parameter`, if any, must agree.
/// throws:  InputError that lists the parameters of the cube when it lacks this one
TransientCube read_any_derivative(const std::filesystem::path& path, const std::string& parameter);
/// Whether a file is a transient_cube by its attributes; false for a file that is not HDF5.
bool is_transient_cube(const std::filesystem::path& path);

template <template <class> class ColumnOf>
template <class Self, class Visitor>
void TransientCubeOf<ColumnOf>::fields(Self& c, Visitor& v) {
    v.value("film/width", c.film.width, "", "px", "image width");
    v.value("film/height", c.film.height, "", "px", "image height");
    v.value("film/samples_per_pixel", c.film.samples_per_pixel, "", "1", "paths per pixel");

    auto& t = c.time;
    v.value("time/n_bins", t.n_bins, "", "1", "number of bins");
    v.value("time/start_opl", t.start_opl, "", "m",
            "optical path length at which bin 0 opens; bin k opens k bin_width_opl later");
    v.value("time/bin_width_opl", t.bin_width_opl, "", "m", "distance between the starts of neighbouring bins");
    v.value("time/gate_opl", t.gate_opl, "", "m", "length for which a bin is open");
    v.value("time/unit", t.unit, "", "1", "opl or ns: unit of the labels of this cube");
    v.value("time/metres_per_unit", t.metres_per_unit, "", "m",
            "length of a unit of the scene: an optical path length l takes l metres_per_unit / 0.299792458 ns");
    v.value("time/camera_segment", t.camera_segment, "", "1",
            "1: lengths count from the camera, 0: from the first hit, and in an NLOS capture up to the laser spot");

    auto& r = c.response;
    v.value("response/pulse", r.pulse, "", "1", "delta, box, gaussian, expgauss, table, or modulated: sine, square");
    v.value("response/length_opl", r.length_opl, "", "m",
            "length of a box pulse, standard deviation of a Gaussian one; 0 for others");
    v.value("response/tail_opl", r.tail_opl, "", "m", "mean of the exponential part of expgauss; 0 for others");
    v.value("response/period_opl", r.period_opl, "", "m", "period of a modulation; 0 for pulses");

    const std::size_t width = c.film.width, bins = c.time.n_bins;
    constexpr std::string_view unit = "W m^-2 sr^-1";
    v.grid("radiance", c.radiance, {width, bins, 3}, "y,x,bin,channel", unit,
           "mean radiance in each bin, not divided by its width; row 0 on top, channels R G B", Finite::counted);
    v.grid("var_mean", c.var_mean, {width, bins, 3}, "y,x,bin,channel", "(W m^-2 sr^-1)^2", "variance of that mean",
           Finite::counted);
    v.grid("before", c.before, {width, 3}, "y,x,channel", unit, "radiance that arrives before bin 0 opens",
           Finite::counted);
    v.grid("after", c.after, {width, 3}, "y,x,channel", unit, "radiance that arrives after the last bin",
           Finite::counted);
    v.grid("never", c.never, {width, 3}, "y,x,channel", unit,
           "radiance of emitters at infinity, which has no arrival time", Finite::counted);
    v.grid("steady", c.steady, {width, 3}, "y,x,channel", unit,
           "radiance at all times: with gates that tile the time, sum of the bins + before + after + never",
           Finite::counted);

    auto& p = c.parameters;
    v.optional_names("parameters/name", p.name, "parameter", "parameter of the derivatives, as in loom-derive --wrt");
    v.optional_names("parameters/unit", p.unit, "parameter", "unit of the parameter");
    v.optional("parameters/value", p.value, 1, "parameter", "parameters/unit",
               "value at which the derivatives hold; 0 for motions, which start from the scene as it is");
    v.optional_names("parameters/temporal", p.temporal, "parameter",
                     "light that moves between bins as its arrival time changes: none (complete: the response is "
                     "smooth, or no arrival time changes), widened (its mean over the length that the plan names; of a "
                     "delta pulse as for a "
                     "box pulse one bin long, centred), exact (delta pulse: sampled at the borders of bins), partly "
                     "(exact for a part of the light, "
                     "widened for the rest)");

    auto& d = c.derivative;
    const std::size_t height = c.film.height;
    constexpr std::string_view per = "W m^-2 sr^-1 per parameters/unit";
    constexpr std::string_view squared = "(W m^-2 sr^-1 per parameters/unit)^2";
    v.optional_grid("derivative", d.bins, {height, width, bins, 3}, "parameter,y,x,bin,channel", per,
                    "derivative of radiance", Finite::counted);
    v.optional_grid("derivative_var_mean", d.var_mean, {height, width, bins, 3}, "parameter,y,x,bin,channel", squared,
                    "variance of that derivative", Finite::counted);
    v.optional_grid("derivative_before", d.before, {height, width, 3}, "parameter,y,x,channel", per,
                    "derivative of before", Finite::counted);
    v.optional_grid("derivative_after", d.after, {height, width, 3}, "parameter,y,x,channel", per,
                    "derivative of after", Finite::counted);
    v.optional_grid("derivative_never", d.never, {height, width, 3}, "parameter,y,x,channel", per,
                    "derivative of never", Finite::counted);
    v.optional_grid("derivative_steady", d.steady, {height, width, 3}, "parameter,y,x,channel", per,
                    "derivative of steady: with gates that tile the time, sum of the bins + before + after + never",
                    Finite::counted);
    v.optional_grid("derivative_steady_var_mean", d.steady_var_mean, {height, width, 3}, "parameter,y,x,channel",
                    squared, "variance of derivative_steady; the bins of a path are correlated", Finite::counted);
}

}  // namespace loom
