// Camera rays against numbers computed by hand (and confirmed in Mitsuba 3), and film positions against the filters
// that they are drawn from. Detected mutations: y divided by the aspect twice, the sign of the principal point, the
// tent's distribution without truncation at the border, gaussian_stddev doubled.

#include "stages/core/scene/sensor.h"

#include <gtest/gtest.h>

#include <cmath>
#include <functional>
#include <vector>

#include "stages/core/sampling/sampler.h"
#include "stages/core/scene/scene.h"
#include "stages/core/stats/chi_square.h"
#include "tests/unit/bsdf_cases.h"

namespace loom::test {
namespace {

Sensor sensor_of(SensorKind kind, Filter filter = Filter::box, float radius = 0.5f) {
    Sensor s;
    s.kind = kind;
    s.width = 64;
    s.height = 32;
    s.filter = filter;
    s.filter_radius = radius;
    s.tan_half_fov_x = std::tan(25 * pi_double / 180);
    s.prepare();
    return s;
}

// A camera at (1, 2, 3) that looks to the origin, z up: columns are left, up, forward and origin.
void place(Sensor& s, double scale_x) {
    const Vector3<double> forward = normalize(Vector3<double>{-1, -2, -3}),
                          left = normalize(cross(Vector3<double>{0, 0, 1}, forward)), up = cross(forward, left);
    for (int k = 0; k < 3; ++k) {
        s.world_from_camera[4 * k] = left[k] * scale_x;
        s.world_from_camera[4 * k + 1] = up[k] * scale_x;
        s.world_from_camera[4 * k + 2] = forward[k];
        s.world_from_camera[4 * k + 3] = k + 1;
    }
    s.prepare();
}

void expect_near(const Vector3f& v, const Vector3f& expected) {
    for (int k = 0; k < 3; ++k) EXPECT_NEAR(v[k], expected[k], 2e-6) << k;
}

TEST(Sensor, PerspectiveWithShiftedPrincipalPoint) {
    Sensor s = sensor_of(SensorKind::perspective);
    s.principal_x = 0.1f;
    s.principal_y = -0.05f;
    s.prepare();
    // Film position (0.25, 0.75): the corner of pixel (16, 24).
    const Ray ray = s.sample_ray(16, 24, {0, 0});
    expect_near(ray.d / ray.d.z, {0.13989234f, -0.09326148f, 1});
    EXPECT_NEAR(length(ray.d), 1, 1e-6);
    EXPECT_EQ(ray.o, Point3f(0, 0, 0));
    // The clipping planes are at right angles to the axis.
    EXPECT_NEAR(ray.t_min * ray.d.z, 1e-2, 1e-8);
    EXPECT_NEAR(ray.t_max * ray.d.z, 1e4, 1e-2);
}

TEST(Sensor, PerspectivePlacedInTheWorld) {
    Sensor s = sensor_of(SensorKind::perspective);
    place(s, 1);
    const Ray ray = s.sample_ray(16, 24, {0, 0});
    expect_near(ray.d, {-0.016374f, -0.537238f, -0.843272f});
    EXPECT_EQ(ray.o, Point3f(1, 2, 3));
}

TEST(Sensor, OrthographicSpansMinusOneToOneInItsX) {
    Sensor s = sensor_of(SensorKind::orthographic);
    place(s, 2);
    const Ray ray = s.sample_ray(16, 24, {0, 0});
    expect_near(ray.d, {-0.267261f, -0.534523f, -0.801784f});
    // Mitsuba starts its rays on the near plane, ours carry it as t_min.
    expect_near(ray.o + ray.d * ray.t_min - Point3f(0, 0, 0), {2.071039f, 1.906010f, 2.693175f});
}

/// p-value of the offsets of film positions from a pixel's centre under `cdf`, over [low, high].
double offsets_p_value(const Sensor& s, std::uint32_t px, double low, double high,
                       const std::function<double(double)>& cdf) {
    constexpr int cells = 48, n = 1 << 19;
    std::vector<double> observed(cells), expected(cells);
    for (int i = 0; i < cells; ++i)
        expected[i] = n * (cdf(low + (high - low) * (i + 1) / cells) - cdf(low + (high - low) * i / cells)) /
                      (cdf(high) - cdf(low));
    for (int i = 0; i < n; ++i) {
        const Point2f u = Sampler(SamplerKind::independent, 12, px, i).pair(0);
        const Vector3f d = s.sample_ray(px, 16, u).d;
        const double film_x = 0.5 * (1 - d.x / d.z / s.tan_half_fov_x) * s.width;
        const double cell = (film_x - (px + 0.5) - low) / (high - low) * cells;
        EXPECT_TRUE(cell > -0.01 && cell < cells + 0.01);
        ++observed[std::min(std::max(int(cell), 0), cells - 1)];
    }
    return chi_square_test(observed, expected).p_value;
}

TEST(Sensor, FilmPositionsFollowTheFilter) {
    const double alpha = sidak_alpha(n_comparisons);
    const auto box = [](double x) { return x; };
    EXPECT_GE(offsets_p_value(sensor_of(SensorKind::perspective), 31, -0.5, 0.5, box), alpha);

    const auto tent = [](double x) { return x < 0 ? 0.5 * sqr(1 + x / 1.5) : 1 - 0.5 * sqr(1 - x / 1.5); };
    EXPECT_GE(offsets_p_value(sensor_of(SensorKind::perspective, Filter::tent, 1.5f), 31, -1.5, 1.5, tent), alpha);

    // exp(-x^2 / (2 s^2)) minus its value at the radius of 4 s.
    const double s = 0.5, r = 4 * s;
    const auto gaussian = [&](double x) {
        return s * std::sqrt(pi_double / 2) * std::erf(x / (s * std::sqrt(2.0))) - x * std::exp(-0.5 * sqr(r / s));
    };
    EXPECT_GE(offsets_p_value(sensor_of(SensorKind::perspective, Filter::gaussian, 2), 31, -2, 2, gaussian), alpha);

    // At the border of the film the filter is cut off and scaled up again.
    EXPECT_GE(offsets_p_value(sensor_of(SensorKind::perspective, Filter::tent, 1.5f), 0, -0.5, 1.5, tent), alpha);
    EXPECT_GE(offsets_p_value(sensor_of(SensorKind::perspective, Filter::gaussian, 2), 63, -2, 0.5, gaussian), alpha);
}

}  // namespace
}  // namespace loom::test
