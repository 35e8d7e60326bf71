#include "stages/core/description/schema.h"

namespace loom {
namespace {

using enum Category;
using enum ValueKind;
using flag::ignored, flag::legacy, flag::modern, flag::non_negative, flag::numbered, flag::open, flag::positive,
    flag::required, flag::textured, flag::unsupported;
using Parameters = std::vector<Parameter>;

constexpr int any_number = 1 << 30;
constexpr std::string_view any_type = "*";  // the fallback of find_plugin()

Parameters operator+(Parameters a, const Parameters& b) {
    a.insert(a.end(), b.begin(), b.end());
    return a;
}

constexpr std::string_view distributions = "beckmann|ggx/phong|as";

std::vector<PluginSchema> make_table() {
    std::vector<PluginSchema> table;
    const auto add = [&](Category category, std::string_view type, Parameters parameters,
                         std::vector<ChildRule> children = {}, unsigned flags = 0) {
        table.push_back({category, type, std::move(parameters), std::move(children), flags});
    };
    const auto not_yet = [&](Category category, std::initializer_list<std::string_view> types) {
        for (const std::string_view type : types) add(category, type, {}, {}, unsupported);
    };

    add(scene, "scene", {},
        {{integrator, 0, 1},
         {sensor, 0, any_number},
         {emitter, 0, any_number},
         {shape, 0, any_number},
         {bsdf, 0, any_number},
         {texture, 0, any_number},
         {sampler, 0, any_number},
         {film, 0, any_number},
         {rfilter, 0, any_number},
         {medium, 0, any_number},
         {phase, 0, any_number}});

    // BSDFs
    const Parameters interface {
        {"int_ior", ior, positive}, { "ext_ior", ior, positive }
    };
    const Parameters specular_both{{"specular_reflectance", reflectance, textured},
                                   {"specular_transmittance", reflectance, textured}};
    const Parameters metal{{"material", string, flag::conductor},
                           {"eta", index, textured},
                           {"k", index, textured},
                           {"ext_eta", ior, positive | legacy},
                           {"specular_reflectance", reflectance, textured}};
    const Parameters rough{{"distribution", string, 0, distributions},
                           {"alpha", number, textured | non_negative},
                           {"alpha_u", number, textured | non_negative},
                           {"alpha_v", number, textured | non_negative},
                           {"sample_visible", boolean}};
    const Parameters base_and_coat{{"diffuse_reflectance", reflectance, textured},
                                   {"specular_reflectance", reflectance, textured},
                                   {"nonlinear", boolean}};
    const Parameters base_and_gloss{{"diffuse_reflectance", reflectance, textured},
                                    {"specular_reflectance", reflectance, textured}};
    const Parameters map_options{{"flip_invalid_normals", boolean}, {"use_shadowing_function", boolean}};
    const Parameters base{{"reflectance", reflectance, textured},
                          {"diffuse_reflectance", reflectance, textured | legacy}};
    add(bsdf, "diffuse", base);
    add(bsdf, "roughdiffuse",
        base + Parameters{{"alpha", number, textured | non_negative}, {"use_fast_approx", boolean, legacy | ignored}});
    add(bsdf, "conductor", metal);
    add(bsdf, "roughconductor", metal + rough);
    add(bsdf, "dielectric", interface + specular_both);
    add(bsdf, "thindielectric", interface + specular_both);
    add(bsdf, "roughdielectric", interface + specular_both + rough);
    add(bsdf, "plastic", interface + base_and_coat);
    add(bsdf, "roughplastic",
        interface + base_and_coat +
            Parameters{{"distribution", string, 0, distributions},
                       {"alpha", number, textured | non_negative},
                       {"sample_visible", boolean}});
    add(bsdf, "phong", base_and_gloss + Parameters{{"exponent", number, textured | non_negative}});
    add(bsdf, "ward",
        base_and_gloss + Parameters{{"variant", string, 0, "ward|ward-duer|balanced"},
                                    {"alpha", number, non_negative},
                                    {"alpha_u", number, textured | non_negative},
                                    {"alpha_v", number, textured | non_negative}});
    add(bsdf, "null", {});
    add(bsdf, "mask", {{"opacity", reflectance, textured}}, {{bsdf, 1, 1}});
    add(bsdf, "twosided", {}, {{bsdf, 1, 2}});
    add(bsdf, "bumpmap", Parameters{{"scale", number}} + map_options, {{texture, 1, 1}, {bsdf, 1, 1}});
    add(bsdf, "normalmap", map_options, {{texture, 1, 1}, {bsdf, 1, 1}});
    not_yet(bsdf, {"principled", "principledthin", "blendbsdf", "mixturebsdf", "coating", "roughcoating", "difftrans",
                   "hk", "irawan", "measured", "measured_polarized", "hair", "circular", "polarizer", "retarder",
                   "pplastic", "rtrans", "dipole"});

    // Shapes
    const std::vector<ChildRule> of_a_shape{{bsdf}, {emitter}, {sensor}, {medium, 0, 2}};
    const Parameters placed{{"to_world", transform}, {"flip_normals", boolean}};
    const Parameters meshed = placed + Parameters{{"filename", file, required},
                                                  {"face_normals", boolean},
                                                  {"max_smooth_angle", number, legacy | ignored},
                                                  {"collapse", boolean, legacy | ignored}};
    const Parameters uv_flip{{"flip_tex_coords", boolean}};
    add(shape, "obj", meshed + uv_flip, of_a_shape);
    add(shape, "ply", meshed + uv_flip + Parameters{{"srgb", boolean, legacy | ignored}}, of_a_shape);
    add(shape, "serialized", meshed + Parameters{{"shape_index", integer, non_negative}}, of_a_shape);
    add(shape, "rectangle", placed, of_a_shape);
    add(shape, "cube", placed, of_a_shape);
    add(shape, "disk", placed, of_a_shape);
    add(shape, "sphere", placed + Parameters{{"center", point}, {"radius", number, positive}}, of_a_shape);
    not_yet(shape, {"cylinder", "instance", "shapegroup", "merge", "linearcurve", "bsplinecurve", "sdfgrid",
                    "ellipsoids", "ellipsoidsmesh", "hair", "heightfield", "deformable"});

    // Emitters
    const Parameters weight{{"sampling_weight", number, non_negative}};
    add(emitter, "area", weight + Parameters{{"radiance", emission, textured}});
    add(emitter, "point", weight + Parameters{{"intensity", emission}, {"position", point}, {"to_world", transform}});
    add(emitter, "spot",
        weight + Parameters{{"intensity", emission},
                            {"cutoff_angle", number, positive},
                            {"beam_width", number, positive},
                            {"texture", texture_only},
                            {"to_world", transform}});
    add(emitter, "directional",
        weight + Parameters{{"irradiance", emission}, {"direction", vector}, {"to_world", transform}});
    add(emitter, "constant", weight + Parameters{{"radiance", emission}});
    add(emitter, "envmap",
        weight + Parameters{{"filename", file, required},
                            {"scale", number, non_negative},
                            {"to_world", transform},
                            {"mis_compensation", boolean, ignored},
                            {"gamma", number, legacy},
                            {"cache", boolean, legacy | ignored}});
    add(emitter, "sunsky",
        weight + Parameters{{"turbidity", number, positive},
                            {"albedo", reflectance},
                            {"sun_direction", vector},
                            {"scale", number, non_negative | legacy},
                            {"sky_scale", number, non_negative},
                            {"sun_scale", number, non_negative},
                            {"sun_radius_scale", number, non_negative | legacy},
                            {"sun_aperture", number, positive | modern},
                            {"complex_sun", boolean, modern},
                            {"year", integer},
                            {"month", integer},
                            {"day", integer},
                            {"hour", number},
                            {"minute", number},
                            {"second", number},
                            {"latitude", number},
                            {"longitude", number},
                            {"timezone", number},
                            {"stretch", number, positive | legacy},
                            {"extend", boolean, legacy},
                            {"resolution", integer, positive | legacy},
                            {"to_world", transform}});
    add(emitter, "projector",
        weight + Parameters{{"irradiance", emission, textured},
                            {"scale", number, non_negative},
                            {"fov", number, positive},
                            {"fov_axis", string, 0, "x|y|diagonal|smaller|larger"},
                            {"focal_length", string},
                            {"to_world", transform}});
    not_yet(emitter, {"directionalarea", "angulararea", "sun", "sky", "collimated", "timedsunsky", "volumelight",
                      "transientarea"});

    // Sensors, films, filters, samplers
    const std::vector<ChildRule> of_a_sensor{{film}, {sampler}, {medium}};
    const Parameters camera{{"to_world", transform},           {"near_clip", number, positive},
                            {"far_clip", number, positive},    {"focus_distance", number, ignored},
                            {"shutter_open", number, ignored}, {"shutter_close", number, ignored}};
    add(sensor, "perspective",
        camera + Parameters{{"fov", number, positive},
                            {"fov_axis", string, 0, "x|y|diagonal|smaller|larger"},
                            {"focal_length", string},
                            {"principal_point_offset_x", number},
                            {"principal_point_offset_y", number}},
        of_a_sensor);
    add(sensor, "orthographic", camera, of_a_sensor);
    not_yet(sensor, {"thinlens", "telecentric", "spherical", "radiancemeter", "irradiancemeter", "fluencemeter",
                     "distant", "batch", "perspective_rdist"});
    add(sensor, "nlos_capture_meter",
        {{"sensor_origin", point},
         {"account_first_and_last_bounces", boolean, ignored},  // the integrator's parameter counts
         {"original_film_width", integer, unsupported},
         {"original_film_height", integer, unsupported}},
        of_a_sensor);
    const Parameters image{{"width", integer},
                           {"height", integer},
                           {"sample_border", boolean, ignored},
                           {"compensate", boolean, ignored},
                           {"file_format", string, ignored},
                           {"pixel_format", string, ignored},
                           {"component_format", string, ignored},
                           {"crop_offset_x", integer, unsupported},
                           {"crop_offset_y", integer, unsupported},
                           {"crop_width", integer, unsupported},
                           {"crop_height", integer, unsupported},
                           {"high_quality_edges", boolean, legacy | ignored},
                           {"banner", boolean, legacy | ignored},
                           {"attach_log", boolean, legacy | ignored},
                           {"gamma", number, legacy | ignored}};
    add(film, "hdrfilm", image, {{rfilter}});
    const Parameters in_bins =
        image +
        Parameters{{"temporal_bins", integer, positive}, {"start_opl", number}, {"bin_width_opl", number, positive}};
    add(film, "transient_hdr_film",
        in_bins + Parameters{{"exhaustive_scan", boolean},
                             {"laser_scan_width", integer, non_negative},
                             {"laser_scan_height", integer, non_negative}},
        {{rfilter}});
    add(film, "phasor_hdr_film", in_bins, {{rfilter}}, ignored | open);
    add(film, any_type, image, {{rfilter}}, ignored | open);
    add(rfilter, "box", {{"radius", number, positive}});
    add(rfilter, "tent", {{"radius", number, positive}});
    add(rfilter, "gaussian", {{"stddev", number, positive}, {"radius", number, positive | ignored}});
    add(rfilter, any_type, {}, {}, ignored | open);
    const Parameters samples{{"sample_count", integer, positive | ignored},
                             {"seed", integer, ignored},
                             {"jitter", boolean, ignored},
                             {"dimension", integer, ignored},
                             {"scramble", integer, ignored}};
    add(sampler, any_type, samples, {}, ignored | open);

    // Integrators: the type has no effect, its depths have.
    const Parameters depths{{"max_depth", integer},
                            {"rr_depth", integer, positive},
                            {"hide_emitters", boolean},
                            {"strict_normals", boolean, legacy | ignored}};
    add(integrator, "path", depths);
    for (const std::string_view type : {"direct", "direct_projective"})
        add(integrator, type, {{"hide_emitters", boolean}}, {}, ignored | open);
    add(integrator, any_type, depths, {{integrator, 0, any_number}}, ignored | open);
    const Parameters in_time = depths + Parameters{{"camera_unwarp", boolean},
                                                   {"temporal_filter", string, 0, "box|gaussian"},
                                                   {"gaussian_stddev", number, positive},
                                                   {"block_size", integer, ignored}};
    add(integrator, "transient_path", in_time + Parameters{{"discard_direct_light", boolean, ignored}});
    for (const std::string_view type : {"transient_prbvolpath", "transient_prb_volpath"})
        add(integrator, type, in_time, {}, ignored | open);
    add(integrator, "transient_nlos_path",
        in_time + Parameters{{"capture_type", string, numbered, "single|confocal|exhaustive"},
                             {"discard_direct_light", boolean, ignored},
                             {"filter_depth", integer},
                             {"filter_bounces", integer},
                             {"discard_direct_paths", boolean},
                             {"account_first_and_last_bounces", boolean},
                             {"nlos_laser_sampling", boolean},
                             {"nlos_hidden_geometry_sampling", boolean},
                             {"nlos_hidden_geometry_sampling_do_rroulette", boolean},
                             {"nlos_hidden_geometry_sampling_includes_relay_wall", boolean},
                             {"nlos_hidden_geometry_sampling_max_depth", integer},
                             {"force_equal_illumination_scanning", boolean},
                             {"illumination_scan_fov", number, positive}});

    // Textures
    const Parameters bitmap_options{{"filename", file, required},
                                    {"filter_type", string, 0, "nearest|bilinear/trilinear|ewa"},
                                    {"wrap_mode", string, 0, "repeat|mirror|clamp"},
                                    {"raw", boolean},
                                    {"to_uv", uv_transform},
                                    {"format", string, ignored},
                                    {"accel", boolean, ignored},
                                    {"gamma", number, legacy},
                                    {"channel", string, legacy | unsupported},
                                    {"wrap_mode_u", string, legacy | unsupported},
                                    {"wrap_mode_v", string, legacy | unsupported},
                                    {"max_anisotropy", number, legacy | ignored},
                                    {"cache", boolean, legacy | ignored}};
    add(texture, "bitmap", bitmap_options);
    add(texture, "checkerboard", {{"color0", reflectance}, {"color1", reflectance}, {"to_uv", uv_transform}});
    add(texture, "rawconstant", {{"value", index, required}});
    not_yet(texture, {"scale", "gridtexture", "wireframe", "curvature", "vertexcolors", "mesh_attribute", "volume",
                      "uniform", "d65", "srgb"});

    not_yet(medium, {"homogeneous", "heterogeneous"});
    not_yet(phase, {"hg", "isotropic", "rayleigh", "tabphase", "blendphase", "sggx", "microflake"});
    not_yet(spectrum, {"uniform", "d65", "srgb", "regular", "irregular", "blackbody", "rawconstant"});
    return table;
}

}  // namespace

const std::vector<PluginSchema>& all_plugins() {
    static const std::vector<PluginSchema> plugins = make_table();
    return plugins;
}

const PluginSchema* find_plugin(Category category, std::string_view type) {
    const PluginSchema* any = nullptr;
    for (const PluginSchema& plugin : all_plugins()) {
        if (plugin.category != category) continue;
        if (plugin.type == type) return &plugin;
        if (plugin.type == any_type) any = &plugin;
    }
    return any;
}

const PluginSchema& scene_schema() {
    return all_plugins().front();
}

std::vector<std::string> plugin_names(Category category, bool legacy_dialect) {
    std::vector<std::string> names;
    for (const PluginSchema& plugin : all_plugins())
        if (plugin.category == category && plugin.type != any_type && !(plugin.flags & unsupported) &&
            (legacy_dialect || !(plugin.flags & legacy)))
            names.emplace_back(plugin.type);
    return names;
}

std::vector<std::string> parameter_names(const PluginSchema& plugin, bool legacy_dialect) {
    std::vector<std::string> names;
    for (const Parameter& parameter : plugin.parameters)
        if (!(parameter.flags & unsupported) && !(parameter.flags & (legacy_dialect ? modern : legacy)))
            names.emplace_back(legacy_dialect ? camel_case(parameter.name) : std::string(parameter.name));
    return names;
}

}  // namespace loom
