#pragma once
// One edit by loom-residual, from its scene to its outputs, and what all edits of an old scene share.

#include <memory>
#include <optional>
#include <string>

#include "formats/io/cost.h"
#include "stages/core/assets/texture.h"
#include "stages/core/description/description.h"
#include "stages/core/scene/build.h"
#include "stages/residual/control/seen_emission.h"
#include "stages/residual/residual.h"
#include "stages/residual/stored/old_graph.h"
#include "stages/residual/stored/path_parts.h"

namespace loom::residual {

/// What all edits of an old scene share.
struct Base {
    SceneDescription description;
    std::shared_ptr<const Scene> scene;
    // What no frame changes, of which the scene is made; null: the scene itself.
    std::optional<SceneDescription> fixed_description;
    std::shared_ptr<const Scene> fixed;
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
    KnownParts known;     // of the old scene
};

/// The two scenes of an edit with their file names.
struct Scenes {
    std::shared_ptr<const Scene> old_scene, new_scene;
    std::string old_name, new_name;

    ScenePair pair() const { return {*old_scene, *new_scene}; }
};

/// A residual and its origin.
struct Residual {
    Image image;
    bool existed = false;  // read from --residual
    PathOptions path;
    bool same_samples = false;                    // the old image has the graph's samples
    GraphResidual of_graph;                       // only with a graph
    double load_s = 0;                            // CPU time of reading the new scene
    std::optional<ControlledPicture> controlled;  // only with --method auto
    Counts counts;
    std::uint64_t n_extra = 0;  // pairs of --extra
    Ledger ledger_of_sum;       // of the new image that was written
    std::string plan;
};

/// Time spent on something.
struct Spent {
    double wall_s = 0, cpu_s = 0;
    /// Adds a share of the time between two costs of a run.
    void add(const Cost& before, const Cost& after, double share = 1) {
        wall_s += share * (after.wall_s - before.wall_s);
        cpu_s += share * (after.cpu_s - before.cpu_s);
    }
};

/// An edit on its way from its scene to its outputs.
struct EditRun {
    Options options;
    EditJob job;
    Edit edit;
    Scenes scenes;
    Residual residual;
    std::unique_ptr<EditReach> reach;    // only with a graph, or for parts
    std::unique_ptr<PartSums> parts;     // only with --parts
    std::optional<ControlSums> control;  // weights of the old image, if they differ from 1
    SeenEmission seen;                   // that the graph's pairs lack
    Spent spent;                         // on this edit, without loading
};

/// Whether an image has VarMean.
bool says_its_noise(const Image& image);
/// Returns the method of the pairs: those of a graph, and adaptive ones, are correlated.
Method planned_method(const Options& options);
void report_edit(const Edit& edit, app::Report& report);
/// throws:  InputError for options that contradict each other, or outputs that cannot be written
void check_endings(const Options& options);
int max_depth_of(const Options& options, const SceneDescription& description);
/// Builds the old scene, and reads its image and graph.
/// in:      fixed  what no frame of an animation changes, if that is less than the old scene
Base read_base(const Options& options, SceneDescription description, int max_depth, app::Report& report,
               std::optional<SceneDescription> fixed = {});
/// Returns the geometry that a new scene has from what no frame changes, or else from the old scene.
/// in:      edit  from the old scene
KnownParts parts_known_of(const Base& base, const Edit& edit, const SceneDescription& new_scene);
/// Builds the new scene of an edit, and all that its pairs of paths need.
std::unique_ptr<EditRun> start_edit(Options options, const Base& base, EditJob job, Edit edit, app::Report& report);
/// Returns what the old graph is followed for; it borrows of the run.
GraphJob graph_job(EditRun& run, const Base& base);
/// Makes the residual, from the graph's pairs of paths if there is a graph, and writes its outputs.
void finish_edit(EditRun& run, const Base& base, std::optional<GraphResidual> pairs, app::Report& report);
/// All of it, for one edit.
void render_edit(const Options& options, const Base& base, EditJob job, const Edit& edit, app::Report& report);

}  // namespace loom::residual
