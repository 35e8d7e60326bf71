// Limits on the length of paths in the scene file.
#include <gtest/gtest.h>

#include "stages/core/scene/build.h"
#include "stages/core/tracing/path_record.h"
#include "stages/core/tracing/path_tracer.h"
#include "tests/unit/scene_folder.h"

namespace loom {
namespace {

class Limits : public SceneFolder {
  protected:
    std::unique_ptr<Scene> load(const std::string& integrator, const std::string& body = "") {
        return load_scene(write(
            "scene.xml", "<scene version='3.0.0'>" + integrator +
                             "<sensor type='perspective'><transform name='to_world'><translate z='-5'/></transform>"
                             "<film type='hdrfilm'><integer name='width' value='8'/><integer name='height' "
                             "value='8'/></film></sensor>" +
                             body + "</scene>"));
    }
};

// A sphere that emits before a sky, directly visible: no path has 0 edges.
TEST_F(Limits, DepthZeroIsBlack) {
    const auto scene =
        load("<integrator type='volpath'><integer name='max_depth' value='0'/></integrator>",
             "<shape type='sphere'><bsdf type='diffuse'/><emitter type='area'/></shape><emitter type='constant'/>");
    ASSERT_EQ(scene->max_depth, 0);
    for (const int depth : {0, 1}) {
        PathOptions options;
        options.max_depth = depth;
        std::vector<PathId> ids;
        for (std::uint64_t pixel = 0; pixel < 64; ++pixel) ids.push_back({pixel, 0});
        std::vector<PathResult> results(ids.size()), recorded(ids.size());
        PathRecords records;
        PathBatch batch(*scene, options);
        batch.trace(ids, results);
        batch.trace(ids, recorded, records);
        for (std::size_t k = 0; k < ids.size(); ++k) {
            PathRecords alone;
            EXPECT_EQ(results[k].L, Spectrum(float(depth)));
            EXPECT_EQ(recorded[k].L, results[k].L);
            EXPECT_EQ(trace_path(*scene, options, ids[k], alone).L, results[k].L);
        }
    }
}

TEST_F(Limits, IntegratorsThatImplyADepth) {
    const auto depth_of = [&](const std::string& integrator) { return load(integrator)->max_depth; };
    EXPECT_EQ(depth_of("<integrator type='path'/>"), -1);
    EXPECT_EQ(depth_of("<integrator type='direct'><integer name='emitter_samples' value='4'/></integrator>"), 2);
    EXPECT_EQ(depth_of("<integrator type='moment'><integrator type='direct'/></integrator>"), 2);
    EXPECT_EQ(depth_of("<integrator type='aov'/>"), -1);
    EXPECT_EQ(depth_of("<integrator type='prb'/>"), 6);
    EXPECT_EQ(depth_of("<integrator type='transient_path'/>"), 6);
    EXPECT_EQ(depth_of("<integrator type='stokes'><integrator type='path'><integer name='max_depth' "
                       "value='3'/></integrator></integrator>"),
              3);
}

}  // namespace
}  // namespace loom
