#pragma once
// Matches the objects of two scene descriptions: which shape and which emitter of the one is which of the other.
// Everything is compared after parsing, so that formatting, order of attributes, includes and -D do not matter, and
// files are compared by their content.

#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "stages/core/description/description.h"

namespace loom {

using Objects = std::vector<ObjectPtr>;

/// Objects as texts that are equal when the objects mean the same. Each file is read once.
class CanonicalTexts {
  public:
    /// Text of an object and all below it, without its id.
    const std::string& text(const Object& object);
    std::string text(const ObjectPtr& object) { return object ? text(*object) : std::string("none"); }
    /// Text of a shape apart from its placement, BSDF and emitter.
    std::string form(const Object& shape);
    std::string value(const Object& object, const Property& property);
    /// Whether a property has an effect here.
    bool counts(const Object& object, const Property& property) const;

  private:
    const std::string& file(const std::string& path);

    std::map<const Object*, std::string> texts_;
    std::map<std::string, std::string> files_;
};

/// The rotation and translation that lead from one placement to the other; nothing if it takes more than these, to 1e-5
/// of the size.
std::optional<Matrix4d> rigid_motion(const Matrix4d& from, const Matrix4d& to);
Matrix4d inverse_of_rigid(const Matrix4d& motion);

/// Whether two placements are equal, to 1e-7 of their distance from the origin (matrices written with few digits).
bool same_placement(const Matrix4d& a, const Matrix4d& b);

/// World from unit shape: to_world, and the centre and radius of a sphere.
Matrix4d placement(const Object& shape);

bool is_sky(const Object& emitter);

/// Partners by index, one to one.
struct SceneMatch {
    static constexpr std::uint32_t none = ~0u;
    std::vector<std::uint32_t> new_of_old, old_of_new;  // none: no partner
};

/// Matches shapes by `id`; those whose id is missing or unknown to the other scene in order of the description: first
/// the ones that are equal in all, then those of the same form and BSDF elsewhere, then those of the same form in the
/// same place with another BSDF, then those of the same form. Two ids that differ match only if all else is equal.
/// "Elsewhere" is a rigid motion away.
SceneMatch match_shapes(const Objects& old_shapes, const Objects& new_shapes, CanonicalTexts& texts);

/// Matches emitters that are no part of a shape: a sky with the sky, then by `id`, then equal ones, then by plugin.
SceneMatch match_emitters(const Objects& old_emitters, const Objects& new_emitters, CanonicalTexts& texts);

}  // namespace loom
