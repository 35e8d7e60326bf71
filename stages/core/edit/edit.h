#pragma once
// The edit between two scenes: found from what they say, not declared. Everything is compared after parsing, so that
// formatting, order of attributes, includes and -D do not matter, and files by their content.

#include <cstdint>
#include <string>
#include <vector>

#include "stages/core/description/description.h"

namespace loom {

/// What an edit does to a shape, a bit each. A shape that is removed lies in the old scene only, an added one in the
/// new scene only; the others are in both, at indices that may differ.
namespace shape_change {
inline constexpr unsigned moved = 1;      // rigidly: turned and shifted
inline constexpr unsigned repainted = 2;  // its BSDF, or a texture of it
inline constexpr unsigned relit = 4;      // what it emits
inline constexpr unsigned removed = 8;
inline constexpr unsigned added = 16;
}  // namespace shape_change

/// Where light meets the edit, in the words of [RP] §3.3: a path vertex on a shape whose place changed is dynamic; a
/// path segment that crosses where such a shape is in the other scene has a ghost vertex there.
struct ShapeEdit {
    static constexpr std::uint32_t none = ~0u;
    unsigned changes = 0;          // bits of shape_change::
    std::uint32_t partner = none;  // index of the same shape in the other scene
    Matrix4d to_partner;           // rigid map of its points onto those of the partner; identity unless moved

    /// A vertex on it is dynamic in its own scene, and its place a ghost in the other.
    bool dynamic() const {
        return (changes & (shape_change::moved | shape_change::removed | shape_change::added)) != 0;
    }
    /// A vertex on it scatters or emits otherwise in the other scene, at the same place.
    bool dyed() const { return (changes & (shape_change::repainted | shape_change::relit)) != 0; }
};

/// The same of Scene::emitters.
struct EmitterEdit {
    static constexpr std::uint32_t none = ~0u;
    bool changed = false;  // shines otherwise, or from elsewhere; always true without a partner
    std::uint32_t partner = none;
};

struct Edit {
    /// By index of Scene::shapes and Scene::emitters of build_scene() from the same descriptions.
    std::vector<ShapeEdit> old_shapes, new_shapes;
    std::vector<EmitterEdit> old_emitters, new_emitters;
    std::vector<std::string> changes;  // in words, one each
    std::vector<std::string> notes;    // what differs without effect on the mean picture

    bool nothing() const { return changes.empty(); }
    /// Shapes that are dynamic in the new scene, and those that are in the old one: the ghosts of the new.
    std::size_t n_dynamic() const;
    std::size_t n_ghosts() const;
    std::size_t n_dyed() const;       // shapes of the new scene that look or shine otherwise, where they were
    std::size_t n_repainted() const;  // those of them that scatter otherwise
    std::size_t n_emitters() const;   // changed ones, of the scene that has more of them
};

/// Finds what an edit has done. Shapes and emitters are matched by match_shapes() and match_emitters(); an area light
/// goes with its shape. A matched shape of the same form is moved if a rotation and a translation lead from the one
/// placement to the other; a shape that is scaled, mirrored or of another form is removed and added.
/// differs: a parameter that is given and one that is left to the same default count as different; the residual of
///          such an edit is 0 all the same
/// throws:  InputError with both places where camera, film, filter or depth differ, for then no pixel is the other's
Edit find_edit(const SceneDescription& old_scene, const SceneDescription& new_scene);

/// A rigid motion in words: "by (1, 0, 0)", "turned by 30 degrees about (0, 1, 0) through its centre".
/// in:      centre        a point that the shape calls its own
///          has_centre    whether that is the centre of the shape
std::string motion_words(const Matrix4d& motion, const Point3<double>& centre, bool has_centre);

}  // namespace loom
