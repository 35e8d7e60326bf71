#pragma once
// Matches shapes and emitters of two scene descriptions. Descriptions are compared after parsing, so that formatting,
// order of attributes, includes and -D do not matter. Files are compared by their content.

#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "stages/core/description/description.h"

namespace loom {

using Objects = std::vector<ObjectPtr>;

/// Canonical texts of objects: equal exactly when the objects are equivalent. Each file is read once.
class CanonicalTexts {
  public:
    /// Returns the text of an object and all objects below it, without its id.
    const std::string& text(const Object& object);
    std::string text(const ObjectPtr& object) { return object ? text(*object) : std::string("none"); }
    /// Returns the text of a shape without its placement, BSDF and emitter.
    std::string form(const Object& shape);
    std::string value(const Object& object, const Property& property);
    /// Whether a property has an effect on this object.
    bool counts(const Object& object, const Property& property) const;

  private:
    const std::string& file(const std::string& path);

    std::map<const Object*, std::string> texts_;
    std::map<std::string, std::string> files_;
};

/// Returns the rotation and translation that map one placement to the other; nothing if the map is not rigid, to 1e-5
/// of the size.
std::optional<Matrix4d> rigid_motion(const Matrix4d& from, const Matrix4d& to);
Matrix4d inverse_of_rigid(const Matrix4d& motion);

/// Whether two placements are equal, to 1e-7 of their distance from the origin (for matrices written with few digits).
bool same_placement(const Matrix4d& a, const Matrix4d& b);

/// Maps the unit shape to world space: to_world, combined with the centre and radius of a sphere.
Matrix4d placement(const Object& shape);

bool is_sky(const Object& emitter);

/// Partners by index, one to one.
struct SceneMatch {
    static constexpr std::uint32_t none = ~0u;
    std::vector<std::uint32_t> new_of_old, old_of_new;  // [index]; none: no partner
};

/// Matches shapes by `id`. Shapes without an id, or with an id that the other scene lacks, are matched in the order of
/// the description: first those equal in all, then of equal form and BSDF but moved rigidly, then of equal form and
/// placement with another BSDF, then of equal form. Shapes of two different ids match only if all else is equal.
SceneMatch match_shapes(const Objects& old_shapes, const Objects& new_shapes, CanonicalTexts& texts);

/// Matches emitters that belong to no shape: a sky with the sky, then by `id`, then equal ones, then by plugin.
SceneMatch match_emitters(const Objects& old_emitters, const Objects& new_emitters, CanonicalTexts& texts);

}  // namespace loom
