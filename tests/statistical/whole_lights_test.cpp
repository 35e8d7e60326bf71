// Points of lights that first hits see wholly: rays to them, their light against next-event samples, and their bins
// against those of stored points of the same graphs.
#include <fmt/format.h>
#include <gtest/gtest.h>
#include <tbb/parallel_for.h>
#include <tbb/spin_mutex.h>

#include <cstdio>
#include <map>
#include <numeric>

#include "stages/derive/interior.h"
#include "tests/statistical/derivative_support.h"
#include "tests/statistical/support.h"

namespace loom {
namespace {

/// Surfaces of all kinds under a rectangle, a disk and a ball that glow; a board, a ball and a wall hide parts of them.
constexpr const char* text = R"(<scene version="3.0.0">
<default name="lights_x" value="0"/><default name="floor_z" value="0"/><default name="camera_x" value="0"/>
<integrator type="path"><integer name="max_depth" value="2"/></integrator>
<sensor type="perspective"><float name="fov" value="50"/><transform name="to_world"><lookat origin="0, -4, 2" target="0, 0, 0.5" up="0, 0, 1"/><translate x="$camera_x"/></transform>
<film type="hdrfilm"><integer name="width" value="8"/><integer name="height" value="8"/><rfilter type="box"/></film></sensor>
<bsdf type="twosided" id="grey"><bsdf type="diffuse"><rgb name="reflectance" value="0.6, 0.6, 0.6"/></bsdf></bsdf>
<shape type="rectangle"><transform name="to_world"><scale value="3"/><translate z="$floor_z"/></transform><ref id="grey"/></shape>
<shape type="rectangle"><transform name="to_world"><scale value="3"/><rotate x="1" angle="90"/><translate y="2.2" z="2.4"/></transform>
<bsdf type="roughconductor"><string name="distribution" value="ggx"/><float name="alpha" value="0.3"/></bsdf></shape>
<shape type="cube"><transform name="to_world"><scale value="0.3"/><rotate z="1" angle="30"/><translate x="-0.9" y="-0.4" z="0.4"/></transform><bsdf type="roughplastic"><float name="alpha" value="0.3"/></bsdf></shape>
<shape type="cube"><transform name="to_world"><scale value="0.3"/><rotate z="1" angle="10"/><translate x="0.9" y="-0.3" z="0.4"/></transform><bsdf type="phong"><float name="exponent" value="20"/><rgb name="diffuse_reflectance" value="0.4, 0.4, 0.4"/><rgb name="specular_reflectance" value="0.4, 0.4, 0.4"/></bsdf></shape>
<shape type="cube"><transform name="to_world"><scale value="0.2"/><translate x="0" y="-1.1" z="0.3"/></transform><bsdf type="roughdielectric"><float name="alpha" value="0.4"/></bsdf></shape>
<shape type="rectangle"><transform name="to_world"><scale x="0.4" y="0.3"/><translate x="0.1" y="0.2" z="1.2"/></transform><ref id="grey"/></shape>
<shape type="sphere"><point name="center" x="-0.7" y="0.6" z="1.1"/><float name="radius" value="0.25"/><ref id="grey"/></shape>
<shape type="rectangle"><transform name="to_world"><scale value="0.35"/><rotate x="1" angle="180"/><translate x="0.4" z="2.6"/><translate x="$lights_x"/></transform><emitter type="area"><rgb name="radiance" value="5, 5, 5"/></emitter></shape>
<shape type="disk"><transform name="to_world"><scale value="0.3"/><rotate x="1" angle="160"/><translate x="-0.6" y="1.2" z="2.4"/><translate x="$lights_x"/></transform><emitter type="area"><rgb name="radiance" value="5, 5, 5"/></emitter></shape>
<shape type="sphere"><point name="center" x="0" y="0" z="0"/><float name="radius" value="0.2"/><transform name="to_world"><translate x="1.3" y="-0.5" z="2"/><translate x="$lights_x"/></transform><emitter type="area"><rgb name="radiance" value="5, 5, 5"/></emitter></shape>
</scene>)";

constexpr std::size_t n_bins = 24, n_pooled = 2, n_parts = 16;

/// Sums over sixteenths of the image and pairs of bins.
std::vector<double> parts_of(const DerivedBins& bins) {
    std::vector<double> out(n_parts * (n_bins / n_pooled));
    for (std::size_t p = 0; p < bins.n_pixels; ++p) {
        const std::size_t part = p / 8 / 2 * 4 + p % 8 / 2;
        for (std::size_t k = 0; k < n_bins; ++k)
            out[part * (n_bins / n_pooled) + k / n_pooled] += bins.derivative[3 * (p * n_bins + k)];
    }
    return out;
}

struct File {
    std::filesystem::path path = testing::scratch_file(".xml");
    File() { std::ofstream(path) << text; }
    ~File() { std::filesystem::remove(path); }
};

// A ray to every point; and at some vertices the light of 16384 points against that of 16384 next-event samples, 0.02 % for
// the mean of all. Detected mutations: silhouettes, spheres or horizons ignored (200 to 800 points hidden); weights wrong
// by 0.6 %. Not detected: the MIS weight of the stored point for all points, which differs by less.
TEST(WholeLights, PointsAreSeenAndBringTheLightOfNextEventSamples) {
    const File file;
    const DerivableScene loaded(file.path, {"lights_x"});
    const Scene& scene = *loaded.scene;
    const PathGraph g = trace_derivable(scene, 64, 1);
    const GraphReader reader(g);
    const EdgeTree edges(find_edges(scene.shapes));
    derive::WholeLights whole(scene, {&edges, 4, 5});
    std::size_t n_vertices = 0, n_points = 0, n_hidden = 0;
    std::map<BsdfKind, int> compared;
    std::vector<double> ratios;
    for (std::size_t k = 0; k < g.n_light_edges(); ++k) {
        const std::size_t j = g.light_edges.vertex[k], emitter = g.light_edges.emitter[k];
        if (LightTechnique(g.light_edges.technique[k]) != LightTechnique::next_event) continue;
        const ShadingPoint at = reader.vertex(j);
        const auto points = [&](std::uint64_t vertex) {
            return whole.points(vertex, g.vertices.shape[j], at, emitter, g.light_edges.pdf_bsdf_w[k],
                                reader.light_direction(at.p, k));
        };
        if (points(j).empty()) continue;
        ++n_vertices;
        RayEnd end = at.end();
        end.hit_error = scene.shapes[g.vertices.shape[j]].hit_error;
        for (const derive::WholeLightPoint& point : points(j)) {
            const RayEnd light{Point3f(point.y), Normal3f(point.n),
                               scene.shapes[scene.emitters[emitter].shape_idx].hit_error};
            ++n_points;
            n_hidden += scene.occluded(spawn_segment(end, light));
        }
        if (compared[at.bsdf.model->kind]++ >= 12) continue;
        constexpr int n = 16384;
        std::vector<double> ours, theirs;
        for (int i = 0; i < n / 16; ++i) {
            double sum = 0;
            for (const derive::WholeLightPoint& point : points(std::uint64_t(i) + 1000000))
                sum += point.weight * point.Li.g *
                       double(f_cos_pdf(at, Vector3f(normalize(point.y - Point3<double>(at.p)))).f_cos.g);
            ours.push_back(sum);
        }
        const float survival = g.light_edges.pdf_bsdf_w[k] / f_cos_pdf(at, reader.light_direction(at.p, k)).pdf_w;
        const Sampler sampler(SamplerKind::independent, 7, k, 0);
        for (std::uint32_t i = 0; theirs.size() < n; ++i) {
            const LightSample light = sample_light(scene, at.p, sampler.pair(i));
            if (light.emitter_idx != emitter) continue;
            const BsdfValue<float> f = f_cos_pdf(at, light.wi);
            theirs.push_back(
                double(f.f_cos.g * light.Li.g * power_heuristic(light.pdf_w, survival * f.pdf_w) / light.pdf_w));
        }
        const Estimate a = estimate_of(ours), b = estimate_of(theirs);
        EXPECT_LT(std::abs(a.mean - b.mean), 4.5 * std::hypot(a.se, b.se)) << "edge " << k << " vertex " << j;
        ratios.push_back(a.mean / b.mean);
    }
    const Estimate ratio = estimate_of(ratios);
    std::printf("    %zu vertices, %zu points, %zu hidden; light over that of next-event samples %.4f +- %.4f\n",
                n_vertices, n_points, n_hidden, ratio.mean, ratio.se);
    EXPECT_EQ(n_hidden, 0u);
    EXPECT_GT(n_vertices, 1000u);
    EXPECT_EQ(compared.size(), 4u);
    EXPECT_NEAR(ratio.mean, 1, 4 * ratio.se);
    EXPECT_LT(ratio.se, 0.002);
}

// A wall through a lamp hides a part of it without a silhouette in front; one that ends at its border does not.
// Detected mutations: each check of what cuts a light left out.
TEST(WholeLights, LightsThatAreCutAreNotUsed) {
    const auto usable = [](const std::string& light, const std::string& others) {
        const auto scene =
            testing::load_inline({.sensor = "type='perspective'><transform name='to_world'><lookat origin='0,-4,1' "
                                            "target='0,0,1' up='0,0,1'/></transform>",
                                  .body = light + "<emitter type='area'/></shape><shape type='rectangle'/>" + others});
        return derive::usable_lights(*scene)[0] != 0;
    };
    const std::string wall =
        "<shape type='rectangle'><transform name='to_world'><scale value='3'/><rotate y='1' angle='90'/><translate x='";
    const auto wall_at = [&](double x) { return wall + fmt::format("{}'/></transform></shape>", x); };
    const auto ball_at = [](double x) {
        return fmt::format(
            "<shape type='sphere'><point name='center' x='{}' y='0' z='2'/><float name='radius' value='0.1'/></shape>",
            x);
    };
    const std::string
        square =
            "<shape type='rectangle'><transform name='to_world'><scale value='0.5'/><rotate x='1' "
            "angle='180'/><translate z='2'/></transform>",
        disk =
            "<shape type='disk'><transform name='to_world'><scale value='0.5'/><rotate x='1' angle='180'/><translate "
            "z='2'/></transform>",
        sphere = "<shape type='sphere'><point name='center' x='0' y='0' z='2'/><float name='radius' value='0.5'/>";
    for (const std::string& light : {square, disk, sphere}) {
        EXPECT_TRUE(usable(light, "")) << light;
        EXPECT_TRUE(usable(light, wall_at(0.5))) << light;
        EXPECT_TRUE(usable(light, wall_at(0.7) + ball_at(1))) << light;
        EXPECT_FALSE(usable(light, wall_at(0.2))) << light;
        EXPECT_FALSE(usable(light, ball_at(0.4))) << light;
    }
    EXPECT_FALSE(usable("<shape type='cube'>", ""));
}

// Detected mutations: silhouettes ignored (p < 1e-5).
TEST(WholeLights, PointsHaveTheMeanOfStoredPoints) {
    const File file;
    TimeResponse response;
    response.n_bins = n_bins, response.start = 5, response.width = response.gate = 0.2;
    response.pulse = Pulse::box(0.2);
    for (const char* wrt : {"lights_x", "floor_z", "camera_x"}) {
        const DerivableScene scene(file.path, {wrt});
        const int replicates = 16;
        Samples difference(std::size_t{replicates}), zero(std::size_t{replicates});
        double noise[2] = {};
        std::uint64_t n_points = 0, n_stored = 0;
        tbb::spin_mutex sums;
        tbb::parallel_for(0, replicates, [&](int i) {
            const PathGraph graph = trace_derivable(*scene.scene, full_run() ? 1024 : 128, std::uint64_t(5100 + i));
            std::vector<double> parts[2];
            for (const int side : {1, 3}) {
                app::Report report;
                report.set_quiet(true);
                derive::DeriveCounts counts;
                derive::Parts interior;
                const Derivative d = derive::differentiate(
                    graph, *scene.scene, scene.tangents, interior,
                    {.effort = 1, .seed = std::uint64_t(700 + i), .light_points_per_side = side}, report, counts);
                const DerivedBins bins = bins_of(graph, &d, response);
                parts[side / 2] = parts_of(bins);
                const tbb::spin_mutex::scoped_lock lock(sums);
                noise[side / 2] += std::accumulate(bins.var_mean.begin(), bins.var_mean.end(), 0.0);
                (side == 1 ? n_stored : n_points) +=
                    side == 1 ? d.interior.edge.size() : d.light_points.edge.size() / 9;
            }
            auto& out = difference[std::size_t(i)];
            for (std::size_t k = 0; k < parts[0].size(); ++k) out.push_back(parts[1][k] - parts[0][k]);
            zero[std::size_t(i)].assign(out.size(), 0);
        });
        const Agreement a = compare_numbers(difference, zero);
        std::printf("    %-9s n %3d chi^2 %6.1f p %.2g; %.0f %% of edges, variance %.3f of that of stored points\n",
                    wrt, a.n, a.chi2, a.p, 100 * double(n_points) / double(n_stored), noise[1] / noise[0]);
        EXPECT_GT(a.p, 1e-3) << wrt;
        EXPECT_GT(a.n, 50) << wrt;
        EXPECT_GT(double(n_points), 0.1 * double(n_stored)) << wrt;
        EXPECT_LT(noise[1], noise[0]) << wrt;
    }
}

}  // namespace
}  // namespace loom
