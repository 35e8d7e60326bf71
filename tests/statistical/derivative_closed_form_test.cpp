// Derivatives that are known exactly: a penumbra of rectangles, a plane lit from the pinhole, a board in front of a lit
// ceiling, a furnace, hidden geometry.
#include <fmt/format.h>
#include <gtest/gtest.h>

#include <cmath>
#include <cstdio>
#include <numeric>

#include "stages/core/stats/chi_square.h"
#include "stages/derive/boundary.h"
#include "tests/statistical/derivative_support.h"
#include "tests/statistical/support.h"

namespace loom {
namespace {

/// A scene in a file of its own, removed with it.
class SceneText {
  public:
    explicit SceneText(const std::string& text) : file(testing::scratch_file(".xml")) { std::ofstream(file) << text; }
    ~SceneText() { std::filesystem::remove(file); }
    const std::filesystem::path file;
};

/// Mean of a parameter's numbers over an image's first channel.
double mean_of(const std::vector<double>& rgb) {
    double sum = 0;
    for (std::size_t i = 0; i < rgb.size(); i += 3) sum += rgb[i];
    return sum / double(rgb.size() / 3);
}

TimeResponse one_bin() {
    TimeResponse response;
    response.width = response.gate = 1e4;
    return response;
}

// ---- Penumbra -------------------------------------------------------------------------------------------------------

/// Gauss-Legendre nodes on [-1, 1].
struct Quadrature {
    std::vector<double> at, weight;
    explicit Quadrature(int n) {
        for (int i = 0; i < n; ++i) {
            double x = std::cos(pi_double * (i + 0.75) / (n + 0.5)), slope = 1;
            for (int step = 0; step < 50; ++step) {
                double p0 = 1, p1 = x;
                for (int k = 2; k <= n; ++k) p0 = std::exchange(p1, ((2 * k - 1) * x * p1 - (k - 1) * p0) / k);
                slope = n * (x * p1 - p0) / (x * x - 1);
                x -= p1 / slope;
            }
            at.push_back(x), weight.push_back(2 / ((1 - x * x) * sqr(slope)));
        }
    }
};

/// Positions of an axis-aligned lamp at z = 3, an occluder [-0.4, 0.4]^2 at z = 1 and a receiver at z = 0, all parallel.
struct Penumbra {
    double half = 0.3;  // of the lamp
    Vector3<double> lamp{0, 0, 3}, occluder{0, 0, 1}, receiver{0.6, 0.5, 0};

    static constexpr double occluder_half = 0.4;

    /// Form factor of a rectangle seen from below: sum over corners of its antiderivative.
    static double form_factor(double u0, double u1, double v0, double v1, double h) {
        if (!(u1 > u0 && v1 > v0)) return 0;
        const auto corner = [&](double u, double v) {
            const double a = std::sqrt(u * u + h * h), b = std::sqrt(v * v + h * h);
            return (u / a * std::atan(v / a) + v / b * std::atan(u / b)) / (2 * pi_double);
        };
        return corner(u1, v1) - corner(u0, v1) - corner(u1, v0) + corner(u0, v0);
    }
    double scale() const { return (lamp.z - receiver.z) / (occluder.z - receiver.z); }

    /// Radiance of a white diffuse point of the receiver: E / pi for radiance 1.
    double at(double x, double y) const {
        const double h = lamp.z - receiver.z, s = scale();
        const double u0 = lamp.x - half - x, u1 = lamp.x + half - x, v0 = lamp.y - half - y, v1 = lamp.y + half - y;
        const double a0 = (occluder.x - occluder_half - x) * s, a1 = (occluder.x + occluder_half - x) * s;
        const double b0 = (occluder.y - occluder_half - y) * s, b1 = (occluder.y + occluder_half - y) * s;
        return form_factor(u0, u1, v0, v1, h) -
               form_factor(std::max(u0, a0), std::min(u1, a1), std::max(v0, b0), std::min(v1, b1), h);
    }
    double at_middle() const { return at(receiver.x, receiver.y); }

