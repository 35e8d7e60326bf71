// Boxes around shapes, and segments against boxes: one by one and by column.
#include "stages/core/math/box.h"

#include <gtest/gtest.h>

#include "stages/core/sampling/sampler.h"
#include "stages/core/tracing/segment_columns.h"

namespace loom {
namespace {

// Includes sheared disks, whose points are farther from the centre than either axis is long. Detected mutation: a ball
// of the longer axis.
TEST(Box, OfADiskHasAllItsPointsAndNoMore) {
    Shape disk;
    disk.kind = ShapeKind::disk;
    disk.round.center = {1, 2, 3};
    disk.round.u_axis = {1, 0.2f, 0};
    disk.round.v_axis = {1, 0.1f, 0.5f};
    const Box3f box = disk.bounds();
    Box3f of_points;
    for (int i = 0; i < 10000; ++i) {
        const float angle = 2 * float(pi_double) * float(i) / 10000;
        of_points.add(disk.round.center + disk.round.u_axis * std::cos(angle) + disk.round.v_axis * std::sin(angle));
    }
    for (int k = 0; k < 3; ++k) {
        EXPECT_NEAR(box.lo[k], of_points.lo[k], 1e-5);
        EXPECT_NEAR(box.hi[k], of_points.hi[k], 1e-5);
    }
}

// The columns give the result of one box after the other, for segments of all directions, along axes too. Detected
// mutations: only the last box counts; the end of a segment left out.
TEST(Box, ColumnsOfSegmentsAreAsOneByOne) {
    constexpr std::size_t n = 1000;
    std::uint64_t next = 0;
    const auto u = [&] { return Sampler(SamplerKind::independent, 5, 0, next++).pair(0).x; };
    const auto point = [&] { return Point3f{2 * u() - 1, 2 * u() - 1, 2 * u() - 1}; };
    std::vector<Box3f> boxes(5);
    for (Box3f& box : boxes) {
        box.add(point());
        box.grow(0.25f);
    }
    SegmentColumns columns(n);
    std::vector<Ray> rays;
    for (std::size_t i = 0; i < n; ++i) {
        Vector3f d = normalize(point() - point());
        if (i % 7 == 0) d = {i % 2 ? 1.0f : -1.0f, 0, 0};
        rays.push_back({point(), d, 0, u()});
        columns.set(i, rays.back());
    }
    find_met(columns, n, boxes.data(), boxes.size());
    std::size_t met = 0;
    for (std::size_t i = 0; i < n; ++i) {
        const Ray& r = rays[i];
        bool expected = false;
        for (const Box3f& box : boxes) expected |= box.met_by(r.o, {1 / r.d.x, 1 / r.d.y, 1 / r.d.z}, r.t_min, r.t_max);
        EXPECT_EQ(columns.met[i] != 0, expected) << i;
        met += expected;
    }
    EXPECT_GT(met, n / 20);
    EXPECT_LT(met, n / 2);
}

}  // namespace
}  // namespace loom
