#include "formats/doppler.h"

#include <fmt/format.h>

#include <cmath>
#include <tuple>

#include "formats/io/error.h"
#include "formats/io/hdf5_format.h"
#include "formats/io/hdf5_handle.h"

namespace loom {

std::string Doppler::problem() const {
    if (film.width == 0 || film.height == 0) return "film/width, film/height: the film has no pixels";
    if (!(wavelength > 0)) return "sensor/wavelength: is not positive";
    const bool has_beat = beat_bins.n > 0;
    if (has_beat != (chirp != 0)) return "beat_bins/n, sensor/chirp: only one of them is 0";
    for (const auto& [name, bins, wanted] :
         {std::tuple{"velocity_bins", &velocity_bins, true}, std::tuple{"beat_bins", &beat_bins, has_beat}}) {
        if (!wanted) continue;
        if (bins->n == 0 || bins->n > max_doppler_bins)
            return fmt::format("{}/n: is {}, expected 1 to {}", name, bins->n, max_doppler_bins);
        if (!std::isfinite(bins->start) || !(bins->width > 0) || !std::isfinite(bins->width))
            return fmt::format("{}/start, width: not finite, or the width is not positive", name);
    }
    // In double precision: the product of hostile extents may not fit an integer.
    const double pixels = double(film.width) * film.height;
    for (const auto& [name, column, size] :
         {std::tuple{"light", &light, pixels}, std::tuple{"velocity", &velocity, pixels},
          std::tuple{"velocity_var_mean", &velocity_var_mean, pixels},
          std::tuple{"spectrum", &spectrum, pixels * velocity_bins.n}, std::tuple{"beat", &beat, pixels * beat_bins.n},
          std::tuple{"beat_after", &beat_after, has_beat ? pixels : 0},
          std::tuple{"never", &never, has_beat ? pixels : 0}})
        if (double(column->size()) != size)
            return fmt::format("{}: has {} numbers, but film and bins need {:.17g}", name, column->size(), size);
    return {};
}

void write_doppler(const Doppler& doppler, const std::filesystem::path& path, Sync sync) {
    write_format(doppler, path, sync);
}

Doppler read_doppler(const std::filesystem::path& path) {
    return read_format<Doppler>(path);
}

bool is_doppler(const std::filesystem::path& path) {
    return filetype_of(path) == Doppler::format.name;
}

}  // namespace loom
