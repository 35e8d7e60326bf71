#pragma once

namespace loom {

struct Scene;

/// The two scenes of an edit; film and camera are equal.
struct ScenePair {
    const Scene &old_scene, &new_scene;
};

}  // namespace loom
