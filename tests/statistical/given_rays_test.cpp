// Mean radiance along a given ray against closed forms and against the pixel of a camera that looks along it.
#include <fmt/format.h>
#include <gtest/gtest.h>

#include "stages/core/stats/chi_square.h"
#include "stages/core/stats/moments.h"
#include "stages/core/tracing/given_ray_tracer.h"
#include "tests/statistical/support.h"
#include "tests/traced_graph.h"

namespace loom {
namespace {

constexpr int n_comparisons = 8;  // in this file, rounded up

Estimate mean_along(const Scene& scene, const PathOptions& options, const GivenRay& ray, std::uint64_t n) {
    GivenRayTracer tracer(scene, options);
    std::vector<GivenRay> rays(PathBatch::capacity, ray);
    Moments L;
    for (std::uint64_t sample = 0; sample < n;) {
        for (GivenRay& one : rays) one.id = {0, sample++};
        tracer.trace(rays);
        for (const PathResult& result : tracer.results()) L.add(result.L.g);
    }
    return {L.mean, std::sqrt(L.var_mean()), double(L.n - 1)};
}

/// in:      bias  relative bias that the test must detect
void expect_equal(const Estimate& mean, const Estimate& reference, double bias) {
    const double alpha = sidak_alpha(n_comparisons);
    EXPECT_GE(welch_p_value(mean, reference), alpha) << fmt::format("{:.7g} +- {:.2g} instead of {:.7g} +- {:.2g}",
                                                                    mean.mean, mean.se, reference.mean, reference.se);
    // Power: that bias would be detected in nine of ten runs.
    EXPECT_LE((student_critical(alpha, mean.dof) + 1.28) * std::hypot(mean.se, reference.se), bias * reference.mean);
}

// A ray that is edge d of paths of at most N edges sees 1 + rho + ... + rho^(N - d).
// Detected mutations: depths counted from 1 at the ray; its emission weighted.
TEST(GivenRayMean, InAFurnaceIsTheGeometricSeries) {
    const auto scene = load_scene(source_dir() / "scenes/furnace.xml", {});
    for (int depth = 1; depth <= 6; ++depth) {
        SCOPED_TRACE(depth);
        const double answer = (1 - std::pow(0.5, 7 - depth)) / (1 - 0.5);
        const GivenRay ray{{{0.5f, -1, 0.3f}, normalize(Vector3f{1, 2, 0.5f})}, {}, {}, depth};
        const Estimate e = mean_along(*scene, options_of(*scene), ray, 1 << 16);
        if (std::abs(e.mean - answer) < 2e-5 * answer) continue;  // free of noise up to rounding
        expect_equal(e, {answer, 0, INFINITY}, 0.01);
    }
}

// A ray that leaves a surface against the camera ray from there: one edge more on each path and for roulette. Behind the
// glass pane that it hits lies a lit corner of two walls.
// Detected mutation: depths counted from 1 at the ray.
TEST(GivenRayMean, EqualsThePixelOfACameraThatLooksAlongTheRay) {
    const testing::InlineScene description{
        .sensor =
            "type='perspective'><float name='fov' value='0.01'/><transform name='to_world'>"
            "<lookat origin='0,-3,1' target='0,0,.4' up='0,0,1'/></transform>",
        .body =
            "<shape type='rectangle'><transform name='to_world'><scale value='4'/></transform><bsdf type='diffuse'>"
            "<rgb name='reflectance' value='.7,.6,.5'/></bsdf></shape>"
            "<shape type='rectangle'><transform name='to_world'><scale value='4'/><rotate x='1' angle='90'/>"
            "<translate y='.5'/></transform><bsdf type='roughplastic'><float name='alpha' value='.3'/></bsdf></shape>"
            "<shape type='cube'><transform name='to_world'><scale x='1' y='.05' z='1'/><translate y='-1'/></transform>"
            "<bsdf type='dielectric'/></shape>"
            "<shape type='rectangle'><transform name='to_world'><rotate x='1' angle='180'/><translate "
            "z='3'/></transform><emitter type='area'><rgb name='radiance' value='5'/></emitter></shape>"
            "<emitter type='constant'><rgb name='radiance' value='.2'/></emitter>",
        .width = 1,
        .height = 1};
    const auto scene = testing::load_inline(description);
    PathOptions options = options_of(*scene);
    options.rr_depth = 2;
    options.max_depth = 6;
    const Replicates pixel = trace_replicates(*scene, options, 1 << 13, 32);
    ++options.rr_depth;
    ++options.max_depth;
    options.seed = 77;
    const GivenRay ray{{{0, -3, 1}, normalize(Vector3f{0, 3, -0.6f})}, {}, {}, 2};
    expect_equal(mean_along(*scene, options, ray, 1 << 18), pixel.estimate(1, 0), 0.02);
}

}  // namespace
}  // namespace loom