    /// Mean over the square of a film about the middle of the receiver, split where an edge of the occluder meets one
    /// of the lamp.
    double mean(double film_half) const {
        const auto breaks = [&](double middle, double l, double o) {
            std::vector<double> at{middle - film_half, middle + film_half};
            const double s = scale();
            for (const int i : {-1, 1})
                for (const int j : {-1, 1})
                    if (const double x = (l + i * half - (o + j * occluder_half) * s) / (1 - s);
                        std::abs(x - middle) < film_half)
                        at.push_back(x);
            std::sort(at.begin(), at.end());
            return at;
        };
        static const Quadrature rule(16);
        const auto over = [&](const std::vector<double>& at, auto&& f) {
            double sum = 0;
            for (std::size_t k = 0; k + 1 < at.size(); ++k) {
                const double m = 0.5 * (at[k] + at[k + 1]), r = 0.5 * (at[k + 1] - at[k]);
                for (std::size_t i = 0; i < rule.at.size(); ++i) sum += r * rule.weight[i] * f(m + r * rule.at[i]);
            }
            return sum;
        };
        const auto xs = breaks(receiver.x, lamp.x, occluder.x), ys = breaks(receiver.y, lamp.y, occluder.y);
        return over(ys, [&](double y) { return over(xs, [&](double x) { return at(x, y); }); }) / sqr(2 * film_half);
    }
    /// Derivative of f when one part moves along an axis.
    template <class F>
    double rate(Vector3<double> Penumbra::*part, int axis, F&& f) const {
        constexpr double h = 1e-3;
        const auto value = [&](double step) {
            Penumbra moved = *this;
            (moved.*part)[axis] += step;
            return f(moved);
        };
        return (8 * (value(h) - value(-h)) - (value(2 * h) - value(-2 * h))) / (12 * h);
    }
};

std::string penumbra_scene(const Penumbra& p, double film_half) {
    std::string defaults;
    for (const char* name : {"ox", "oy", "oz", "lx", "ly", "lz", "rx", "ry", "rz"})
        defaults += fmt::format("<default name=\"{}\" value=\"0\"/>\n", name);
    const std::string black = R"(<bsdf type="diffuse"><rgb name="reflectance" value="0, 0, 0"/></bsdf>)";
    return fmt::format(
        R"(<scene version="3.0.0">{}<integrator type="path"><integer name="max_depth" value="2"/></integrator>
<sensor type="orthographic"><transform name="to_world"><scale x="{}" y="{}"/><lookat origin="{}, {}, 0.5" target="{}, {}, 0" up="0, 1, 0"/>
<translate x="$rx" y="$ry" z="$rz"/></transform>
<film type="hdrfilm"><integer name="width" value="8"/><integer name="height" value="8"/><rfilter type="box"/></film></sensor>
<shape type="rectangle" id="receiver"><transform name="to_world"><scale value="4"/><translate x="$rx" y="$ry" z="$rz"/></transform>
<bsdf type="diffuse"><rgb name="reflectance" value="1, 1, 1"/></bsdf></shape>
<shape type="rectangle" id="occluder"><transform name="to_world"><scale value="{}"/><translate z="1"/><translate x="$ox" y="$oy" z="$oz"/></transform>{}</shape>
<shape type="rectangle" id="lamp"><transform name="to_world"><scale value="{}"/><rotate x="1" angle="180"/><translate z="3"/><translate x="$lx" y="$ly" z="$lz"/></transform>{}
<emitter type="area"><rgb name="radiance" value="1, 1, 1"/></emitter></shape></scene>)",
        defaults, film_half, film_half, p.receiver.x, p.receiver.y, p.receiver.x, p.receiver.y, Penumbra::occluder_half,
        black, p.half, black);
}

struct Mover {
    const char* name;
    std::array<std::string, 3> parameters;
    Vector3<double> Penumbra::*part;
};
const Mover movers[] = {{"occluder", {"ox", "oy", "oz"}, &Penumbra::occluder},
                        {"lamp", {"lx", "ly", "lz"}, &Penumbra::lamp},
                        {"receiver", {"rx", "ry", "rz"}, &Penumbra::receiver}};

/// Means of the image's derivative by three parameters: interior, then boundaries by light points alone and by stored
/// vertices alone. [estimator][axis][replicate]
struct ByFamily {
    std::array<std::array<std::vector<double>, 3>, 3> means;

