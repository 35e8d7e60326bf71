// Rows of whole derivatives: sums of parameters, columns of few and many, threads, parts left out, lengths.
#include <gtest/gtest.h>

#include <cmath>
#include <cstring>

#include "stages/core/graph/time_of_flight.h"
#include "stages/derive/interior.h"
#include "tests/unit/derive_scenes.h"

namespace loom::derive {
namespace {

using testing::add_parameter;
using testing::any_motion;

Derivative derivative_of(const PathGraph& g, const Scene& scene, const SceneTangents& t,
                         const std::vector<std::string>& off = {}, int threads = 0) {
    app::Report report;
    report.set_quiet(true);
    DeriveCounts counts;
    return differentiate(g, scene, t, required_parts(scene, g, t, off), {1, 7, threads}, report, counts);
}

PathGraph graph_of(const Scene& scene, std::uint64_t spp) {
    return testing::trace_graph(scene, testing::path_options(scene, 9), spp, 0, testing::derive_columns);
}

/// Motions of all shapes, of the camera and of materials, one column each; `of` chooses among them.
SceneTangents columns(const Scene& scene, const std::vector<unsigned>& of) {
    SceneTangents t(scene);
    for (const unsigned k : of) {
        const std::uint32_t p = add_parameter(t, fmt::format("{}", k));
        if (k == 0) {
            t.camera.push_back({p, any_motion(1)});
        } else if (k == 1) {
            MaterialTangent m;
            m.diffuse = {0.5, 1, 0.3}, m.alpha_u = m.alpha_v = 0.4, m.eta = m.int_ior = 0.2;
            for (auto& effects : t.materials) effects.push_back({p, m});
        } else {
            for (std::uint32_t s = 0; s < scene.shapes.size(); ++s) t.shapes[s].push_back({p, any_motion(20 * k + s)});
        }
    }
    return t;
}

template <class T>
bool same_bytes(const Column<T>& a, const Column<T>& b) {
    return a.size() == b.size() && (a.empty() || std::memcmp(a.data(), b.data(), a.size() * sizeof(T)) == 0);
}

/// Rows of light edges, 0 where there is none.
std::vector<float> column_of(const Derivative& d, std::size_t parameter, bool light) {
    const std::size_t n = d.n_parameters(), channels = light ? 3 : 1;
    std::vector<float> values(d.n_light_edges * channels);
    const Column<float>& from = light ? d.interior.dL : d.interior.dopl;
    for (std::size_t i = 0; i < d.interior.edge.size(); ++i)
        for (std::size_t c = 0; c < channels; ++c)
            values[d.interior.edge[i] * channels + c] = from[(i * n + parameter) * channels + c];
    return values;
}

// The walk pads parameters to 1, 2, 3, 4, 8, 16 and 64: none of it may show.
TEST(DeriveRows, ColumnsDependOnNoOtherParameter) {
    const auto scene = testing::load_room(testing::area_lights);
    const PathGraph g = graph_of(*scene, 4);
    const std::vector<std::string> no_boundary{"primary", "direct", "indirect"};
    std::vector<unsigned> all(20);
    for (unsigned k = 0; k < 20; ++k) all[k] = k;
    const Derivative d20 = derivative_of(g, *scene, columns(*scene, all), no_boundary);
    for (const std::vector<unsigned>& of :
         std::vector<std::vector<unsigned>>{{0}, {1}, {2}, {2, 0, 1}, {7, 6, 5, 4, 3, 2, 1, 0}}) {
        const Derivative d = derivative_of(g, *scene, columns(*scene, of), no_boundary);
        for (std::size_t p = 0; p < of.size(); ++p)
            for (const bool light : {false, true})
                EXPECT_EQ(column_of(d, p, light), column_of(d20, of[p], light)) << of.size() << " " << of[p];
    }
}

TEST(DeriveRows, ParametersAddUp) {
    const auto scene = testing::load_room(testing::area_lights);
    const PathGraph g = graph_of(*scene, 4);
    SceneTangents t = columns(*scene, {0, 1, 2, 3});
    const std::uint32_t sum = add_parameter(t, "sum");
    const auto add = [&](auto& effects) {
        const auto before = effects;
        for (const auto& [p, effect] : before) effects.push_back({sum, effect});
    };
    for (auto& effects : t.shapes) add(effects);
    for (auto& effects : t.materials) add(effects);
    add(t.camera);
    const Derivative d = derivative_of(g, *scene, t);
    const std::size_t n = t.n();
    const auto check = [&](const Column<float>& values, std::size_t channels) {
        for (std::size_t row = 0; row < values.size() / (n * channels); ++row)
            for (std::size_t c = 0; c < channels; ++c) {
                double total = 0, size = 0;
                for (std::size_t p = 0; p + 1 < n; ++p) {
                    const double x = values[(row * n + p) * channels + c];
                    total += x, size += std::abs(x);
                }
                EXPECT_NEAR(values[(row * n + sum) * channels + c], total, 1e-6 * size) << row;
            }
    };
    ASSERT_GT(d.interior.edge.size(), 500u);
    check(d.interior.dL, 3), check(d.interior.dopl, 1);
    check(d.seen.dLe, 3), check(d.seen.dopl, 1);
    ASSERT_GT(d.boundary.pixel.size(), 100u);
    check(d.boundary.dL, 3);
}

// Boundary samples choose edges by the speeds of all parameters together, so only the mean of a column is the same.
// Power: the means differ by 3.5 standard errors where one is off by half of its size.
TEST(DeriveRows, BoundaryMeansDependOnNoOtherParameter) {
    const auto scene = testing::own_scene("edits.xml", 12, 12);
    const PathGraph g = graph_of(*scene, 128);
    std::uint32_t mover = 0;
    while (scene->shapes[mover].emitter_idx >= 0 || scene->shapes[mover].kind != ShapeKind::mesh ||
           scene->shapes[mover].mesh.n_triangles() < 12)
        ++mover;
    const auto tangents = [&](bool others) {
        SceneTangents t(*scene);
        AffineVelocity v;
        v.offset = {1, 0.3, -0.2};
        t.shapes[mover].push_back({add_parameter(t, "x"), v});
        if (others)
            for (unsigned k = 0; k < 7; ++k)
                t.shapes[(mover + k) % scene->shapes.size()].push_back(
                    {add_parameter(t, fmt::format("{}", k)), any_motion(50 + k)});
        return t;
    };
    /// Sum over all pixels of the first column, and the variance of that sum by samples.
    const auto sum_of = [&](const Derivative& d) {
        std::map<std::pair<int, std::uint64_t>, double> by_sample;
        const std::size_t n = d.n_parameters();
        for (std::size_t i = 0; i < d.boundary.pixel.size(); ++i)
            by_sample[{d.boundary.family[i], d.boundary.sample[i]}] += double(d.boundary.dL[3 * n * i + 1]);
        double sum = 0, squares = 0;
        for (const auto& [sample, x] : by_sample) sum += x, squares += x * x;
        return std::pair{sum, squares};
    };
    const auto [one, var_one] = sum_of(derivative_of(g, *scene, tangents(false), {"interior"}));
    const auto [many, var_many] = sum_of(derivative_of(g, *scene, tangents(true), {"interior"}));
    const double error = std::sqrt(var_one + var_many);
    EXPECT_LT(std::abs(one - many), 3.5 * error);
}

TEST(DeriveRows, ThreadsChangeNothing) {
    for (const char* lights : {testing::area_lights, testing::delta_lights}) {
        const auto scene = testing::load_room(lights, 24, 20);
        // More paths than a chunk of them.
        const PathGraph g = graph_of(*scene, 24);
        const SceneTangents t = columns(*scene, {0, 1, 2});
        const Derivative a = derivative_of(g, *scene, t, {}, 1), b = derivative_of(g, *scene, t, {}, 2);
        EXPECT_TRUE(same_bytes(a.interior.edge, b.interior.edge));
        EXPECT_TRUE(same_bytes(a.interior.dL, b.interior.dL));
        EXPECT_TRUE(same_bytes(a.interior.dopl, b.interior.dopl));
        EXPECT_TRUE(same_bytes(a.seen.path, b.seen.path));
        EXPECT_TRUE(same_bytes(a.seen.dLe, b.seen.dLe));
        EXPECT_TRUE(same_bytes(a.seen.dopl, b.seen.dopl));
        EXPECT_TRUE(same_bytes(a.boundary.pixel, b.boundary.pixel));
        EXPECT_TRUE(same_bytes(a.boundary.opl, b.boundary.opl));
        EXPECT_TRUE(same_bytes(a.boundary.camera_opl, b.boundary.camera_opl));
        EXPECT_TRUE(same_bytes(a.boundary.dL, b.boundary.dL));
        EXPECT_TRUE(same_bytes(a.boundary.family, b.boundary.family));
        EXPECT_TRUE(same_bytes(a.boundary.sample, b.boundary.sample));
        EXPECT_TRUE(same_bytes(a.boundary_samples, b.boundary_samples));
    }
}

TEST(DeriveRows, PartsAreLeftOut) {
    const auto scene = testing::load_room(testing::area_lights);
    const PathGraph g = graph_of(*scene, 8);
    const SceneTangents t = columns(*scene, {2});
    const Derivative all = derivative_of(g, *scene, t);
    const std::vector<std::string> parts{"interior", "primary", "direct", "indirect"};
    for (const std::string& part : parts) {
        const Derivative d = derivative_of(g, *scene, t, {part});
        std::array<std::size_t, n_boundary_families> n{};
        for (const std::uint8_t family : d.boundary.family) ++n[family];
        EXPECT_EQ(d.interior.edge.empty(), part == "interior") << part;
        EXPECT_EQ(n[0] == 0, part == "primary") << part;
        EXPECT_EQ(n[1] + n[2] + n[4] == 0, part == "direct") << part;
        EXPECT_EQ(n[3] == 0, part == "indirect") << part;
        // Those that stay are the same.
        if (part != "interior") {
            EXPECT_TRUE(same_bytes(d.interior.dL, all.interior.dL)) << part;
        }
    }
    const std::string missed =
        "silhouettes in mirrors and clear glass, terminators of smooth normals beyond the first hit";
    EXPECT_EQ(
        required_parts(*scene, g, t, {}).plan,
        "on: interior, primary, direct, indirect; off: media (no index of refraction changes); not sampled: " + missed);
    EXPECT_EQ(required_parts(*scene, g, t, {"direct", "interior"}).plan,
              "on: primary, indirect; off: interior (--off), direct (--off), media (no index of refraction changes); "
              "not sampled: " +
                  missed);
    EXPECT_EQ(required_parts(*scene, g, columns(*scene, {1}), {}).plan,
              "on: interior, media; off: primary (nothing moves), direct (nothing moves), indirect (nothing moves)");
    SceneTangents light(*scene);
    light.emitters[0].push_back({add_parameter(light, "light"), any_motion(1)});
    EXPECT_EQ(required_parts(*scene, g, light, {}).plan,
              "on: interior, direct; off: primary (only lights move), indirect (only lights move), media (no index of "
              "refraction changes); not sampled: " +
                  missed);
    EXPECT_EQ(required_parts(*scene, g, t, {"primary", "direct", "indirect"}).not_sampled, "");
    Scene lamp;
    lamp.emitters.emplace_back();
    EXPECT_EQ(required_parts(lamp, g, t, {}).not_sampled, "");
    lamp.emitters[0].kind = EmitterKind::spot;
    lamp.emitters[0].cutoff_rad = 0.5f;
    lamp.emitters[0].beam_rad = 0.4f;
    EXPECT_EQ(required_parts(lamp, g, t, {}).not_sampled, "");
    lamp.emitters[0].beam_rad = 0.5f;
    EXPECT_EQ(required_parts(lamp, g, t, {}).not_sampled, "sharp borders of beams");
}

// The camera's share of boundary lengths: along the stored path for samples of paths; for the others known from an
// orthographic view of a floor 3 m below with a square 1 m above it.
// Detected mutations: the length of the segment after it; that of the whole path to the vertex; the far side's for the
// near one's.
TEST(DeriveRows, CameraShareOfBoundaryLengths) {
    for (const bool point : {false, true}) {
        const auto scene = testing::load_inline(
            {R"(type="orthographic"><transform name="to_world"><lookat origin="0, 0, 3" target="0, 0, 0" up="0, 1, 0"/></transform>)",
             std::string(
                 R"(<shape type="rectangle" id="floor"><transform name="to_world"><scale x="3" y="3"/></transform></shape>
<shape type="rectangle" id="square"><transform name="to_world"><scale x="0.3" y="0.3"/><translate x="-0.3" z="1"/></transform><bsdf type="twosided"><bsdf type="diffuse"/></bsdf></shape>
<shape type="rectangle" id="wall"><transform name="to_world"><scale x="3" y="3"/><rotate y="1" angle="-90"/><translate x="1.5"/></transform></shape>)") +
                 (point
                      ? R"(<emitter type="point"><point name="position" x="0.4" y="0.2" z="2.5"/></emitter>)"
                      : R"(<shape type="rectangle"><transform name="to_world"><scale x="0.2" y="0.2"/><rotate y="1" angle="180"/><translate x="1.2" z="2.5"/></transform><emitter type="area"/></shape>)"),
             16, 16, point ? 2 : 4});
        const PathGraph g = graph_of(*scene, 512);
        SceneTangents t(*scene);
        const auto square = std::find_if(scene->shapes.begin(), scene->shapes.end(),
                                         [](const Shape& shape) { return shape.id == "square"; });
        t.shapes[std::size_t(square - scene->shapes.begin())].push_back(
            {add_parameter(t, "x"), testing::rigid_motion({}, {1, 0.2, 0})});
        const Derivative d = derivative_of(g, *scene, t);
        EXPECT_EQ(d.problem(), "");
        const OpticalLengths lengths(g, {});
        std::array<std::size_t, n_boundary_families> n{}, n_near{};
        for (std::size_t i = 0; i < d.boundary.pixel.size(); ++i) {
            const std::size_t family = d.boundary.family[i];
            const double opl = d.boundary.camera_opl[i];
            ++n[family], n_near[family] += std::size_t(opl < 2.5);
            if (family != 0 && family != 2) {
                EXPECT_NEAR(opl, lengths.from_camera(d.boundary.sample[i]), 1e-6) << i;
            } else {
                EXPECT_NEAR(opl, opl < 2.5 ? 2 : 3, 1e-4) << i << " " << family;
                // From the square to the point light are less than 2 m, from the floor at least 2.5 m.
                if (point && family == 0) {
                    EXPECT_EQ(d.boundary.opl[i] - opl < 2.25, opl < 2.5) << i;
                }
            }
        }
        EXPECT_GT(n[0], 200u);
        EXPECT_GT(n_near[0], n[0] / 5);
        EXPECT_GT(n[0] - n_near[0], n[0] / 5);
        EXPECT_GT(point ? n[2] : n[1] + n[4], 20u);
        EXPECT_GT(point ? n[2] : n[3], 20u);
    }
}

// Hidden emitters: the camera does not see them, so that their radiance and motion leave the directly visible light.
TEST(DeriveRows, HiddenEmittersAreNotSeen) {
    for (const bool hidden : {false, true}) {
        const auto file = testing::scratch_file(".xml");
        std::ofstream(file) << fmt::format(
            R"(<scene version="3.0.0"><integrator type="path"><boolean name="hide_emitters" value="{}"/></integrator>
<sensor type="perspective"><transform name="to_world"><lookat origin="0, 0, 3" target="0, 0, 0" up="0, 1, 0"/></transform>
<film type="hdrfilm"><integer name="width" value="12"/><integer name="height" value="12"/><rfilter type="box"/></film></sensor>
<shape type="rectangle" id="wall"><transform name="to_world"><scale x="3" y="3"/><translate z="-1"/></transform></shape>
<shape type="rectangle" id="lamp"><transform name="to_world"><scale x="0.5" y="0.5"/></transform><emitter type="area"><rgb name="radiance" value="2"/></emitter></shape>
<shape type="rectangle" id="lamp2"><transform name="to_world"><scale x="0.5" y="0.5"/><rotate x="1" angle="180"/><translate x="1.5" z="0.5"/></transform><emitter type="area"><rgb name="radiance" value="2"/></emitter></shape></scene>)",
            hidden);
        const auto scene = load_scene(file);
        std::filesystem::remove(file);
        const PathGraph g = graph_of(*scene, 16);
        SceneTangents t(*scene);
        const std::uint32_t p = add_parameter(t, "radiance");
        for (auto& effects : t.radiance) effects.push_back({p, {1, 1, 1}});
        const Derivative d = derivative_of(g, *scene, t);
        double seen = 0;
        for (const float x : d.seen.dLe) seen += double(x);
        EXPECT_GT(d.interior.edge.size(), 100u);
        EXPECT_EQ(seen > 0, !hidden);
    }
}

}  // namespace
}  // namespace loom::derive
