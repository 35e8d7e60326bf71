// Every parameter that the schema accepts is read when a scene with it is built, or is declared to be without effect
// (flag::ignored). Detected mutations: the readers of hide_emitters, flip_invalid_normals, use_shadowing_function, the
// variant of ward and the gamma of envmap removed, each by name.

#include <fmt/format.h>
#include <gtest/gtest.h>

#include <map>

#include "stages/core/description/schema.h"
#include "stages/core/scene/build.h"
#include "tests/unit/scene_folder.h"
#include "tests/unit/serialized_file.h"

namespace loom::test {
namespace {

using enum Category;

/// Further parameters that a parameter needs for an effect, by "plugin.parameter", ".parameter" or "plugin".
const std::map<std::string, std::string> companions = {
    {"perspective.fov_axis", "<float name='fov' value='30'/>"},
    {"projector.fov_axis", "<float name='fov' value='30'/>"},
    {"bitmap", "<string name='filename' value='image.ppm'/>"},
    {"envmap", "<string name='filename' value='image.ppm'/>"},
    {"obj", "<string name='filename' value='mesh.obj'/>"},
    {"ply", "<string name='filename' value='mesh.ply'/>"},
    {"serialized", "<string name='filename' value='mesh.serialized'/>"},
    {".gaussian_stddev", "<string name='temporal_filter' value='gaussian'/>"},
    {"transient_nlos_path.nlos_hidden_geometry_sampling_do_rroulette",
     "<boolean name='nlos_hidden_geometry_sampling' value='true'/>"},
    {"transient_nlos_path.force_equal_illumination_scanning", "<string name='capture_type' value='exhaustive'/>"},
    {"transient_nlos_path.illumination_scan_fov",
     "<string name='capture_type' value='exhaustive'/><boolean name='force_equal_illumination_scanning' "
     "value='false'/>"},
};

/// Values that the general one of a kind would be wrong for.
const std::map<std::string, std::string> special = {
    {"material", "Au"},
    {"focal_length", "35mm"},
    {"exhaustive_scan", "true"},
    {"day", "3"},
    {"month", "3"},
    {"resolution", "16"},
    {"camera_unwarp", "false"},
    {"shape_index", "1"},
    {"temporal_bins", "8"},
    {"near_clip", "0.5"},
    {"far_clip", "50"},
    {"turbidity", "3"},
    {"year", "2012"},
    {"beam_width", "5"},
    {"filter_bounces", "2"},
    {"filter_depth", "3"},
    {"laser_scan_width", "4"},
    {"laser_scan_height", "4"},
    {"hour", "12"},
    {"timezone", "8"},
    {"stretch", "1.5"},
};

bool is_around_corner(const PluginSchema& plugin, std::string_view parameter) {
    return plugin.type == "transient_nlos_path" || plugin.type == "nlos_capture_meter" ||
           parameter == "exhaustive_scan" || parameter.starts_with("laser_scan");
}

std::string file_of(std::string_view plugin) {
    return plugin == "obj" || plugin == "ply" || plugin == "serialized" ? fmt::format("mesh.{}", plugin)
                                                                        : std::string("image.ppm");
}

std::string element(const PluginSchema& plugin, const Parameter& p) {
    const auto known = special.find(std::string(p.name));
    const auto value = [&](const char* tag, const std::string& general) {
        return fmt::format("<{} name='{}' value='{}'/>", tag, p.name, known != special.end() ? known->second : general);
    };
    switch (p.kind) {
        case ValueKind::boolean:
            return value("boolean", "true");
        case ValueKind::integer:
            return value("integer", "4");
        case ValueKind::number:
            return value("float", "0.5");
        case ValueKind::string:
            return value("string", std::string(p.choices.substr(0, p.choices.find_first_of("|/"))));
        case ValueKind::file:
            return fmt::format("<string name='{}' value='{}'/>", p.name, file_of(plugin.type));
        case ValueKind::ior:
            return value("float", "1.3");
        case ValueKind::reflectance:
        case ValueKind::emission:
        case ValueKind::index:
            return value("rgb", "0.5");
        case ValueKind::transform:
        case ValueKind::uv_transform:
            return fmt::format("<transform name='{}'><scale value='1'/></transform>", p.name);
        case ValueKind::point:
            return fmt::format("<point name='{}' x='0' y='0' z='3'/>", p.name);
        case ValueKind::vector:
            return fmt::format("<vector name='{}' x='0' y='0.6' z='0.8'/>", p.name);
        case ValueKind::texture_only:
            return fmt::format("<texture name='{}' type='checkerboard'/>", p.name);
    }
    return {};
}

/// The smallest scene in which an object of the plugin with these parameters has its place.
std::string scene_with(const PluginSchema& plugin, const std::string& parameters, bool around_corner,
                       const char* version) {
    std::string film_type = "hdrfilm", film_parameters, filter, sensor_type = "perspective", sensor_parameters,
                integrator = "<integrator type='path'/>", shape_type = "sphere", shape_parameters, bsdf, light, more;
    const std::string type(plugin.type == "*" ? "another" : plugin.type);  // a type that the table does not name
    switch (plugin.category) {
        case Category::bsdf: {
            const bool needs_texture = type == "bumpmap" || type == "normalmap",
                       wraps = needs_texture || type == "mask" || type == "twosided";
            bsdf = fmt::format("<bsdf type='{}'>{}{}{}</bsdf>", type, parameters,
                               needs_texture ? "<texture name='normalmap' type='checkerboard'/>" : "",
                               wraps ? "<bsdf type='diffuse'/>" : "");
            break;
        }
        case Category::texture:
            bsdf = fmt::format("<bsdf type='diffuse'><texture name='reflectance' type='{}'>{}</texture></bsdf>", type,
                               parameters);
            break;
        case Category::shape:
            shape_type = type, shape_parameters = parameters;
            break;
        case Category::emitter:
            (type == "area" ? light : more) = fmt::format("<emitter type='{}'>{}</emitter>", type, parameters);
            break;
        case Category::sensor:
            sensor_type = type, sensor_parameters = parameters;
            break;
        case Category::film:
            film_type = type, film_parameters = parameters;
            break;
        case Category::rfilter:
            filter = fmt::format("<rfilter type='{}'>{}</rfilter>", type, parameters);
            break;
        case Category::integrator:
            integrator = fmt::format("<integrator type='{}'>{}</integrator>", type, parameters);
            break;
        default:
            break;
    }
    if (around_corner) {
        sensor_type = "nlos_capture_meter", film_type = "transient_hdr_film";
        const bool scans =
            parameters.find("exhaustive") != std::string::npos || parameters.find("laser_scan") != std::string::npos;
        if (plugin.type != "transient_nlos_path")
            integrator = fmt::format("<integrator type='transient_nlos_path'>{}</integrator>",
                                     scans ? "<string name='capture_type' value='exhaustive'/>" : "");
        film_parameters += "<integer name='width' value='4'/><integer name='height' value='4'/>";
        if (scans)
            for (const auto& [name, xml] :
                 {std::pair{"exhaustive_scan", "<boolean name='exhaustive_scan' value='true'/>"},
                  std::pair{"laser_scan_width", "<integer name='laser_scan_width' value='4'/>"},
                  std::pair{"laser_scan_height", "<integer name='laser_scan_height' value='4'/>"}})
                if (film_parameters.find(name) == std::string::npos) film_parameters += xml;
        more +=
            "<emitter type='projector'><transform name='to_world'><lookat origin='0, 0, 2' target='0.1, 0.1, 0' up='0, "
            "1, 0'/></transform></emitter>"
            "<shape type='rectangle'><transform name='to_world'><translate z='1'/></transform></shape>";
        shape_type = "rectangle";
        if (sensor_parameters.find("sensor_origin") == std::string::npos)
            sensor_parameters += "<point name='sensor_origin' x='0' y='0' z='2'/>";
    }
    const std::string sensor = fmt::format("<sensor type='{}'>{}<film type='{}'>{}{}</film></sensor>", sensor_type,
                                           sensor_parameters, film_type, film_parameters, filter);
    return fmt::format("<scene version='{}'>{}{}<shape type='{}'>{}{}{}{}</shape>{}</scene>", version, integrator,
                       around_corner ? "" : sensor, shape_type, shape_parameters, bsdf, light,
                       around_corner ? sensor : "", more);
}

class SchemaWalk : public SceneFolder {
  protected:
    void SetUp() override {
        SceneFolder::SetUp();
        write(
            "image.ppm", "P3\n4 2\n255\n" + [] {
                std::string s;
                for (int i = 0; i < 24; ++i) s += "128 ";
                return s;
            }());
        write("mesh.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nf 1/1 2/2 3/3\n");
        write("mesh.ply",
              "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
              "element face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n");
        write("mesh.serialized", serialized_file(4, false, 0));
    }
};

TEST_F(SchemaWalk, EveryParameterIsReadOrDeclaredToBeWithoutEffect) {
    int n_parameters = 0;
    for (const PluginSchema& plugin : all_plugins()) {
        if (plugin.flags & flag::unsupported) continue;
        for (const Parameter& parameter : plugin.parameters) {
            if (parameter.flags & (flag::ignored | flag::unsupported)) continue;
            const std::string what = fmt::format("{}.{}", plugin.type, parameter.name);
            // The 0.x names are those of Mitsuba 3 in camel case.
            const bool legacy = (parameter.flags | plugin.flags) & flag::legacy;
            std::string parameters = element(plugin, parameter);
            for (const std::string& key : {what, fmt::format(".{}", parameter.name), std::string(plugin.type)})
                if (const auto more = companions.find(key);
                    more != companions.end() &&
                    more->second.find(fmt::format("'{}'", parameter.name)) == std::string::npos)
                    parameters += more->second;
            const bool around_corner = is_around_corner(plugin, parameter.name);
            write("scene.xml", scene_with(plugin, parameters, around_corner, legacy ? "0.6.0" : "3.0.0"));
            try {
                const auto scene = load_scene(path("scene.xml"));
                for (const std::string& note : scene->notes)
                    EXPECT_EQ(note.find(fmt::format("parameter '{}' has no effect", parameter.name)), std::string::npos)
                        << note;
            } catch (const std::exception& error) {
                ADD_FAILURE() << what << ": " << error.what();
            }
            ++n_parameters;
        }
    }
    EXPECT_GT(n_parameters, 100);
}

// A parameter with an effect only beside another one is named when that one is missing.
TEST_F(SchemaWalk, UnreadParametersAreNamedWithTheirPlace) {
    const auto scene = load_scene(write("scene.xml", R"(<scene version="3.0.0"><sensor type="perspective"/>
<integrator type="transient_path"><float name="gaussian_stddev" value="2"/></integrator>
<bsdf type="roughconductor" id="unused"><float name="alpha" value="0.2"/></bsdf>
</scene>)"));
    std::vector<std::string> unread;
    for (const std::string& note : scene->notes)
        if (note.find("has no effect next to the others") != std::string::npos) unread.push_back(note);
    ASSERT_EQ(unread.size(), 1u) << "an object that nothing uses has no say";
    EXPECT_NE(unread[0].find("scene.xml:2:"), std::string::npos) << unread[0];
    EXPECT_NE(unread[0].find("integrator 'transient_path': parameter 'gaussian_stddev'"), std::string::npos)
        << unread[0];
}

}  // namespace
}  // namespace loom::test
