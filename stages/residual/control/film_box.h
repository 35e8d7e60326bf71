#pragma once
// Rectangle of the film in which the camera may see something.

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <optional>

#include "stages/core/edit/edit_reach.h"
#include "stages/core/math/box.h"
#include "stages/core/scene/sensor.h"

namespace loom::residual {

/// Pixels [lo, hi) of the film that may show something.
struct FilmBox {
    std::array<float, 2> lo{INFINITY, INFINITY}, hi{-INFINITY, -INFINITY};

    void add(const Sensor& sensor, const Box3f& box) {
        for (int corner = 0; corner < 8; ++corner) {
            const Point3f p{corner & 1 ? box.hi.x : box.lo.x, corner & 2 ? box.hi.y : box.lo.y,
                            corner & 4 ? box.hi.z : box.lo.z};
            const std::optional<FilmPoint> at = sensor.project(p);
            if (!at) {  // beside or behind the camera
                lo = {0, 0}, hi = {float(sensor.width), float(sensor.height)};
                return;
            }
            for (std::size_t k = 0; k < 2; ++k) {
                const float x = k == 0 ? at->film.x : at->film.y;
                lo[k] = std::min(lo[k], x), hi[k] = std::max(hi[k], x);
            }
        }
    }
    /// Grows to what filters reach, and ends at the borders of the film.
    void finish(const Sensor& sensor) {
        const float reach = sensor.filter_radius + 1;
        lo = {std::max(std::floor(lo[0] - reach), 0.0f), std::max(std::floor(lo[1] - reach), 0.0f)};
        hi = {std::min(std::ceil(hi[0] + reach), float(sensor.width)),
              std::min(std::ceil(hi[1] + reach), float(sensor.height))};
    }
    void intersect(const FilmBox& other) {
        for (std::size_t k = 0; k < 2; ++k) lo[k] = std::max(lo[k], other.lo[k]), hi[k] = std::min(hi[k], other.hi[k]);
    }
    bool empty() const { return !(lo[0] < hi[0] && lo[1] < hi[1]); }
    // After finish(), unless empty:
    std::uint32_t left() const { return std::uint32_t(lo[0]); }
    std::uint32_t top() const { return std::uint32_t(lo[1]); }
    std::uint32_t width() const { return std::uint32_t(hi[0] - lo[0]); }
    std::uint32_t height() const { return std::uint32_t(hi[1] - lo[1]); }
};

/// Where the camera may see shapes that moved, were removed or added.
inline FilmBox film_of_changes(const Sensor& sensor, const EditReach& reach) {
    FilmBox film;
    for (const Obstacles* places : {&reach.old_places, &reach.new_places})
        for (const Box3f& box : places->boxes()) film.add(sensor, box);
    film.finish(sensor);
    return film;
}

}  // namespace loom::residual
