// NLOS captures in scene files: their allowed parameters and their consequences.
#include <fmt/format.h>
#include <gtest/gtest.h>

#include "stages/core/scene/build.h"
#include "stages/core/scene/delta_light.h"
#include "stages/core/scene/nlos.h"
#include "stages/core/tracing/path_record.h"
#include "stages/core/tracing/path_tracer.h"
#include "tests/unit/scene_folder.h"

namespace loom {
namespace {

class NlosScene : public SceneFolder {
  protected:
    struct Parts {
        std::string integrator = R"(<integrator type="transient_nlos_path"/>)";
        std::string emitter =
            R"(<emitter type="projector"><transform name="to_world"><lookat origin="-0.5, 0, 0.25" target="0.5, 0.25, 0" up="0, 1, 0"/></transform></emitter>)";
        std::string sensor =
            R"(<sensor type="nlos_capture_meter"><point name="sensor_origin" x="-0.5" y="0" z="0.25"/>)";
        std::string film =
            R"(<film type="transient_hdr_film"><integer name="width" value="16"/><integer name="height" value="8"/>)";
        std::string wall = R"(<shape type="rectangle">)";
        std::string more;
    };
    std::unique_ptr<Scene> load(const Parts& p) {
        return load_scene(write("scene.xml", "<scene version=\"3.0.0\">\n" + p.integrator + "\n" + p.emitter + "\n" +
                                                 p.wall + p.sensor + p.film + "</film></sensor></shape>\n" + p.more +
                                                 "</scene>\n"));
    }
    std::string message(const Parts& p) {
        return error_of([&] { load(p); });
    }
    static std::string with(const std::string& parameters) {
        return R"(<integrator type="transient_nlos_path">)" + parameters + "</integrator>";
    }
};

// Many of these lie exactly on the edge of the wall's two triangles, where the ray engine may let a ray through.
TEST_F(NlosScene, SensorSeesAllPointsOfTheGrid) {
    const auto scene = load({});
    const NlosCapture& c = *scene->nlos;
    ASSERT_EQ(c.sensor_points.size(), 128u);
    EXPECT_EQ(scene->sensor.kind, SensorKind::nlos_capture_meter);
    EXPECT_EQ(scene->max_depth, 6);
    EXPECT_FALSE(scene->transient.camera_segment);
    for (int j = 0; j < 8; ++j)
        for (int i = 0; i < 16; ++i) {
            const NlosCapture::Point& at = c.sensor_points[j * 16 + i];
            ASSERT_TRUE(at.hit) << i << ", " << j;
            EXPECT_EQ(at.hit.shape_idx, c.relay_wall);
            EXPECT_NEAR(at.p.x, 2 * (i + 0.5) / 16 - 1, 1e-6);
            EXPECT_NEAR(at.p.y, 2 * (j + 0.5) / 8 - 1, 1e-6);
            EXPECT_NEAR(at.flat.z, 1, 1e-6);
        }
    ASSERT_EQ(c.laser_points.size(), 1u);
    EXPECT_NEAR(c.laser_points[0].p.x, 0.5, 1e-5);
    EXPECT_NEAR(c.laser_points[0].p.y, 0.25, 1e-5);
    EXPECT_TRUE(c.laser_points[0].lit);
}

TEST_F(NlosScene, WallIsSeenByItsOwnCoordinatesAndBehindWhatHidesIt) {
    Parts p;
    p.wall =
        R"(<shape type="rectangle"><transform name="to_world"><scale x="2"/><rotate z="1" angle="90"/></transform>)";
    p.more =
        R"(<shape type="rectangle" id="screen"><transform name="to_world"><scale value="0.03"/><translate x="-0.46875" y="0" z="0.2"/></transform></shape>)";
    const auto scene = load(p);
    const auto& points = scene->nlos->sensor_points;
    EXPECT_NEAR(points[0].p.x, 0.875, 1e-6);  // u along y, v along -x
    EXPECT_NEAR(points[0].p.y, -1.875, 1e-6);
    std::size_t screened = 0;
    for (const auto& at : points) screened += at.hit.shape_idx == 1;
    EXPECT_EQ(screened, 2u);  // its shadow on the wall is five times as large: y of +-1/8 and x of -3/8
}

TEST_F(NlosScene, ConfocalAndExhaustiveLaserPoints) {
    Parts p;
    p.integrator = with(R"(<string name="capture_type" value="confocal"/>)");
    auto scene = load(p);
    ASSERT_EQ(scene->nlos->laser_points.size(), 128u);
    for (std::size_t k = 0; k < 128; ++k) {
        EXPECT_EQ(scene->nlos->laser_points[k].p, scene->nlos->sensor_points[k].p);
        EXPECT_TRUE(scene->nlos->laser_points[k].lit);
    }
    p.integrator = with(
        R"(<string name="capture_type" value="exhaustive"/><boolean name="force_equal_illumination_scanning" value="false"/>
        <float name="illumination_scan_fov" value="10"/>)");
    p.film +=
        R"(<boolean name="exhaustive_scan" value="true"/><integer name="laser_scan_width" value="3"/><integer name="laser_scan_height" value="2"/>)";
    scene = load(p);
    ASSERT_EQ(scene->nlos->laser_points.size(), 6u);
    EXPECT_EQ(scene->sensor.width, 6u);
    EXPECT_EQ(scene->sensor.height, 128u);
    EXPECT_EQ(scene->nlos->sensor_point(6 * 5 + 4), 5u);
    EXPECT_EQ(scene->nlos->laser_point(6 * 5 + 4), 4u);
}

// E = pi irradiance r / z^3: by the plane at distance 1 that the scene's number is of.
TEST_F(NlosScene, ProjectorLightsItsBeam) {
    Parts p;
    p.emitter =
        R"(<emitter type="projector"><rgb name="irradiance" value="2, 3, 4"/><float name="fov" value="90"/></emitter>)";
    const auto scene = load(p);
    const Emitter& e = scene->emitters[0];
    EXPECT_NEAR(projected(*scene, e, EmitterPose<float>(e), Point3f{0, 0, 2}).r, pi_double * 2 / 4, 1e-5);
    EXPECT_NEAR(projected(*scene, e, EmitterPose<float>(e), Point3f{1.5, -1, 2}).b,
                pi_double * 4 * std::sqrt(2.25 + 1 + 4) / 8, 1e-4);
    EXPECT_EQ(projected(*scene, e, EmitterPose<float>(e), Point3f{2.1, 0, 2}), Spectrum(0));
    EXPECT_EQ(projected(*scene, e, EmitterPose<float>(e), Point3f{0, 0, -2}), Spectrum(0));
}

constexpr const char* camera_scene = R"(<scene version="3.0.0">
<integrator type="transient_nlos_path">{}<boolean name="nlos_laser_sampling" value="true"/><boolean name="nlos_hidden_geometry_sampling" value="true"/></integrator>
<emitter type="projector"><float name="fov" value="0.2"/><transform name="to_world"><lookat origin="-2, 0, 2" target="0.5, 0, 0" up="0, 1, 0"/></transform></emitter>
<sensor type="perspective"><float name="fov" value="1e-3"/><float name="near_clip" value="0.5"/><transform name="to_world"><lookat origin="-2, 0, 2" target="0, 0, 0" up="0, 1, 0"/></transform>
<film type="transient_hdr_film"><integer name="width" value="1"/><integer name="height" value="1"/><rfilter type="box"/></film></sensor>
<shape type="rectangle"><bsdf type="diffuse"/></shape>
<shape type="rectangle"><transform name="to_world"><scale value="0.005"/><rotate x="1" angle="180"/><translate z="1"/></transform><bsdf type="diffuse"/></shape>
</scene>)";

// The camera looks at the wall in (0, 0, 0), the laser points at (0.5, 0, 0), a patch of 1 cm^2 is at (0, 0, 1).
// Detected mutations: the lit wall among the hidden shapes, the laser at the camera, twice the density of hidden
// geometry.
TEST_F(NlosScene, CameraLooksAtTheWall) {
    const auto scene = load_scene(
        write("scene.xml", fmt::format(fmt::runtime(camera_scene), R"(<integer name="max_depth" value="4"/>)")));
    const NlosCapture& c = *scene->nlos;
    EXPECT_EQ(c.relay_wall, NlosCapture::no_wall);
    EXPECT_EQ(scene->sensor.kind, SensorKind::perspective);
    ASSERT_EQ(c.laser_points.size(), 1u);
    EXPECT_NEAR(c.laser_points[0].p.x, 0.5, 1e-5);
    const double E = projected(*scene, scene->emitters[0],
                               EmitterPose<float>(scene->emitters[0], c.laser_points[0].beam), c.laser_points[0].p)
                         .r,
                 cos_laser = 2 / std::sqrt(2.5 * 2.5 + 4);
    const double albedo = 0.5 / pi_double, area = 1e-4, spot_r2 = 1.25;
    // Both ends of the edge to the spot are parallel: cosine 1 / sqrt(1.25) twice.
    const double expected = albedo * area * albedo * (1 / spot_r2) * albedo * E * cos_laser / spot_r2;
    PathOptions options;
    options.sampler = SamplerKind::independent;
    options.max_depth = scene->max_depth;
    constexpr int n = 20000;
    double sum = 0, sum2 = 0;
    PathRecords records;
    for (std::uint64_t sample = 0; sample < n; ++sample) {
        const double L = trace_path(*scene, options, {0, sample}, records).L.r;
        sum += L;
        sum2 += L * L;
    }
    EXPECT_NEAR(sum / n, expected, 4 * std::sqrt(sum2) / n);
    EXPECT_LT(std::sqrt(sum2) / n, 0.02 * expected);  // the test can detect a difference
}

// Detected mutations: any capture_type (crash), the note although lengths count from the first hit, START on the wrong
// side.
TEST_F(NlosScene, CameraTakesSingleCapturesAndItsNearPlaneIsSaid) {
    const auto text = [&](const char* parameters) {
        return write("scene.xml", fmt::format(fmt::runtime(camera_scene), parameters));
    };
    EXPECT_NE(error_of([&] {
                  load_scene(text(R"(<integer name="capture_type" value="2"/>)"));
              }).find("scene.xml:2:76: a sensor 'perspective' takes single captures only"),
              std::string::npos);
    const auto near_note = [&](const char* parameters) -> std::string {
        const auto scene = load_scene(text(parameters));
        for (const std::string& note : scene->notes)
            if (note.starts_with("near_clip")) return note;
        return "none";
    };
    EXPECT_EQ(near_note(""), "none");  // lengths count from the first hit
    EXPECT_EQ(near_note(R"(<boolean name="account_first_and_last_bounces" value="true"/>)"),
              "near_clip 0.5: mitransient counts optical lengths from the near plane, Pathloom from the camera, so "
              "that light arrives 0.5 to 0.5 later here (167 bins); "
              "START=0.5 makes the cubes agree");
}

TEST_F(NlosScene, WhatDoesNotFitIsSaid) {
    struct Case {
        std::function<void(Parts&)> change;
        std::string_view says;
    };
    const Case cases[] = {
        {[](Parts& p) { p.integrator = R"(<integrator type="path"/>)"; },
         "scene.xml:4:25: sensor 'nlos_capture_meter' needs the integrator 'transient_nlos_path'"},
        {[](Parts& p) { p.emitter = ""; }, "needs exactly one emitter, a projector"},
        {[](Parts& p) { p.emitter += p.emitter; }, "needs exactly one emitter, a projector"},
        {[](Parts& p) { p.wall = R"(<shape type="sphere">)"; },
         "the relay wall must be a rectangle, or a mesh with texture coordinates"},
        {[](Parts& p) { p.film = R"(<film type="hdrfilm">)"; }, "needs a film 'transient_hdr_film'"},
        {[](Parts& p) { p.sensor = R"(<sensor type="perspective">)"; },
         "sensor 'perspective' does not belong inside a shape"},
        {[](Parts& p) { p.sensor += R"(<integer name="original_film_width" value="4"/>)"; },
         "'original_film_width' is not supported yet"},
        {[](Parts& p) { p.integrator = with(R"(<boolean name="camera_unwarp" value="true"/>)"); },
         "account_first_and_last_bounces"},
        {[](Parts& p) { p.integrator = with(R"(<string name="capture_type" value="double"/>)"); }, "single"},
        {[](Parts& p) { p.integrator = with(R"(<string name="capture_type" value="exhaustive"/>)"); },
         "needs a film with exhaustive_scan"},
        {[](Parts& p) {
             p.integrator =
                 with(R"(<integer name="filter_depth" value="4"/><integer name="filter_bounces" value="3"/>)");
         },
         "not both"},
        {[](Parts& p) { p.integrator = with(R"(<integer name="filter_depth" value="7"/>)"); },
         "longer than max_depth 6"},
        {[](Parts& p) { p.integrator = with(R"(<boolean name="nlos_hidden_geometry_sampling" value="true"/>)"); },
         "no geometry but the relay wall"},
        {[](Parts& p) { p.more = R"(<sensor type="nlos_capture_meter"/>)"; }, "needs a film 'transient_hdr_film'"},
        {[](Parts& p) { p.integrator = with(R"(<boolean name="nlos_sampling" value="true"/>)"); },
         "nlos_laser_sampling"},
    };
    for (const Case& c : cases) {
        Parts p;
        c.change(p);
        const std::string got = message(p);
        EXPECT_NE(got.find(c.says), std::string::npos) << c.says << "\n" << got;
        EXPECT_TRUE(got.starts_with("scene.xml:")) << got;
    }
}

}  // namespace
}  // namespace loom
