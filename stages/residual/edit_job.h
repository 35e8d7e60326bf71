#pragma once
// The parts of a run of loom-residual: what all edits of an old scene share, and one edit.

#include <memory>
#include <string>

#include "formats/io/cost.h"
#include "stages/core/assets/texture.h"
#include "stages/core/description/description.h"
#include "stages/core/scene/build.h"
#include "stages/residual/residual.h"
#include "stages/residual/stored/old_graph.h"

namespace loom::residual {

/// What all edits of an old scene share.
struct Base {
    SceneDescription description;
    std::shared_ptr<const Scene> scene;
    std::string name;
    std::shared_ptr<TextureCache> images = std::make_shared<TextureCache>();
    Image image;     // of --old
    Ledger ledger;   // its links
    OldGraph graph;  // of --old-graph
};

/// An edit of the old scene, and what its run costs beside it.
struct EditJob {
    SceneDescription description;
    std::string file;     // of the new scene
    std::string command;  // that does this edit alone
    Cost loading;         // of what all edits share
    double share = 1;     // of that, for this one
    Cost before;          // of the run, before this edit
    KnownParts known;     // of the old scene
};

/// throws:  InputError for options that contradict each other, or outputs that cannot be written
void check_endings(const Options& options);
int max_depth_of(const Options& options, const SceneDescription& description);
/// Builds the old scene, and reads its image and graph.
Base read_base(const Options& options, SceneDescription description, int max_depth, app::Report& report);
/// Renders the residual of one edit and writes its outputs.
void render_edit(const Options& options, const Base& base, EditJob job, const Edit& edit, app::Report& report);

}  // namespace loom::residual
