#pragma once
#include <algorithm>
#include <array>
#include <cstdint>
#include <span>

#include "formats/path_graph.h"  // no_medium
#include "stages/core/math/vector.h"
#include "stages/core/scattering/bsdf_model.h"

namespace loom {

struct Scene;

/// Light goes on in another index of refraction when it passes such a surface.
inline bool is_interface(const BsdfModel& model) {
    return model.kind == BsdfKind::dielectric || model.kind == BsdfKind::rough_dielectric;
}

/// Shape and material of a surface, rows of Scene::shapes and Scene::materials.
struct SurfaceIdx {
    std::uint32_t shape = 0, material = 0;
};

/// Medium of a path segment.
struct Medium {
    static constexpr std::uint16_t outside = no_medium;
    float ior = 1;                         // absolute index of refraction
    std::uint16_t material_idx = outside;  // dielectric whose inside it is; outside: outside of all objects
    bool operator==(const Medium&) const = default;
};

/// Dielectric objects that a path is inside of, innermost last. Gives the medium of the next segment, correct for nested
/// and immersed objects. Leaving an object removes its own entry, wherever it lies, so that overlapping surfaces do no
/// harm.
class MediumStack {
  public:
    struct Entry {
        std::uint32_t shape_idx;
        Medium medium;
        bool operator==(const Entry&) const = default;
    };

    /// Medium of the next segment; outside of everything it has the index of the last surface's outside.
    Medium medium() const { return size_ > 0 ? entries_[size_ - 1].medium : Medium{outside_}; }
    /// Innermost last.
    std::span<const Entry> entries() const { return {entries_.data(), std::size_t(size_)}; }
    bool operator==(const MediumStack& other) const {
        return outside_ == other.outside_ &&
               std::equal(entries().begin(), entries().end(), other.entries().begin(), other.entries().end());
    }

    /// Starts outside of everything, in a medium of this index.
    void start_outside(float ior) { outside_ = ior; }
    /// Follows light through a surface; changes the stack only at an interface.
    /// out: as cross()
    bool pass(SurfaceIdx surface, bool entering, const BsdfModel& model) {
        return !is_interface(model) || cross(surface, entering, model.int_ior, model.ext_ior);
    }
    /// out: false when an object is left that was never entered
    bool cross(SurfaceIdx surface, bool entering, float int_ior, float ext_ior) {
        if (entering) {
            if (size_ == 0) outside_ = ext_ior;
            if (size_ < max_nesting) entries_[size_++] = {surface.shape, {int_ior, std::uint16_t(surface.material)}};
            return true;
        }
        int i = find([&](const Entry& e) { return e.shape_idx == surface.shape; });
        // An object may be made of several shapes: entered by one, left by another.
        if (i < 0) i = find([&](const Entry& e) { return e.medium.ior == int_ior; });
        for (int k = i; k >= 0 && k + 1 < size_; ++k) entries_[k] = entries_[k + 1];
        if (i >= 0) --size_;
        if (size_ == 0) outside_ = ext_ior;
        return i >= 0;
    }

  private:
    /// Innermost entry that meets a condition; -1: none.
    template <class Condition>
    int find(Condition condition) const {
        int i = size_ - 1;
        while (i >= 0 && !condition(entries_[i])) --i;
        return i;
    }

    static constexpr int max_nesting = 16;
    int size_ = 0;
    float outside_ = 1.0f;
    std::array<Entry, max_nesting> entries_;
};

/// Media around a point, by rays in all directions from there that pass straight through what lets light through and
/// stop at the rest. The point is inside of an object that more rays leave first than enter first; a point behind an open
/// surface, such as the plane of a pool, is inside. Outside of everything the point is in the outer medium of the object
/// that most rays enter first. A medium that no ray reaches, behind opaque walls, does not count.
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
