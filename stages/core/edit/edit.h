#pragma once
// The edit between two scenes, found by comparing their descriptions, not declared. Descriptions are compared after
// parsing, so that formatting, order of attributes, includes and -D do not matter. Files are compared by their content.

#include <cstdint>
#include <string>
#include <vector>

#include "stages/core/description/description.h"

namespace loom {

/// Effects of an edit on a shape, one bit each. A removed shape exists only in the old scene, an added one only in the
/// new scene. All others exist in both, at indices that may differ.
namespace shape_change {
inline constexpr unsigned moved = 1;      // rigidly: rotated and translated
inline constexpr unsigned repainted = 2;  // its BSDF, or a texture of it
inline constexpr unsigned relit = 4;      // its emission
inline constexpr unsigned removed = 8;
inline constexpr unsigned added = 16;
}  // namespace shape_change

/// Edit of one shape, in the terms of [RP] §3.3. A path vertex on a shape whose placement changed is dynamic. A path
/// segment that crosses the placement of such a shape in the other scene has a ghost vertex there.
struct ShapeEdit {
    static constexpr std::uint32_t none = ~0u;
    unsigned changes = 0;              // bits of shape_change::
    std::uint32_t partner_idx = none;  // index of the same shape in the other scene
    Matrix4d to_partner;               // rigid map of its points onto those of the partner; identity unless moved

    /// Whether a vertex on it is dynamic in its own scene; the shape's placement is then a ghost in the other.
    bool dynamic() const {
        return (changes & (shape_change::moved | shape_change::removed | shape_change::added)) != 0;
    }
    /// Whether a vertex on it scatters or emits differently in the other scene, at the same position.
    bool dyed() const { return (changes & (shape_change::repainted | shape_change::relit)) != 0; }
};

/// Edit of one of Scene::emitters.
struct EmitterEdit {
    static constexpr std::uint32_t none = ~0u;
    bool changed = false;  // emission or position differs; always true without a partner
    std::uint32_t partner_idx = none;
};

struct Edit {
    /// Indices are those of Scene::shapes and Scene::emitters of build_scene() from the same descriptions.
    std::vector<ShapeEdit> old_shapes, new_shapes;
    std::vector<EmitterEdit> old_emitters, new_emitters;
    std::vector<std::string> changes;  // as text, one each
    std::vector<std::string> notes;    // differences without effect on the mean image

    bool nothing() const { return changes.empty(); }
    /// Number of dynamic shapes of the new scene, and of the old scene: the ghosts of the new one.
    std::size_t n_dynamic() const;
    std::size_t n_ghosts() const;
    std::size_t n_dyed() const;       // shapes of the new scene that scatter or emit differently, at the same placement
    std::size_t n_repainted() const;  // those that scatter differently
    std::size_t n_emitters() const;   // changed ones, in the scene that has more of them
};

/// Finds the edit between two scenes. Shapes and emitters are matched by match_shapes() and match_emitters(); an area
/// light belongs to its shape. A matched shape of the same form is moved if a rotation and a translation map one
/// placement to the other. A shape that is scaled, mirrored or of another form counts as removed and added.
/// differs: an explicit parameter and an omitted one of equal default count as different; the residual of such an edit
///          is 0 nevertheless
/// throws:  InputError with both locations where camera, film, filter or depth differ, because then no pixels
///          correspond
Edit find_edit(const SceneDescription& old_scene, const SceneDescription& new_scene);

/// Describes a rigid motion as text: "by (1, 0, 0)", "turned by 30 degrees about (0, 1, 0) through its centre".
/// in:      centre        a reference point of the shape
///          has_centre    whether that point is the centre of the shape
std::string motion_words(const Matrix4d& motion, const Point3<double>& centre, bool has_centre);

}  // namespace loom
