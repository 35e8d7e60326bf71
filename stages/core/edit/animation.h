#pragma once
// Animations: frames of a scene that differ in the values of its $parameters, and the static scene that they share. What
// moves is found by comparing the descriptions of the frames, not declared.                          [HY] section 3.1

#include <cstdint>
#include <filesystem>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include "stages/core/description/description.h"
#include "stages/core/edit/edit.h"
#include "stages/core/scene/build.h"

namespace loom {

/// Values of some parameters of a scene, frame by frame.
struct Frames {
    struct Frame {
        std::uint32_t number = 0;
        std::vector<std::string> values;  // [parameter]
        std::size_t line = 0;             // of the file
        std::size_t row = 0;              // index among the frames of the file
    };
    std::string file;
    std::string absent;                   // value of a parameter whose shapes a frame lacks; empty: none
    std::vector<std::string> parameters;  // $names
    std::vector<Frame> frames;            // in the order of the file

    /// Returns the values of a frame after others.
    Defines values_of(const Frame& frame, Defines others = {}) const;
    /// Returns the parameters that are absent in a frame.
    std::set<std::string> absent_in(const Frame& frame) const;
};

/// Reads a table of frames, tab-separated: `frame` and the names of parameters in the first line, then a row per frame
/// with its number and all values. Empty lines count for nothing.
/// in:      absent  --absent: a frame drops the shapes that use a parameter of this value
/// throws:  InputError with file, line and column: no `frame`, a number twice, a cell without value
Frames read_frames(const std::string& file, const std::string& absent = {});

/// Reads the scene of a frame.
/// in:      defines  values of other parameters
/// throws:  InputError that also names the line of the frame
SceneDescription read_frame(const std::filesystem::path& scene, const Frames& frames, const Frames::Frame& frame,
                            const Defines& defines, const std::string& sensor);

/// Returns the frames whose numbers --only names: FIRST:END, or FIRST:END:STEP; all if it is empty.
/// throws:  InputError
std::vector<Frames::Frame> frames_of(const Frames& frames, const std::string& only);

/// Whether the frames of an animation may have cameras of their own.
enum class Cameras : std::uint8_t { one, each };

struct Animation {
    // With the camera of the first frame, without the shapes that move; built, its hash depends on what it holds alone.
    SceneDescription still;
    std::optional<SceneDescription> fixed;  // without the lights with shapes that differ, too; none: `still` has none
    std::vector<std::string>
        moving;  // ids of the shapes that differ between frames, or that some lack, and emit nothing
    std::vector<std::string> relit;        // ids of such lights, of which `still` has those of the first frame
    std::vector<SceneDescription> frames;  // [frame], in the order of the table
    // Content hashes, whatever the names of files: of `still`, and of each frame's whole scene.
    std::string still_hash;
    std::vector<std::string> frame_hashes;
    bool camera_moves = false;
    std::string describe() const;  // in one line
};

/// Finds what the frames of a scene have in common. A light that differs stays as it is in the first frame, for the choice
/// of a light among others depends on their number; one that the first frame lacks is added in others. Shapes and lights
/// are matched as those of an edit (match_shapes()). With Cameras::each the hash of the static scene does not depend on the
/// camera where that differs.
/// throws:  InputError of the scene with the frame's line; where film or integrator differ, or with Cameras::one the
///          camera, for which frames have no common pixels or paths
Animation find_animation(const std::filesystem::path& scene, const Defines& defines, const std::string& sensor,
                         const Frames& frames, Cameras cameras = Cameras::one);

/// Returns a description with the camera of another one.
SceneDescription with_camera_of(const SceneDescription& scene, const SceneDescription& frame);

/// Returns the geometry that the new scene of an edit has from the old one. Nothing is known where a shape of the old one is
/// moved or removed, nor in an NLOS capture.
KnownParts known_parts(std::shared_ptr<const Scene> old_scene, const Edit& edit);

}  // namespace loom
