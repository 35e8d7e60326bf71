#pragma once
// Scenes and motions for tests of derivatives.

#include <fmt/format.h>

#include <memory>
#include <random>
#include <string>

#include "stages/derive/derive.h"
#include "stages/derive/scene_tangents.h"
#include "tests/traced_graph.h"
#include "tests/unit/icosphere.h"

namespace loom::testing {

inline constexpr OptionalColumns derive_columns{true, true, true};

/// Writes a sphere with vertex normals that differ from those of its faces.
inline std::filesystem::path write_smooth_ball(const Point3f& centre, float radius) {
    const Mesh mesh = test::icosphere(1, centre, radius);
    const auto file = scratch_file(".obj");
    std::ofstream out(file);
    for (const Point3f& p : mesh.positions) out << fmt::format("v {:.9g} {:.9g} {:.9g}\n", p.x, p.y, p.z);
    for (const Point3f& p : mesh.positions) {
        const Vector3f n = normalize(p - centre) + Vector3f(0.05f, -0.1f, 0.08f);
        out << fmt::format("vn {:.9g} {:.9g} {:.9g}\n", n.x, n.y, n.z);
    }
    for (std::size_t i = 0; i < mesh.indices.size(); i += 3) {
        const auto k = [&](std::size_t c) { return mesh.indices[i + c] + 1; };
        out << fmt::format("f {0}//{0} {1}//{1} {2}//{2}\n", k(0), k(1), k(2));
    }
    return file;
}

/// A room with one of each: diffuse, glossy, plastic, mirror, slab of clear glass, ball of rough glass, mask, brushed
/// disk, smooth normals, textures.
/// in:      emitters  XML
inline std::unique_ptr<Scene> load_room(const std::string& emitters, int width = 12, int height = 10, int max_depth = 6,
                                        const std::string& sensor = {}) {
    const auto ball = write_smooth_ball({-0.45f, -0.6f, 0.15f}, 0.3f);
    const std::string perspective = R"(type="perspective"><float name="fov" value="42"/>
<transform name="to_world"><lookat origin="0.1, 0.05, 3.6" target="0, -0.1, 0" up="0, 1, 0"/></transform>)";
    InlineScene s;
    s.sensor = sensor.empty() ? perspective : sensor;
    s.width = width, s.height = height, s.max_depth = max_depth;
    s.body = fmt::format(R"(
<bsdf type="twosided" id="white"><bsdf type="diffuse"><rgb name="reflectance" value="0.7, 0.6, 0.5"/></bsdf></bsdf>
<bsdf type="diffuse" id="image"><texture type="bitmap" name="reflectance"><string name="filename" value="{0}/scenes/textures/patches.png"/></texture></bsdf>
<bsdf type="dielectric" id="clear"><float name="int_ior" value="1.5"/></bsdf>
<bsdf type="roughdielectric" id="frosted"><string name="distribution" value="ggx"/><float name="alpha" value="0.3"/><float name="int_ior" value="1.4"/></bsdf>
<bsdf type="twosided" id="satin"><bsdf type="roughconductor"><string name="distribution" value="ggx"/><float name="alpha_u" value="0.15"/><float name="alpha_v" value="0.4"/><string name="material" value="Cu"/></bsdf></bsdf>
<bsdf type="roughconductor" id="metal"><string name="distribution" value="ggx"/><float name="alpha" value="0.25"/><string name="material" value="Al"/></bsdf>
<bsdf type="conductor" id="mirror"><string name="material" value="Ag"/></bsdf>
<bsdf type="plastic" id="plastic"><rgb name="diffuse_reflectance" value="0.3, 0.5, 0.2"/></bsdf>
<bsdf type="mask" id="veil"><float name="opacity" value="0.6"/><bsdf type="twosided"><bsdf type="diffuse"><rgb name="reflectance" value="0.4, 0.5, 0.6"/></bsdf></bsdf></bsdf>
<shape type="rectangle" id="floor"><transform name="to_world"><rotate x="1" angle="-90"/><translate y="-1"/></transform><ref id="white"/></shape>
<shape type="rectangle" id="back"><transform name="to_world"><translate z="-1"/></transform><ref id="image"/></shape>
<shape type="rectangle" id="left"><transform name="to_world"><rotate y="1" angle="80"/><translate x="-1"/></transform><ref id="mirror"/></shape>
<shape type="rectangle" id="right"><transform name="to_world"><rotate y="1" angle="-90"/><translate x="1"/></transform><ref id="plastic"/></shape>
<shape type="cube" id="slab"><transform name="to_world"><scale x="0.3" y="0.35" z="0.06"/><rotate y="1" angle="25"/><translate x="0.35" y="-0.55" z="0.6"/></transform><ref id="clear"/></shape>
<shape type="sphere" id="glass"><point name="center" x="0.45" y="-0.7" z="-0.3"/><float name="radius" value="0.28"/><ref id="frosted"/></shape>
<shape type="disk" id="disk"><transform name="to_world"><scale x="0.3" y="0.3"/><rotate x="1" angle="-60"/><translate x="0.1" y="-0.3" z="-0.6"/></transform><ref id="satin"/></shape>
<shape type="sphere" id="drop"><point name="center" x="-0.5" y="0.4" z="-0.4"/><float name="radius" value="0.2"/><ref id="metal"/></shape>
<shape type="obj" id="ball"><string name="filename" value="{1}"/><ref id="white"/></shape>
<shape type="rectangle" id="sheet"><transform name="to_world"><scale x="0.25" y="0.25"/><rotate x="1" angle="10"/><translate x="-0.5" y="0" z="0.5"/></transform><ref id="veil"/></shape>
{2})",
                         LOOM_SOURCE_DIR, ball.string(), emitters);
    auto scene = load_inline(s);
    std::filesystem::remove(ball);
    return scene;
}

