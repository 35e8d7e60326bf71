#include "stages/residual/dynamic/camera_paths.h"

namespace loom::residual {

CameraPaths::CameraPaths(const DynamicScenes& scenes, const PathOptions& path)
    : observer_(std::make_unique<TouchObserver>(scenes.new_scene.scene, scenes.targets(scenes.new_scene))),
      all_touched_(!scenes.same_choice_of_lights),
      new_batch_(scenes.new_scene.scene, path, observer_.get()),
      old_batch_(scenes.old_scene.scene, path) {}

void CameraPaths::trace_new(std::span<const PathId> ids) {
    new_.resize(ids.size());
    new_batch_.trace(ids, new_);
    old_of_.assign(ids.size(), none);
    touched_.clear();
    for (std::size_t k = 0; k < ids.size(); ++k) {
        counts_new.add(new_[k]);
        if (!observer_->touched(k) && !all_touched_) continue;
        old_of_[k] = std::uint32_t(touched_.size());
        touched_.push_back(ids[k]);
    }
    n_touched += touched_.size();
}

void CameraPaths::trace(std::span<const PathId> ids) {
    trace_new(ids);
    old_.resize(touched_.size());
    old_batch_.trace(touched_, old_);
    for (const PathResult& path : old_) counts_old.add(path);
}

}  // namespace loom::residual