    ByFamily(const DerivableScene& scene, std::uint64_t spp, std::uint64_t n_light_points, int replicates) {
        app::Report report;
        report.set_quiet(true);
        for (int i = 0; i < replicates; ++i) {
            const PathGraph graph = trace_derivable(*scene.scene, spp, std::uint64_t(100 + i));
            const Derivative interior = differentiate(graph, scene, 0, {"primary", "direct", "indirect"});
            const derive::BoundaryOptions options{.seed = std::uint64_t(500 + i)};
            const derive::BoundaryScene boundary(graph, *scene.scene, scene.tangents, options);
            std::vector<derive::BoundaryRows> rows[3];
            std::vector<std::uint64_t> samples(n_boundary_families);
            const std::vector<char> all(scene.scene->emitters.size(), derive::reached_by::any);
            derive::add_vertex_light(boundary, 1, all, rows[1], samples, report);
            derive::add_edge_light(boundary, n_light_points, all, rows[2], samples, report);
            for (std::size_t axis = 0; axis < 3; ++axis) {
                const DerivedBins bins = bins_of(graph, &interior, one_bin(), axis);
                means[0][axis].push_back(mean_of(bins.steady));
                for (std::size_t f = 1; f < 3; ++f) {
                    double sum = 0;
                    for (const derive::BoundaryRows& part : rows[f])
                        for (std::size_t row = 0; row < part.pixel.size(); ++row)
                            sum += double(part.dL[(row * 3 + axis) * 3]);
                    means[f][axis].push_back(sum / double(graph.n_pixels()));
                }
            }
        }
    }
    Estimate total(std::size_t family, std::size_t axis) const {
        std::vector<double> sums = means[0][axis];
        for (std::size_t i = 0; i < sums.size(); ++i) sums[i] += means[family][axis][i];
        return estimate_of(sums);
    }
};

double z_of(const Estimate& e, double exact) {
    return e.mean == exact ? 0 : (e.mean - exact) / e.se;
}

// The point of DESIGN: (0.72, 0.31) below a lamp of half-width 0.3, each part moved by (1, 0.4, 0.3).
TEST(DerivativeClosedForm, PenumbraOfAPointHasKnownRates) {
    Penumbra p;
    p.receiver = {0.72, 0.31, 0};
    const std::array<double, 3> known{-0.0560014, 0.0202620, 0.0357395};
    for (std::size_t m = 0; m < 3; ++m) {
        double rate = 0;
        for (int axis = 0; axis < 3; ++axis)
            rate += (axis == 0   ? 1
                     : axis == 1 ? 0.4
                                 : 0.3) *
                    p.rate(movers[m].part, axis, [](const Penumbra& q) { return q.at_middle(); });
        EXPECT_NEAR(rate, known[m], 2e-7) << movers[m].name;
    }
}

// Vertices (family 1) and light points (family 2) against the overlap of two rectangles, for five lamp sizes. Standard
// errors are 0.1 to 5 % of the derivative but for the lamp along z, where two large shares cancel. Detected mutations:
// the eye's velocity without its factor 1 - s; edges at rest in front of a moving receiver not sampled.
TEST(DerivativeClosedForm, PenumbraAtFiveLampSizes) {
    constexpr double film_half = 0.2;
    const int replicates = 16;
    for (const double half : {0.3, 0.1, 0.03, 0.01, 0.003}) {
        Penumbra p;
        p.half = half;
        const SceneText text(penumbra_scene(p, film_half));
        for (const Mover& mover : movers) {
            const DerivableScene scene(text.file, {mover.parameters.begin(), mover.parameters.end()});
            const ByFamily ours(scene, full_run() ? 4096 : 128, full_run() ? 16384 : 1024, replicates);
            for (std::size_t axis = 0; axis < 3; ++axis) {
                const double exact =
                    p.rate(mover.part, int(axis), [&](const Penumbra& q) { return q.mean(film_half); });
                const double interior = estimate_of(ours.means[0][axis]).mean;
                std::printf("    half %.3f %-9s %c: exact %+.6e, interior %+.3e;", half, mover.name, "xyz"[axis], exact,
                            interior);
                for (const std::size_t family : {1, 2}) {
                    const Estimate e = ours.total(family, axis);
                    std::printf("  family %zu z %+.2f of %.1f %%", family, z_of(e, exact),
                                100 * e.se / std::abs(exact));
                    EXPECT_LT(std::abs(z_of(e, exact)), 4)
                        << half << " " << mover.name << " " << axis << " family " << family;
                }
                std::printf("\n");
            }
        }
    }
}

// ---- Plane lit from the pinhole -------------------------------------------------------------------------------------

// A plane at distance Z, the light at the pinhole: beyond the first arrival and within the film, sum over pixels of
// H(t) dt is a constant / (Z t^2) dt, so that dH/dZ = -H/Z.
TEST(DerivativeClosedForm, PlaneLitFromThePinhole) {
    const SceneText text(R"(<scene version="3.0.0"><default name="z" value="2"/>
<integrator type="path"><integer name="max_depth" value="2"/></integrator>
<sensor type="perspective"><float name="fov" value="90"/><transform name="to_world"><lookat origin="0, 0, 0" target="0, 0, 1" up="0, 1, 0"/></transform>
<film type="hdrfilm"><integer name="width" value="8"/><integer name="height" value="8"/><rfilter type="box"/></film></sensor>
<shape type="rectangle"><transform name="to_world"><scale value="50"/><rotate y="1" angle="180"/><translate z="$z"/></transform>
<bsdf type="diffuse"><rgb name="reflectance" value="1, 1, 1"/></bsdf></shape>
<emitter type="point"><point name="position" x="0" y="0" z="0"/><rgb name="intensity" value="1, 1, 1"/></emitter></scene>)");
    const DerivableScene scene(text.file, {"z"});
    // First arrival 4; the film holds rings up to 4 sqrt(2) = 5.66.
    TimeResponse response;
    response.n_bins = 18, response.start = 3.9, response.width = response.gate = 0.1;
    constexpr double distance = 2;
    const Pulse pulses[] = {Pulse::box(0.1), Pulse::gaussian(0.05), Pulse::delta()};
    const int replicates = 16;
    std::vector<std::vector<double>> value[3], sum[3];
    for (std::size_t j = 0; j < 3; ++j) value[j].resize(response.n_bins), sum[j].resize(response.n_bins);
    for (int i = 0; i < replicates; ++i) {
        const PathGraph graph = trace_derivable(*scene.scene, full_run() ? 65536 : 2048, std::uint64_t(100 + i));
        const Derivative d = differentiate(graph, scene, std::uint64_t(500 + i));
        for (std::size_t j = 0; j < 3; ++j) {
            response.pulse = pulses[j];
            const DerivedBins bins = bins_of(graph, &d, response);
            for (std::size_t k = 0; k < response.n_bins; ++k) {
                double v = 0, r = 0;
                for (std::size_t p = 0; p < bins.n_pixels; ++p) {
                    v += bins.value[3 * (p * response.n_bins + k)] / double(bins.n_pixels);
                    r += bins.derivative[3 * (p * response.n_bins + k)] / double(bins.n_pixels);
                }
                value[j][k].push_back(v), sum[j][k].push_back(r + v / distance);
            }
        }
    }
    for (std::size_t j = 0; j < 3; ++j) {
        response.pulse = pulses[j];
        double squares = 0, of_values = 0, largest = 0;
        int n = 0;
        for (std::size_t k = 0; k < response.n_bins; ++k) {
            const double open = response.start + double(k) * response.width, close = open + response.width;
            if (open < 4 + 0.3 || close > 5.3) continue;
            // H(t) = 1 / (Z t^2), seen through the pulse.
            double exact = 0;
            constexpr int steps = 7000;
            for (int s = 0; s < steps; ++s) {
                const double dt = (close - open + 0.6) / steps, t = open - 0.3 + (s + 0.5) * dt;
                exact += response.weight(std::int64_t(k), t) * dt / (distance * t * t);
            }
            const Estimate v = estimate_of(value[j][k]), zero = estimate_of(sum[j][k]);
            of_values += sqr((v.mean - exact) / v.se), squares += sqr(zero.mean / zero.se), ++n;
            largest = std::max(largest, zero.se / (exact / distance));
        }
        std::printf("    pulse %d: %d bins, chi^2 of values %.1f, of rates %.1f, SE at most %.1f %% of dH/dZ\n",
                    int(pulses[j].kind()), n, of_values, squares, 100 * largest);
        EXPECT_GT(chi_square_tail(of_values, n), 1e-3);
        EXPECT_GT(chi_square_tail(squares, n), 1e-3);
    }
}

// ---- A board in front of a lit ceiling ------------------------------------------------------------------------------

/// Irradiance from a convex polygon of radiance 1 in front of the origin, whose normal is z: half the sum over edges of
/// angle times normal.                                                                    [Lambert] Photometria (1760)
double lambert(const std::vector<Vector3<double>>& corners) {
    double sum = 0;
    for (std::size_t k = 0; k < corners.size(); ++k) {
        const Vector3<double> a = normalize(corners[k]), b = normalize(corners[(k + 1) % corners.size()]);
        const Vector3<double> n = cross(a, b);
        sum += std::atan2(length(n), dot(a, b)) * n.z / length(n);
    }
    return std::abs(sum) / 2;
}

// A point sees a ceiling that the sun lights evenly, and a black board in front of it: all of the derivative is light of
// a surface beside edges. A tenth of it lost is 20 and 40 standard errors by turn and z.
TEST(DerivativeClosedForm, BoardInFrontOfALitCeiling) {
    const SceneText text(
        R"(<scene version="3.0.0"><default name="x" value="0"/><default name="z" value="0"/><default name="turn" value="30"/>
<integrator type="path"><integer name="max_depth" value="3"/></integrator>
<sensor type="perspective"><float name="fov" value="0.05"/><transform name="to_world"><lookat origin="3, 0, 1" target="0, 0, 0" up="0, 0, 1"/></transform>
<film type="hdrfilm"><integer name="width" value="4"/><integer name="height" value="4"/><rfilter type="box"/></film></sensor>
<bsdf type="diffuse" id="white"><rgb name="reflectance" value="1, 1, 1"/></bsdf>
<bsdf type="twosided" id="black"><bsdf type="diffuse"><rgb name="reflectance" value="0, 0, 0"/></bsdf></bsdf>
<shape type="rectangle"><transform name="to_world"><scale value="0.05"/></transform><ref id="white"/></shape>
<shape type="rectangle"><transform name="to_world"><rotate x="1" angle="180"/><translate z="2"/></transform><ref id="white"/></shape>
<shape type="rectangle"><transform name="to_world"><scale value="0.2"/><rotate y="1" angle="$turn"/><translate x="0.25" y="0.05" z="1"/><translate x="$x" z="$z"/></transform><ref id="black"/></shape>
<emitter type="directional"><vector name="direction" x="2" y="0" z="1"/><rgb name="irradiance" value="1, 1, 1"/></emitter></scene>)");
    const double ceiling = 1 / (pi_double * std::sqrt(5.0));  // its radiance
    const auto seen = [&](double x, double z, double turn) {
        const auto corner = [&](double a, double b) {
            const double c = std::cos(turn * pi_double / 180), s = std::sin(turn * pi_double / 180);
            return Vector3<double>{0.25 + x + 0.2 * a * c, 0.05 + 0.2 * b, 1 + z - 0.2 * a * s};
        };
        return ceiling / pi_double *
               (lambert({{-1, -1, 2}, {1, -1, 2}, {1, 1, 2}, {-1, 1, 2}}) -
                lambert({corner(-1, -1), corner(1, -1), corner(1, 1), corner(-1, 1)}));
    };
    constexpr double h = 1e-4;
    const std::array<double, 3> exact = {(seen(h, 0, 30) - seen(-h, 0, 30)) / (2 * h),
                                         (seen(0, h, 30) - seen(0, -h, 30)) / (2 * h),
                                         (seen(0, 0, 30 + h) - seen(0, 0, 30 - h)) / (2 * h)};
    const DerivableScene scene(text.file, {"x", "z", "turn"});
    std::array<std::vector<double>, 3> rates;
    std::vector<double> value;
    for (int i = 0; i < 16; ++i) {
        const PathGraph graph = trace_derivable(*scene.scene, full_run() ? 32768 : 4096, std::uint64_t(40 + i));
        const Derivative d = differentiate(graph, scene, std::uint64_t(80 + i));
        for (std::size_t p = 0; p < 3; ++p) {
            const DerivedBins bins = bins_of(graph, &d, one_bin(), p);
            rates[p].push_back(mean_of(bins.steady));
            if (p == 0) value.push_back(mean_of(bins.steady_value));
        }
    }
    const Estimate v = estimate_of(value);
    EXPECT_LT(std::abs(v.mean - seen(0, 0, 30)), 4 * v.se);
    for (std::size_t p = 0; p < 3; ++p) {
        const Estimate e = estimate_of(rates[p]);
        std::printf("    %-5s %+.5g +- %.2g of %+.5g (%+.1f SE; a tenth is %.0f SE)\n",
                    scene.tangents.parameters[p].name.c_str(), e.mean, e.se, exact[p], (e.mean - exact[p]) / e.se,
                    0.1 * std::abs(exact[p]) / e.se);
        EXPECT_LT(std::abs(e.mean - exact[p]), 4 * e.se);
        // By x, two edges nearly cancel.
        EXPECT_GT(0.1 * std::abs(exact[p]), (p == 0 ? 2 : 10) * e.se);
    }
}

// ---- Furnace --------------------------------------------------------------------------------------------------------

// All surfaces emit 0.5 and reflect 0.5: the radiance is 1 everywhere, wherever the mover is.
TEST(DerivativeClosedForm, FurnaceDoesNotNoticeAMover) {
    const std::string grey = R"(<bsdf type="diffuse"><rgb name="reflectance" value="0.5, 0.5, 0.5"/></bsdf>
<emitter type="area"><rgb name="radiance" value="0.5, 0.5, 0.5"/></emitter>)";
    const SceneText text(fmt::format(
        R"(<scene version="3.0.0"><default name="x" value="0"/><default name="turn" value="20"/><default name="camera" value="0"/>
<integrator type="path"><integer name="max_depth" value="8"/></integrator>
<sensor type="perspective"><float name="fov" value="40"/><transform name="to_world"><lookat origin="0, -0.9, 0.2" target="0, 0, 0" up="0, 0, 1"/><translate x="$camera"/></transform>
<film type="hdrfilm"><integer name="width" value="8"/><integer name="height" value="8"/><rfilter type="box"/></film></sensor>
<shape type="cube" id="room"><boolean name="flip_normals" value="true"/>{}</shape>
<shape type="cube" id="mover"><transform name="to_world"><scale value="0.2"/><rotate x="1" y="0.3" z="1" angle="$turn"/><translate x="0.1" y="0.2" z="-0.1"/><translate x="$x"/></transform>{}</shape></scene>)",
        grey, grey));
    for (const char* wrt : {"shape:mover/pose", "camera"}) {
        const DerivableScene scene(text.file, {wrt});
        const std::size_t n = scene.tangents.n();
        struct Shares {
            std::vector<double> total, interior;
            std::array<std::vector<double>, n_boundary_families> family;
        };
        std::vector<Shares> shares(n);
        for (int i = 0; i < 16; ++i) {
            const PathGraph graph = trace_derivable(*scene.scene, full_run() ? 4096 : 128, std::uint64_t(100 + i));
            const Derivative d = differentiate(graph, scene, std::uint64_t(500 + i));
            for (std::size_t p = 0; p < n; ++p) {
                const DerivedBins bins = bins_of(graph, &d, one_bin(), p);
                // A quarter of the image: over the whole of it, shares may cancel.
                const auto share = [](const std::vector<double>& image) {
                    double sum = 0;
                    for (std::size_t pixel = 0; pixel < 64; ++pixel)
                        if (pixel % 8 < 4 && pixel / 8 < 4) sum += image[3 * pixel] / 16;
                    return sum;
                };
                shares[p].total.push_back(share(bins.steady));
                shares[p].interior.push_back(share(bins.steady_without(all_edges)));
                for (std::size_t f = 0; f < n_boundary_families; ++f)
                    shares[p].family[f].push_back(share(bins.steady_boundary[f]));
            }
        }
        for (std::size_t p = 0; p < n; ++p) {
            const Estimate e = estimate_of(shares[p].total), inner = estimate_of(shares[p].interior);
            std::printf("    %-20s total %+.5f +- %.5f; interior %+.5f (%+.1f SE); boundary",
                        scene.tangents.parameters[p].name.c_str(), e.mean, e.se, inner.mean,
                        inner.se > 0 ? inner.mean / inner.se : 0);
            for (const auto& f : shares[p].family) {
                const Estimate b = estimate_of(f);
                std::printf(" %+.5f (%+.1f)", b.mean, b.se > 0 ? b.mean / b.se : 0);
            }
            std::printf("\n");
            EXPECT_LT(std::abs(e.mean), 3 * e.se) << scene.tangents.parameters[p].name;
            // The power: what is 0 in sum is not 0 in its shares.
            if (scene.tangents.parameters[p].name == "shape:mover/pose.y") {
                EXPECT_GT(inner.mean, (full_run() ? 20 : 10) * inner.se);
            }
        }
    }
}