inline const char* area_lights = R"(
<shape type="rectangle" id="lamp"><transform name="to_world"><scale x="0.3" y="0.3"/><rotate x="1" angle="90"/><translate y="0.95"/></transform><bsdf type="diffuse"><rgb name="reflectance" value="0"/></bsdf><emitter type="area"><rgb name="radiance" value="8, 7, 5"/></emitter></shape>
<shape type="sphere" id="bulb"><point name="center" x="0.6" y="0.5" z="0.2"/><float name="radius" value="0.1"/><emitter type="area"><rgb name="radiance" value="9, 4, 6"/></emitter></shape>
)";
inline const char* delta_lights = R"(
<emitter type="point" id="point"><point name="position" x="0.2" y="0.8" z="0.3"/><rgb name="intensity" value="3, 2, 1"/></emitter>
<emitter type="spot" id="spot"><transform name="to_world"><lookat origin="-0.3, 0.9, 0.9" target="0, -0.8, -0.1" up="0, 0, 1"/></transform><rgb name="intensity" value="4, 4, 6"/><float name="cutoff_angle" value="50"/><float name="beam_width" value="10"/></emitter>
<emitter type="directional" id="sun"><vector name="direction" x="-0.3" y="-1" z="-0.4"/><rgb name="irradiance" value="1, 0.8, 0.6"/></emitter>
<emitter type="projector" id="projector"><transform name="to_world"><lookat origin="0.3, 0.7, 1.5" target="0, -0.5, 0" up="0, 1, 0"/></transform><float name="fov" value="60"/><rgb name="irradiance" value="0.6, 0.9, 0.7"/></emitter>
)";
inline std::string sky() {
    return fmt::format(
        R"(<emitter type="envmap" id="sky"><string name="filename" value="{}/scenes/textures/sky.png"/></emitter>)",
        LOOM_SOURCE_DIR);
}

inline std::uint32_t add_parameter(derive::SceneTangents& t, std::string name) {
    t.parameters.push_back({std::move(name), "1", 0});
    return std::uint32_t(t.parameters.size() - 1);
}

inline derive::AffineVelocity rigid_motion(const Vector3<double>& axis, const Vector3<double>& shift) {
    derive::AffineVelocity v;
    v.linear = {0, -axis.z, axis.y, axis.z, 0, -axis.x, -axis.y, axis.x, 0};
    v.offset = shift;
    return v;
}
inline derive::AffineVelocity any_motion(unsigned seed) {
    std::mt19937 random(seed);
    std::uniform_real_distribution<double> u(-1, 1);
    derive::AffineVelocity v;
    for (double& x : v.linear) x = u(random);
    v.offset = {u(random), u(random), u(random)};
    return v;
}

/// Moves shapes, camera and emitters without area together.
inline void move_everything(derive::SceneTangents& t, const Scene& scene, std::uint32_t parameter,
                            const derive::AffineVelocity& v) {
    for (auto& shape : t.shapes) shape.push_back({parameter, v});
    for (std::size_t e = 0; e < scene.emitters.size(); ++e)
        if (scene.emitters[e].kind != EmitterKind::area) t.emitters[e].push_back({parameter, v});
    t.camera.push_back({parameter, v});
}

}  // namespace loom::testing
