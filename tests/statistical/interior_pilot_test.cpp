// The look at some paths that says how much noise the interior part has, against that of all paths.
#include "stages/derive/interior_pilot.h"

#include <gtest/gtest.h>

#include <cstdio>
#include <numeric>

#include "tests/statistical/derivative_support.h"

namespace loom {
namespace {

// Detected mutation: all samples of 16 pixels (turn: 2.9).
TEST(InteriorPilot, KnowsTheNoiseOfAllPaths) {
    const struct {
        const char *file, *parameter;
    } cases[] = {{"scenes/tower.xml", "turn"}, {"scenes/shadow-mover.xml", "light_x"}};
    for (const auto& [file, parameter] : cases) {
        const DerivableScene scene(std::filesystem::path(LOOM_SOURCE_DIR) / file, {parameter},
                                   {{"resx", "24"}, {"resy", "24"}});
        for (const std::uint64_t seed : {1, 2, 3}) {
            const PathGraph graph = trace_derivable(*scene.scene, 1024, seed);
            const derive::Attached attached = derive::attached_of(*scene.scene, derive::Attachment::automatic);
            const double seen =
                derive::look_at_interior(graph, *scene.scene, scene.tangents, attached, {}, 1).variance[0];

            app::Report report;
            report.set_quiet(true);
            derive::DeriveCounts counts;
            const std::vector<std::string> off = {"primary", "direct", "indirect"};
            const Derivative d = derive::differentiate(
                graph, *scene.scene, scene.tangents, derive::required_parts(*scene.scene, graph, scene.tangents, off),
                {.effort = 1, .seed = seed, .light_points_per_side = 1}, report, counts);
            TimeResponse response = film_response(*scene.scene);
            response.pulse = Pulse::box(response.width);
            const DerivedBins bins = bins_of(graph, &d, response);
            const double exact = std::accumulate(bins.var_mean.begin(), bins.var_mean.end(), 0.0);
            std::printf("    %-8s %.3g of %.3g: %.2f\n", parameter, seen, exact, seen / exact);
            EXPECT_GT(seen, exact / 1.3) << parameter;
            EXPECT_LT(seen, exact * 1.3) << parameter;
        }
    }
}

}  // namespace
}  // namespace loom
