#pragma once
#include <algorithm>
#include <array>
#include <cstdint>
#include <span>

#include "stages/core/math/vector.h"
#include "stages/core/scattering/bsdf_model.h"

namespace loom {

struct Scene;

/// Light goes on in another index of refraction when it passes such a surface.
inline bool is_interface(const BsdfModel& model) {
    return model.kind == BsdfKind::dielectric || model.kind == BsdfKind::rough_dielectric;
}

/// The dielectric objects that a path is inside of, innermost last; gives the absolute index of refraction
/// of the segment that comes next, right for nested and immersed objects. Leaving an object removes its own
/// entry, wherever it lies, so that overlapping surfaces do no harm.
class MediumStack {
  public:
    struct Entry {
        std::uint32_t shape;
        float ior;
        bool operator==(const Entry&) const = default;
    };

    /// Index of the medium around; outside of everything that of the last surface's outside.
    float index() const { return size_ > 0 ? entries_[size_ - 1].ior : outside_; }
    /// Innermost last.
    std::span<const Entry> entries() const { return {entries_.data(), std::size_t(size_)}; }
    bool operator==(const MediumStack& other) const {
        return outside_ == other.outside_ &&
               std::equal(entries().begin(), entries().end(), other.entries().begin(), other.entries().end());
    }

    /// Starts outside of everything, in a medium of this index.
    void start_outside(float ior) { outside_ = ior; }
    /// Follows light through the surface of a shape; changes the stack only at an interface.
    /// out: as cross()
    bool pass(std::uint32_t shape, bool entering, const BsdfModel& model) {
        return !is_interface(model) || cross(shape, entering, model.int_ior, model.ext_ior);
    }
    /// out: false when an object is left that was never entered
    bool cross(std::uint32_t shape, bool entering, float int_ior, float ext_ior) {
        if (entering) {
            if (size_ == 0) outside_ = ext_ior;
            if (size_ < max_nesting) entries_[size_++] = {shape, int_ior};
            return true;
        }
        int i = find([&](const Entry& e) { return e.shape == shape; });
        // An object may be made of several shapes: in by the one, out by the other.
        if (i < 0) i = find([&](const Entry& e) { return e.ior == int_ior; });
        for (int k = i; k >= 0 && k + 1 < size_; ++k) entries_[k] = entries_[k + 1];
        if (i >= 0) --size_;
        if (size_ == 0) outside_ = ext_ior;
        return i >= 0;
    }

  private:
    /// Innermost entry that is meant; -1: none.
    template <class Meant>
    int find(Meant meant) const {
        int i = size_ - 1;
        while (i >= 0 && !meant(entries_[i])) --i;
        return i;
    }

    static constexpr int max_nesting = 16;
    int size_ = 0;
    float outside_ = 1.0f;
    std::array<Entry, max_nesting> entries_;
};

/// Media around a point, by what is seen from there: rays in all directions pass straight through whatever lets light
/// through, and stop at the rest. The point is inside of an object where more of them leave it first than enter it
/// first; so an open surface, such as the plane of a pool, has the point inside that sees its back. Outside of
/// everything it is in the outer medium of what most rays enter first. A medium of which nothing is seen, behind opaque
/// walls, does not count.
MediumStack media_at(const Scene& scene, const Point3f& p);

/// Media in which camera paths start.
struct SensorMedia {
    MediumStack everywhere;
    bool vacuum = true;   // everywhere
    bool varies = false;  // from origin to origin, of an orthographic sensor

    MediumStack at(const Scene& scene, const Point3f& origin) const {
        return varies ? media_at(scene, origin) : everywhere;
    }
};
SensorMedia find_sensor_media(const Scene& scene);

}  // namespace loom
