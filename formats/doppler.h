#pragma once
// doppler: how fast the optical paths of each pixel grow, and what a chirped (FMCW) sensor measures of that.
//
// A path that grows by d(opl)/dt shifts its light by -d(opl)/dt / wavelength. Velocities here are half that rate: a
// sensor beside its emitter sees a target that recedes at this velocity. Positive recedes, also in the beat.

#include <cstdint>
#include <filesystem>
#include <memory>
#include <string>

#include "formats/io/documenter.h"
#include "formats/io/field.h"
#include "formats/io/mapped_file.h"
#include "formats/io/output_file.h"
#include "formats/io/provenance.h"

namespace loom {

/// Largest number of bins of a spectrum.
inline constexpr std::uint32_t max_doppler_bins = 4096;

struct DopplerHeader {
    struct Film {
        std::uint32_t width = 0, height = 0;
        std::uint64_t samples_per_pixel = 0;
    } film;

    double wavelength = 0;  // m
    double chirp = 0;       // Hz/s; 0: no beat

    struct Bins {
        std::uint32_t n = 0;
        double start = 0, width = 0;
    } velocity_bins, beat_bins;  // m/s, Hz; bin k is [start + k width, start + (k + 1) width)

    Provenance provenance;

    std::size_t n_pixels() const { return std::size_t{film.width} * film.height; }
};

template <template <class> class ColumnOf>
struct DopplerOf : DopplerHeader {
    static constexpr FormatId format{"doppler", 1, 0};

    ColumnOf<float> light, velocity, velocity_var_mean;  // [y, x]
    ColumnOf<float> spectrum;                            // [y, x, bin]
    ColumnOf<float> beat, beat_after, never;             // [y, x, bin], [y, x], [y, x]; empty without a chirp

    template <class Self, class Visitor>
    static void fields(Self& d, Visitor& v);
};

struct Doppler : DopplerOf<Column> {
    std::shared_ptr<const MappedFile> storage;

    /// Returns the first violated invariant beyond types, lengths and finite floats; empty: none.
    std::string problem() const;
};

void write_doppler(const Doppler& doppler, const std::filesystem::path& path, Sync sync = Sync::yes);
/// Reads, maps and checks the whole file.
/// throws:  InputError naming the file and the dataset
Doppler read_doppler(const std::filesystem::path& path);
/// Whether a file is a doppler by its attributes; false for a file that is not HDF5.
bool is_doppler(const std::filesystem::path& path);

template <template <class> class ColumnOf>
template <class Self, class Visitor>
void DopplerOf<ColumnOf>::fields(Self& d, Visitor& v) {
    v.value("film/width", d.film.width, "", "px", "image width");
    v.value("film/height", d.film.height, "", "px", "image height");
    v.value("film/samples_per_pixel", d.film.samples_per_pixel, "", "1", "paths per pixel");
    v.value("sensor/wavelength", d.wavelength, "", "m", "wavelength of the light");
    v.value("sensor/chirp", d.chirp, "", "Hz s^-1", "rate at which the frequency of the light rises; 0: no beat");
    const auto bins = [&](auto& b, std::string_view n, std::string_view start, std::string_view width,
                          std::string_view unit) {
        v.value(n, b.n, "", "1", "number of bins");
        v.value(start, b.start, "", unit, "start of bin 0");
        v.value(width, b.width, "", unit, "width of a bin");
    };
    bins(d.velocity_bins, "velocity_bins/n", "velocity_bins/start", "velocity_bins/width", "m s^-1");
    bins(d.beat_bins, "beat_bins/n", "beat_bins/start", "beat_bins/width", "Hz");

    const std::size_t w = d.film.width;
    constexpr std::string_view unit = "W m^-2 sr^-1";
    v.grid("light", d.light, {w}, "y,x", unit, "mean luminance of all paths that hit a surface; row 0 on top",
           Finite::counted);
    v.grid("velocity", d.velocity, {w}, "y,x", "m s^-1",
           "mean of half the rate at which optical paths grow, weighted by their luminance; positive recedes; the "
           "Doppler shift is -2 velocity / wavelength; 0 where light is 0",
           Finite::counted);
    v.grid("velocity_var_mean", d.velocity_var_mean, {w}, "y,x", "(m s^-1)^2", "variance of that mean",
           Finite::counted);
    v.grid("spectrum", d.spectrum, {w, d.velocity_bins.n}, "y,x,bin", unit,
           "mean luminance in each bin of velocity; the bins of a pixel sum to light", Finite::counted);
    v.optional_grid("beat", d.beat, {w, d.beat_bins.n}, "y,x,frequency", unit,
                    "mean luminance in each bin of the beat frequency chirp opl / c + 2 velocity / wavelength",
                    Finite::counted);
    v.optional_grid("beat_after", d.beat_after, {w}, "y,x", unit, "luminance whose beat is above the last bin",
                    Finite::counted);
    v.optional_grid("never", d.never, {w}, "y,x", unit, "luminance of emitters at infinity, which has no beat",
                    Finite::counted);
}

}  // namespace loom
