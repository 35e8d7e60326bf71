// Motions of the whole scene, camera and lights included: nothing that a pixel receives changes, and with all lengths
// all arrival times grow. Row by row, without statistics.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "stages/core/graph/time_of_flight.h"
#include "stages/derive/boundary.h"
#include "stages/derive/interior.h"
#include "tests/unit/derive_scenes.h"

namespace loom::derive {
namespace {

using testing::add_parameter;
using testing::rigid_motion;
using Vec = Vector3<double>;
using Pt = Point3<double>;

struct Case {
    std::string name;
    std::unique_ptr<Scene> scene;
};

std::vector<Case> cases() {
    std::vector<Case> all;
    all.push_back({"area lights", testing::load_room(testing::area_lights)});
    all.push_back({"delta lights", testing::load_room(testing::delta_lights)});
    all.push_back({"sky", testing::load_room(testing::sky())});
    all.push_back({"orthographic", testing::load_room(testing::area_lights, 12, 10, 6,
                                                      R"(type="orthographic">
<transform name="to_world"><scale x="0.9" y="0.9"/><lookat origin="0.1, 0.05, 3.6" target="0, -0.1, 0" up="0, 1, 0"/></transform>)")});
    for (const char* name : {"all-emitters.xml", "caustic.xml", "glossy-box.xml", "mirror-corridor.xml", "slab.xml",
                             "textured.xml", "mask.xml", "environment-map.xml", "edits.xml"})
        all.push_back({name, testing::own_scene(name, 12, 10)});
    return all;
}

/// Calls f(edge or none, L, opl, row) for each row with a derivative and the light to which it belongs.
template <class OnEdge, class OnSeen>
void each_row(const PathGraph& g, const Scene& scene, const SceneTangents& t, OnEdge&& on_edge, OnSeen&& on_seen,
              const Attached& attached = {}) {
    ASSERT_EQ(missing_columns(g, scene, t, attached), "");
    const InteriorWalker walker(g, scene, t, attached);
    const GraphReader reader(g);
    const OpticalLengths lengths(g, {});
    std::size_t edge = 0, walked = 0;
    for (std::size_t path = 0; path < g.n_paths(); ++path) {
        std::vector<std::pair<Spectrum, double>> lights;
        const std::size_t first = edge;
        Spectrum Le;
        double seen_opl = 0;
        walk_edges_in_time(
            reader, lengths, path, edge, [&](const Spectrum& L, double opl) { Le = L, seen_opl = opl; },
            [&](std::size_t, const Spectrum& L, double opl) { lights.emplace_back(L, opl); });
        ASSERT_TRUE(walker.touches(path));
        walker.walk(
            path, walked,
            [&](const InteriorRow& row) {
                const auto& [L, opl] = lights.at(row.row - first);
                on_edge(row, L, opl);
            },
            [&](const InteriorRow& row) { on_seen(row, Le, seen_opl); });
        ASSERT_EQ(walked, edge);
    }
}

/// Moves everything as one, then each shape, emitter and the camera alone, by parameters of their own: they give the size
/// of the terms that must cancel.
SceneTangents everything_then_each(const Scene& scene, const AffineVelocity& together) {
    SceneTangents t(scene);
    testing::move_everything(t, scene, add_parameter(t, "everything"), together);
    unsigned seed = 1;
    const auto alone = [&](Effects<AffineVelocity>& effects) {
        effects.push_back({add_parameter(t, fmt::format("alone {}", seed)), testing::any_motion(seed)});
        ++seed;
    };
    for (auto& shape : t.shapes) alone(shape);
    for (std::size_t e = 0; e < scene.emitters.size(); ++e)
        if (scene.emitters[e].kind != EmitterKind::area) alone(t.emitters[e]);
    alone(t.camera);
    return t;
}

/// Sizes of the first column and of all others together, over the channels.
struct Sizes {
    double first = 0, others = 0;
    Sizes(std::span<const float> values, std::size_t channels) {
        for (std::size_t i = 0; i < values.size(); ++i) (i < channels ? first : others) += std::abs(double(values[i]));
    }
};

double size(const Spectrum& c) {
    return double(std::abs(c[0])) + double(std::abs(c[1])) + double(std::abs(c[2]));
}

/// Terms that cancel are computed from directions in float.
constexpr double rounding = 2e-5;

// Detected mutations: a shading frame that does not turn about its normal, or the other way, in either direction of the
// change of frame; a point light that stays.
TEST(DeriveRigid, LightStaysWhenEverythingMovesAsOne) {
    for (const Case& c : cases()) {
        SCOPED_TRACE(c.name);
        const PathGraph g =
            testing::trace_graph(*c.scene, testing::path_options(*c.scene, 3), 16, 0, testing::derive_columns);
        const SceneTangents t = everything_then_each(*c.scene, rigid_motion({0.5, -0.8, 0.3}, {0.2, -0.7, 0.4}));
        std::size_t n_rows = 0, n_moving = 0;
        const auto check = [&](const InteriorRow& row, const Spectrum& L, double opl) {
            const Sizes light(row.dL, 3), length(row.dopl, 1);
            ++n_rows, n_moving += std::size_t(light.others > 0.1 * size(L));
            EXPECT_LE(light.first, rounding * (size(L) + light.others)) << row.row;
            EXPECT_LE(length.first, rounding * ((std::isfinite(opl) ? opl : 0) + length.others)) << row.row;
        };
        for (const double reach : {0.0, 0.5, double(INFINITY)})
            each_row(g, *c.scene, t, check, check, {std::vector<double>(c.scene->shapes.size(), reach)});
        // Lights alone at infinity, and walls that fill the view, move nothing.
        EXPECT_GT(n_rows, 1200u);
        if (c.name != "mirror-corridor.xml" && c.name != "slab.xml") {
            EXPECT_GT(n_moving, n_rows / 10);
        }
    }
}

TEST(DeriveRigid, AllLengthsGrowTogether) {
    AffineVelocity growth;
    const Vec about{0.3, -0.2, 0.5};
    growth.linear = {1, 0, 0, 0, 1, 0, 0, 0, 1};
    growth.offset = -about;
    for (const Case& c : cases()) {
        SCOPED_TRACE(c.name);
        const PathGraph g =
            testing::trace_graph(*c.scene, testing::path_options(*c.scene, 4), 16, 0, testing::derive_columns);
        const SceneTangents t = everything_then_each(*c.scene, growth);
        std::size_t n_lengths = 0;
        const auto check = [&](const InteriorRow& row, const Spectrum&, double opl) {
            if (!std::isfinite(opl)) return;
            ++n_lengths;
            const Sizes length(row.dopl, 1);
            // Delta lobes fold the error of their directions in.
            EXPECT_NEAR(row.dopl[0], opl, 1e-6 * opl + rounding * length.others) << row.row;
        };
        each_row(g, *c.scene, t, check, check);
        if (c.name != "textured.xml" && c.name != "mask.xml") {
            EXPECT_GT(n_lengths, 400u);
        }
    }
}

// Detected mutations: lengths that keep their index.
// A slab of clear or of rough glass of thickness T across the view: d opl / d eta = T along its axis, for each crossing
// as long as it is.
TEST(DeriveRigid, LengthsInGlassGrowWithItsIndex) {
    for (const std::string roughness : {"", "rough"}) {
        SCOPED_TRACE(roughness);
        const double thickness = 0.4;
        const auto scene = testing::load_inline(
            {R"(type="perspective"><float name="fov" value="0.2"/><transform name="to_world"><lookat origin="0, 0, 3" target="0, 0, 0" up="0, 1, 0"/></transform>)",
             fmt::format(R"(<shape type="cube"><transform name="to_world"><scale x="2" y="2" z="{}"/></transform>
<bsdf type="{}dielectric" id="glass">{}<float name="int_ior" value="1.5"/></bsdf></shape>
<shape type="rectangle" id="lamp"><transform name="to_world"><scale x="3" y="3"/><translate z="-1"/></transform>
<emitter type="area"><rgb name="radiance" value="1"/></emitter></shape>)",
                         thickness / 2, roughness,
                         roughness.empty()
                             ? ""
                             : R"(<string name="distribution" value="ggx"/><float name="alpha" value="0.3"/>)"),
             8, 8, 4});
        const PathGraph g =
            testing::trace_graph(*scene, testing::path_options(*scene, 5), 16, 0, testing::derive_columns);
        SceneTangents t(*scene);
        MaterialTangent index;
        index.eta = index.int_ior = 1;
        for (std::size_t m = 0; m < scene->materials.size(); ++m)
            if (scene->materials[m].id == "glass") t.materials[m].push_back({add_parameter(t, "index"), index});
        ASSERT_EQ(t.n(), 1u);
        std::size_t n_straight = 0;
        each_row(
            g, *scene, t,
            [&](const InteriorRow& row, const Spectrum&, double) {
                const std::uint32_t j = g.light_edges.vertex[row.row];
                // Sum of the segments inside.
                std::size_t first = j;
                const auto starts = [&](std::size_t v) {
                    return std::binary_search(g.paths.first_vertex.begin(), g.paths.first_vertex.end(), v);
                };
                while (!starts(first)) --first;
                double inside = 0;
                for (std::size_t v = first + 1; v <= j; ++v)
                    if (g.vertices.eta[v] > 1.2f) inside += length(position<double>(g, v) - position<double>(g, v - 1));
                if (roughness.empty()) {
                    // Directions change, too: along the axis alone the length counts.
                    n_straight += std::size_t(j - first == 1);
                    if (j - first == 1) {
                        EXPECT_NEAR(row.dopl[0], thickness, 1e-5) << row.row;
                    }
                } else if (inside > 0 && g.light_edges.eta[row.row] < 1.2f) {
                    ++n_straight;
                    EXPECT_NEAR(row.dopl[0], inside, 1e-6 * inside) << row.row;
                }
            },
            [](const InteriorRow&, const Spectrum&, double) {});
        EXPECT_GT(n_straight, 200u);
    }
}

/// Rows of boundary samples by family, all parts on.
Derivative boundary_of(const PathGraph& g, const Scene& scene, const SceneTangents& t, int threads = 0) {
    app::Report report;
    report.set_quiet(true);
    DeriveCounts counts;
    Parts parts = required_parts(scene, g, t, {});
    parts.interior = false;
    return differentiate(g, scene, t, parts, {3, 7, threads}, report, counts);
}

// Detected mutations: shares of the two ends exchanged; a shading frame that does not turn.
TEST(DeriveRigid, NoBoundaryMovesWhenEverythingMovesAsOne) {
    std::array<std::size_t, n_boundary_families> n_rows{};
    // A few rows of little light lose more digits than all together: of less than a millionth of the mean, all.
    constexpr double rounding_of_row = 0.01, little = 1e-6;
    for (const Case& c : cases()) {
        SCOPED_TRACE(c.name);
        const PathGraph g =
            testing::trace_graph(*c.scene, testing::path_options(*c.scene, 6), 16, 0, testing::derive_columns);
        const SceneTangents t = everything_then_each(*c.scene, rigid_motion({0.5, -0.8, 0.3}, {0.2, -0.7, 0.4}));
        const Derivative d = boundary_of(g, *c.scene, t);
        const std::size_t width = 3 * t.n();
        double first = 0, others = 0;
        std::vector<Sizes> rows;
        for (std::size_t i = 0; i < d.boundary.pixel.size(); ++i) {
            rows.emplace_back(std::span(d.boundary.dL.data() + i * width, width), 3);
            ++n_rows[d.boundary.family[i]];
            first += rows.back().first, others += rows.back().others;
        }
        const double mean = others / double(rows.size());
        for (std::size_t i = 0; i < rows.size(); ++i)
            EXPECT_LE(rows[i].first, rounding_of_row * std::max(rows[i].others, little * mean))
                << i << " family " << int(d.boundary.family[i]);
        EXPECT_LE(first, rounding * others);
    }
    for (const std::size_t n : n_rows) EXPECT_GT(n, 500u);
}

}  // namespace
}  // namespace loom::derive