// ---- Hidden geometry ------------------------------------------------------------------------------------------------

// The Z of METHODS: a letter [-0.4, 0.4]^2 in front of a relay wall, one sensor point and one laser spot. The wall is
// smaller than there so that its middle is the sensor point.
TEST(DerivativeClosedForm, HiddenLetterInEachBin) {
    const auto mesh = testing::scratch_file(".obj");
    std::ofstream(mesh) << R"(v 0.364878 0.296774 0
v -0.164553 0.296774 0
v -0.4 0.4 0
v 0.364878 0.4 0
v 0.4 -0.4 0
v 0.164553 -0.296774 0
v -0.4 -0.296774 0
v -0.4 -0.4 0
f 1 3 4
f 1 2 3
f 2 6 3
f 5 6 2
f 5 7 6
f 5 8 7
)";
    const SceneText text(fmt::format(
        R"(<scene version="3.0.0"><default name="z" value="0.996"/><integrator type="transient_nlos_path"><integer name="max_depth" value="4"/>
<boolean name="nlos_laser_sampling" value="true"/><boolean name="nlos_hidden_geometry_sampling" value="true"/>
<string name="temporal_filter" value="box"/><string name="capture_type" value="single"/></integrator>
<shape type="obj"><string name="filename" value="{}"/><transform name="to_world"><translate z="$z"/></transform>
<bsdf type="twosided"><bsdf type="diffuse"><rgb name="reflectance" value="1, 1, 1"/></bsdf></bsdf></shape>
<emitter type="projector"><rgb name="irradiance" value="100, 100, 100"/><float name="fov" value="0.2"/>
<transform name="to_world"><lookat origin="-0.5, 0, 0.25" target="0, 0, 0" up="0, 1, 0"/></transform></emitter>
<shape type="rectangle"><transform name="to_world"><scale value="0.7"/><translate x="-0.640625" y="-0.640625"/></transform>
<bsdf type="diffuse"><rgb name="reflectance" value="1, 1, 1"/></bsdf>
<sensor type="nlos_capture_meter"><point name="sensor_origin" x="-0.5" y="0" z="0.25"/><film type="transient_hdr_film">
<integer name="width" value="1"/><integer name="height" value="1"/><integer name="temporal_bins" value="200"/>
<float name="bin_width_opl" value="0.006"/><float name="start_opl" value="1.85"/><rfilter type="box"/></film></sensor></shape></scene>)",
        mesh.string()));
    const DerivableScene scene(text.file, {"z"});
    std::filesystem::remove(mesh);
    TimeResponse response = film_response(*scene.scene);
    response.pulse = Pulse::box(0.006);
    struct Bin {
        std::size_t k;
        double value, rate, tolerance;  // 0.004 is that of the table
    };
    const Bin known[] = {{56, 0.02274, -20.894, 0.004}, {57, 0.08114, 3.644, 0.004}, {58, 0.03230, 10.347, 0.004},
                         {76, 0.00906, -1.77, 0.006},   {89, 0.02091, 1.109, 0.004}, {124, 0.0053, 0.333, 0.004}};
    std::vector<std::vector<double>> value(200), rate(200);
    std::vector<double> sums, values;
    const int replicates = 16;
    for (int i = 0; i < replicates; ++i) {
        const PathGraph graph = trace_derivable(*scene.scene, full_run() ? 1 << 20 : 1 << 16, std::uint64_t(100 + i));
        const Derivative d = differentiate(graph, scene, std::uint64_t(500 + i));
        const DerivedBins bins = bins_of(graph, &d, response, 0, {scene.scene->transient.camera_segment});
        sums.push_back(bins.steady[0]), values.push_back(bins.steady_value[0]);
        for (std::size_t k = 0; k < 200; ++k)
            value[k].push_back(bins.value[3 * k]), rate[k].push_back(bins.derivative[3 * k]);
    }
    const Estimate sum = estimate_of(sums), total = estimate_of(values);
    std::printf("    sum %.6f +- %.6f of 0.883112, d/dz %.5f +- %.5f of -1.754916\n", total.mean, total.se, sum.mean,
                sum.se);
    EXPECT_LT(std::abs(total.mean - 0.883112), 3 * total.se + 1e-6);
    EXPECT_LT(std::abs(sum.mean + 1.754916), 3 * sum.se + 1e-6);
    for (const Bin& bin : known) {
        const Estimate v = estimate_of(value[bin.k]), r = estimate_of(rate[bin.k]);
        std::printf("    bin %3zu: value %.5f +- %.5f of %.5f; d/dz %.3f +- %.3f of %.3f\n", bin.k, v.mean, v.se,
                    bin.value, r.mean, r.se, bin.rate);
        EXPECT_LT(std::abs(v.mean - bin.value), 3 * v.se + 1e-5) << bin.k;
        EXPECT_LT(std::abs(r.mean - bin.rate), 3 * r.se + bin.tolerance) << bin.k;
    }
}

}  // namespace
}  // namespace loom
