// Paths that are resumed midway against the same paths traced as a whole: to the last bit, from every depth, with any
// neighbours in the batch.
//
// Detected mutations: paths that join out of order (it does not end), with the random stream of another, or that were
// to be left alone; of paths that a gate takes out, the rays or random numbers of their neighbours kept in place.

#include <fmt/format.h>
#include <gtest/gtest.h>

#include "stages/core/tracing/path_observer.h"
#include "stages/core/tracing/path_tracer.h"
#include "tests/path_states.h"
#include "tests/traced_graph.h"

namespace loom {
namespace {

void expect_same(const PathResult& a, const PathResult& b) {
    EXPECT_EQ(a.L, b.L);
    EXPECT_EQ(a.first.albedo, b.first.albedo);
    EXPECT_EQ(a.first.n, b.first.n);
    EXPECT_EQ(a.first.depth, b.first.depth);
    EXPECT_EQ(a.n_vertices, b.n_vertices);
    EXPECT_EQ(a.n_rays, b.n_rays);
}

struct ResumeCase {
    std::string name, scene;
    SamplerKind sampler = SamplerKind::sobol;
    Roulette roulette = Roulette::albedo;
    int max_depth = -1;
};

class ResumedPaths : public ::testing::TestWithParam<ResumeCase> {
  protected:
    const std::unique_ptr<Scene> scene_ = loom::testing::own_scene(GetParam().scene, 24, 24);
    const PathOptions options_ = options();
    std::vector<PathId> ids_;
    PathBatch batch_{*scene_, options_};
    std::vector<PathResult> whole_;  // traced whole

    ResumedPaths() {
        for (std::uint64_t pixel = 0; pixel < 24 * 24; ++pixel) ids_.push_back({pixel, pixel % 3});
        whole_.resize(ids_.size());
        batch_.trace(ids_, whole_);
    }

  private:
    PathOptions options() const {
        PathOptions options = loom::testing::path_options(*scene_, 7, GetParam().sampler);
        options.roulette = GetParam().roulette;
        options.rr_depth = 3;
        options.max_depth = GetParam().max_depth;
        return options;
    }
};

TEST_P(ResumedPaths, EndAsThoseTracedWhole) {
    std::vector<std::vector<PathState>> states;
    for (const PathId& id : ids_) states.push_back(loom::testing::states_of(*scene_, options_, id));

    // In each round a path starts a depth later than in the one before, its neighbours elsewhere; one in five not at
    // all.
    std::size_t n_resumed = 0, deepest = 0;
    for (std::size_t round = 0; round < 12; ++round) {
        std::vector<PathState> paths;
        std::vector<std::uint32_t> under_way;
        for (std::size_t i = 0; i < ids_.size(); ++i) {
            const std::size_t depth = std::min((i + round) % 12, states[i].size() - 1);
            paths.push_back(states[i][depth]);
            if ((i + round) % 5 == 0) continue;
            under_way.push_back(std::uint32_t(i));
            deepest = std::max(deepest, depth);
        }
        n_resumed += under_way.size();
        batch_.resume(paths, under_way);
        std::size_t next = 0;
        for (std::size_t i = 0; i < ids_.size(); ++i) {
            SCOPED_TRACE(fmt::format("round {}, path {}", round, i));
            if (next < under_way.size() && under_way[next] == i) {
                expect_same(paths[i].result, whole_[i]);
                ++next;
            } else {
                expect_same(paths[i].result, states[i][std::min((i + round) % 12, states[i].size() - 1)].result);
            }
        }
    }
    EXPECT_GT(n_resumed, 5000u);
    EXPECT_GT(deepest, 0u);
}

/// Stops path i at its edge 1 + i % 6, if it comes so far.
struct GateByNumber : PathGate {
    std::vector<std::uint32_t> stopped;

    void arrive(int depth, std::span<const std::uint32_t> paths, std::span<const Ray* const> rays,
                std::span<const Hit> hits, std::span<std::uint8_t> stops) override {
        EXPECT_EQ(rays.size(), paths.size());
        EXPECT_EQ(hits.size(), paths.size());
        for (std::size_t k = 0; k < paths.size(); ++k) {
            stops[k] = int(paths[k] % 6) + 1 == depth;
            if (stops[k]) stopped.push_back(paths[k]);
        }
    }
};

TEST_P(ResumedPaths, EndAsThoseTracedWholeAfterAGate) {
    std::vector<PathState> paths;
    std::vector<std::uint32_t> all;
    for (const PathId id : ids_) {
        const Sampler sampler(options_.sampler, options_.seed, id.pixel, id.sample);
        all.push_back(std::uint32_t(all.size()));
        paths.emplace_back(*scene_, sampler, id, sampler.pair(film_pair));
    }
    GateByNumber gate;
    batch_.resume(paths, all, &gate);
    ASSERT_GT(gate.stopped.size(), 100u);
    std::vector<bool> stopped(ids_.size());
    for (const std::uint32_t i : gate.stopped) {
        SCOPED_TRACE(fmt::format("path {}", i));
        stopped[i] = true;
        PathResult before = loom::testing::states_of(*scene_, options_, ids_[i])[i % 6].result;
        ++before.n_rays;
        expect_same(paths[i].result, before);
    }
    batch_.resume(paths, gate.stopped);
    for (std::size_t i = 0; i < ids_.size(); ++i) {
        SCOPED_TRACE(fmt::format("path {}", i));
        whole_[i].n_rays += stopped[i];
        expect_same(paths[i].result, whole_[i]);
    }
}

INSTANTIATE_TEST_SUITE_P(
    Scenes, ResumedPaths,
    ::testing::Values(ResumeCase{"matte", "cornell-box.xml"},
                      ResumeCase{"glossy", "glossy-box.xml", SamplerKind::independent, Roulette::throughput},
                      ResumeCase{"lights", "all-emitters.xml", SamplerKind::sobol, Roulette::off, 6},
                      ResumeCase{"glass", "caustic.xml", SamplerKind::sobol, Roulette::throughput},
                      ResumeCase{"textured", "textured.xml"},
                      ResumeCase{"mask", "mask.xml", SamplerKind::independent, Roulette::off, 5},
                      ResumeCase{"map", "environment-map.xml"},
                      ResumeCase{"short", "cornell-box.xml", SamplerKind::sobol, Roulette::albedo, 3}),
    [](const auto& info) { return info.param.name; });

}  // namespace
}  // namespace loom
