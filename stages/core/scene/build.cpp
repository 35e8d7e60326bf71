#include "stages/core/scene/build.h"

#include <fmt/format.h>
#include <tbb/parallel_for.h>

#include <algorithm>

#include "formats/io/content_hash.h"
#include "formats/io/error.h"
#include "stages/core/description/schema.h"
#include "stages/core/scene/embree.h"
#include "stages/core/scene/materials.h"
#include "stages/core/scene/nlos.h"
#include "stages/core/sky/sunsky.h"

namespace loom {
namespace {

constexpr double rad_per_deg = pi_double / 180.0;

Point3f to_point(const Point3<double>& p) {
    return Point3f(p);
}

Mesh plane_mesh(std::vector<Point3f> positions, std::vector<Point2f> uvs, std::vector<std::uint32_t> indices) {
    return {std::move(positions), {}, std::move(uvs), std::move(indices)};
}

Mesh rectangle_mesh() {
    return plane_mesh({{-1, -1, 0}, {1, -1, 0}, {1, 1, 0}, {-1, 1, 0}}, {{0, 0}, {1, 0}, {1, 1}, {0, 1}},
                      {0, 1, 2, 2, 3, 0});
}

/// Makes the cube [-1,1]^3 with four vertices per face, in Mitsuba's order (it determines the texture coordinates).
Mesh cube_mesh() {
    static constexpr int corners[6][4] = {{4, 5, 1, 0}, {6, 2, 3, 7}, {4, 6, 7, 5},
                                          {5, 7, 3, 1}, {1, 3, 2, 0}, {6, 4, 0, 2}};
    Mesh mesh;
    for (const auto& face : corners) {
        const auto base = std::uint32_t(mesh.positions.size());
        for (int k = 0; k < 4; ++k) {
            // Bits 2, 1, 0 of a corner: the signs of x, y, z.
            const int c = face[k];
            mesh.positions.push_back({c & 4 ? 1.f : -1.f, c & 2 ? 1.f : -1.f, c & 1 ? 1.f : -1.f});
        }
        mesh.uvs.insert(mesh.uvs.end(), {{0, 1}, {1, 1}, {1, 0}, {0, 0}});
        for (std::uint32_t k : {0u, 1u, 2u, 3u, 0u, 2u}) mesh.indices.push_back(base + k);
    }
    return mesh;
}

/// Transforms a flat-faced mesh of build.cpp; the faces of a mirrored one stay on the side of their transformed
/// normals.
void place_flat(Mesh& mesh, const Matrix4d& world) {
    transform(mesh, world);
    if (world.determinant3() < 0)
        for (std::size_t i = 0; i < mesh.indices.size(); i += 3) std::swap(mesh.indices[i + 1], mesh.indices[i + 2]);
}

Vector3f column(const Matrix4d& m, int k) {
    return {float(m(0, k)), float(m(1, k)), float(m(2, k))};
}

void fill_shape(const Object& o, Shape& shape, std::vector<std::string>& notes) {
    const Matrix4d world = o.get_transform("to_world");
    const bool mirrored = world.determinant3() < 0;
    if (o.plugin == "rectangle" || o.plugin == "cube") {
        shape.mesh = o.plugin == "rectangle" ? rectangle_mesh() : cube_mesh();
        place_flat(shape.mesh, world);
        shape.flip_normals = o.get_bool("flip_normals", false);
    } else if (o.plugin == "sphere") {
        shape.kind = ShapeKind::sphere;
        shape.round.center = to_point(world.point(o.get_point("center", {0, 0, 0})));
        const Vector3<double> axis = world.vector({1, 0, 0});
        const double scale = length(axis);
        for (int k = 1; k < 3; ++k) {
            const Vector3f other = column(world, k);
            if (std::abs(length(other) - scale) > 1e-3 * scale)
                o.fail("to_world", "a sphere cannot be scaled differently along its axes; use a mesh");
        }
        shape.round.radius = float(o.get_double("radius", 1.0) * scale);
        if (!(shape.round.radius > 0)) o.fail("radius", "the radius of a sphere must be positive");
        shape.round.u_axis = normalize(column(world, 0));
        shape.round.v_axis = normalize(column(world, 1));
        shape.round.w_axis = normalize(column(world, 2));
        shape.flip_normals = o.get_bool("flip_normals", false) != mirrored;
    } else if (o.plugin == "disk") {
        shape.kind = ShapeKind::disk;
        shape.round.center = to_point(world.point({0, 0, 0}));
        shape.round.u_axis = column(world, 0);
        shape.round.v_axis = column(world, 1);
        shape.flip_normals = o.get_bool("flip_normals", false) != mirrored;
    } else {
        shape.mesh = load_mesh(o, notes);
    }
}

double shape_area(const Shape& shape, std::vector<double>* triangle_areas) {
    if (shape.kind == ShapeKind::sphere) return 4 * pi_double * sqr(double(shape.round.radius));
    if (shape.kind == ShapeKind::disk) return pi_double * length(cross(shape.round.u_axis, shape.round.v_axis));
    const Mesh& mesh = shape.mesh;
    double sum = 0;
    for (std::size_t t = 0; t < mesh.n_triangles(); ++t) {
        const std::uint32_t* i = &mesh.indices[3 * t];
        const Point3<double> a(mesh.positions[i[0]]), b(mesh.positions[i[1]]), c(mesh.positions[i[2]]);
        const double area = 0.5 * length(cross(b - a, c - a));
        triangle_areas->push_back(area);
        sum += area;
    }
    return sum;
}

/// Returns the index of the relay wall of an NLOS capture; -1 for any other scene.
int find_relay_wall(const std::vector<ObjectPtr>& shapes) {
    for (std::size_t i = 0; i < shapes.size(); ++i)
        if (shapes[i]->child(Category::sensor)) return int(i);
    return -1;
}

/// Returns the tangent for the field of view along x; without one, for a lens of `focal_length` on 35 mm film (its
/// diagonal).
double tan_half_fov(const Object& o, double aspect) {
    const double x_of_diagonal = aspect / std::sqrt(1 + aspect * aspect);
    if (!o.has("fov")) {
        const double focal_length_mm = std::strtod(o.get_string("focal_length", "50mm").c_str(), nullptr);
        if (!(focal_length_mm > 0)) o.fail("focal_length", "expected a positive length such as 50mm");
        return std::sqrt(36.0 * 36 + 24 * 24) / (2 * focal_length_mm) * x_of_diagonal;
    }
    const double fov = o.get_double("fov");
    if (!(fov > 0 && fov < 180)) o.fail("fov", "the field of view must lie between 0 and 180 degrees");
    const double t = std::tan(0.5 * fov * rad_per_deg);
    std::string axis = o.get_string("fov_axis", "x");
    if (axis == "smaller") axis = aspect > 1 ? "y" : "x";
    if (axis == "larger") axis = aspect > 1 ? "x" : "y";
    return axis == "y" ? t * aspect : axis == "diagonal" ? t * x_of_diagonal : t;
}

void build_sensor(const Object& root, const Object* relay_wall, Sensor& s, TransientFilm& transient) {
    const ObjectPtr o = relay_wall ? relay_wall->child(Category::sensor) : root.child(Category::sensor);
    if (!o) root.fail("", "the scene has no sensor");
    s.kind = relay_wall                    ? SensorKind::nlos_capture_meter
             : o->plugin == "orthographic" ? SensorKind::orthographic
                                           : SensorKind::perspective;
    s.world_from_camera = o->get_transform("to_world").m;
    if (relay_wall) {
        const Point3<double> origin = o->get_point("sensor_origin", {0, 0, 0});
        s.world_from_camera = {1, 0, 0, origin.x, 0, 1, 0, origin.y, 0, 0, 1, origin.z, 0, 0, 0, 1};
    }
    s.near_clip = o->get_double("near_clip", 1e-2);
    s.far_clip = o->get_double("far_clip", 1e4);
    if (!(s.near_clip > 0 && s.far_clip > s.near_clip)) o->fail("near_clip", "needs 0 < near_clip < far_clip");
    s.principal_x = o->get_float("principal_point_offset_x", 0.0f);
    s.principal_y = o->get_float("principal_point_offset_y", 0.0f);
    if (const ObjectPtr film = o->child(Category::film)) {
        s.width = std::uint32_t(film->get_int("width", 768));
        s.height = std::uint32_t(film->get_int("height", 576));
        if (is_transient_film(*film)) {
            transient.n_bins =
                std::uint32_t(film->get_int("temporal_bins", film->plugin == "phasor_hdr_film" ? 4096 : 2048));
            transient.start_opl = film->get_double("start_opl", 0.0);
            transient.bin_width_opl = film->get_double("bin_width_opl", 0.003);
        }
        if (const ObjectPtr filter = film->child(Category::rfilter)) {
            if (filter->plugin == "box") {
                s.filter = Filter::box;
                s.filter_radius = filter->get_float("radius", 0.5f);
            } else if (filter->plugin == "tent") {
                s.filter = Filter::tent;
                s.filter_radius = filter->get_float("radius", 1.0f);
            } else {  // other filters are replaced by this one
                s.gaussian_stddev = filter->get_float("stddev", 0.5f);
                s.filter_radius = 4 * s.gaussian_stddev;
            }
        }
    }
    if (s.kind == SensorKind::perspective) s.tan_half_fov_x = tan_half_fov(*o, double(s.width) / s.height);
    s.prepare();
}

/// Reads the path integrator's limits; a wrapper such as `moment` uses those of the wrapped integrator.
void build_limits(const Object& root, View& view) {
    ObjectPtr o = root.child(Category::integrator);
    while (o && o->child(Category::integrator)) o = o->child(Category::integrator);
    if (!o) return;
    const bool transient = o->plugin.starts_with("transient_");
    // Python integrators of Mitsuba and mitransient end at depth 6 by default.
    const bool in_python = transient || o->plugin.starts_with("prb");
    view.max_depth = o->plugin.starts_with("direct") ? 2 : o->get_int("max_depth", in_python ? 6 : -1);
    view.rr_depth = o->get_int("rr_depth", 5);
    view.hides_emitters = o->get_bool("hide_emitters", false);
    if (!transient) return;
    view.transient.camera_segment = o->plugin == "transient_nlos_path"
                                        ? o->get_bool("account_first_and_last_bounces", false)
                                        : !o->get_bool("camera_unwarp", false);
    if (o->get_string("temporal_filter", "box") == "gaussian")
        view.transient.sigma_opl = o->get_double("gaussian_stddev", 2.0) * view.transient.bin_width_opl;
}

/// Notes a near plane: camera rays of Mitsuba start on it, and mitransient counts lengths from there.
///                                                                                                  [mitransient 1.3.1]
void note_near_plane(const Sensor& s, const TransientFilm& film, std::vector<std::string>& notes) {
    if (film.n_bins == 0 || !film.camera_segment || s.kind == SensorKind::nlos_capture_meter) return;
    constexpr std::uint32_t most = 16;  // sampled columns and rows
    double sum = 0, least = INFINITY, longest = 0;
    const std::uint32_t columns = std::min(s.width, most), rows = std::min(s.height, most);
    for (std::uint32_t j = 0; j < rows; ++j)
        for (std::uint32_t i = 0; i < columns; ++i) {
            const std::uint32_t x = std::uint32_t((i + 0.5) * s.width / columns),
                                y = std::uint32_t((j + 0.5) * s.height / rows);
            const double before_plane = s.sample_ray(x, y, {0.5f, 0.5f}).t_min;
            sum += before_plane;
            least = std::min(least, before_plane);
            longest = std::max(longest, before_plane);
        }
    const double mean = sum / (double(columns) * rows);
    constexpr double worth_saying = 0.05;  // threshold of the note, in bins
    if (!(mean > worth_saying * film.bin_width_opl)) return;
    notes.push_back(
        fmt::format("near_clip {:.6g}: mitransient counts optical lengths from the near plane, Pathloom from the "
                    "camera, so that light arrives {:.4g} to {:.4g} later here ({:.3g} bins); "
                    "START={:.6g} makes the cubes agree",
                    s.near_clip, least, longest, mean / film.bin_width_opl, film.start_opl + mean));
}

Framef frame_of(const Matrix4d& world) {
    return {normalize(column(world, 0)), normalize(column(world, 1)), Normal3f(normalize(column(world, 2)))};
}

/// Adds the texture of a light to the scene. Returns its index.
int add_light_texture(const Object& texture, Scene& scene, TextureCache& cache) {
    scene.textures.push_back(make_texture(texture, cache));
    const std::shared_ptr<const TextureImage>& image = scene.textures.back().image;
    if (image && std::any_of(image->floats.begin(), image->floats.end(), [](float x) { return x < 0; }))
        texture.fail("filename", "the image has negative values; an emitter cannot emit them");
    return int(scene.textures.size()) - 1;
}

/// Reads a parameter of an emitter that may be textured. Returns the index of the texture, with factor 1, or -1 with
/// the constant.
int textured_spectrum(const Object& o, const char* name, Spectrum& value, Scene& scene, TextureCache& cache) {
    const auto got = o.get_texture_or_rgb(name, Spectrum(1));
    const auto* texture = std::get_if<ObjectPtr>(&got);
    value = texture ? Spectrum(1) : std::get<Spectrum>(got);
    return texture ? add_light_texture(**texture, scene, cache) : -1;
}

bool emits_light(const Emitter& e, const Scene& scene) {
    if (e.map) return true;
    return !is_black(e.radiance) && (e.texture_idx < 0 || !is_black(scene.textures[std::size_t(e.texture_idx)].mean()));
}

/// Fills scene.emitter_pmf. Emitters without light keep their probability, so that switching a light off does not
/// change the choice of any other.
void build_choice_of_lights(const std::vector<ObjectPtr>& emitters, Scene& scene) {
    const bool any_light = std::any_of(scene.emitters.begin(), scene.emitters.end(),
                                       [&](const Emitter& e) { return emits_light(e, scene); });
    if (!any_light) scene.notes.push_back("no emitter of the scene emits light: its images are black");
    if (scene.emitters.empty()) return;
    std::vector<double> weights;
    for (const Emitter& e : scene.emitters) weights.push_back(e.sampling_weight);
    if (std::all_of(weights.begin(), weights.end(), [](double w) { return w == 0; })) {
        if (any_light)
            emitters.front()->fail(
                "sampling_weight",
                "'sampling_weight' is 0 for every emitter of the scene, so that none can be sampled");
        weights.assign(weights.size(), 1);
    }
    scene.emitter_pmf = Distribution1(weights);
}

void build_emitter(const Object& o, Scene& scene, TextureCache& cache) {
    Emitter e;
    e.id = o.id;
    e.sampling_weight = o.get_float("sampling_weight", 1.0f);
    const Matrix4d world = o.get_transform("to_world");
    e.frame = frame_of(world);
    const int index = int(scene.emitters.size());
    if (o.plugin == "point" || o.plugin == "spot") {
        e.kind = o.plugin == "point" ? EmitterKind::point : EmitterKind::spot;
        e.radiance = o.get_rgb("intensity", Spectrum(1));
        e.position = to_point(world.point(o.get_point("position", {0, 0, 0})));
        if (e.kind == EmitterKind::spot) {
            const double cutoff = o.get_double("cutoff_angle", 20.0), beam = o.get_double("beam_width", cutoff * 0.75);
            if (!(cutoff > 0 && cutoff <= 180 && beam >= 0 && beam <= cutoff))
                o.fail("beam_width", "needs 0 <= beam_width <= cutoff_angle <= 180 degrees");
            e.cutoff_rad = float(cutoff * rad_per_deg);
            e.beam_rad = float(beam * rad_per_deg);
            if (const ObjectPtr t = o.get_object("texture")) e.texture_idx = add_light_texture(*t, scene, cache);
        }
    } else if (o.plugin == "projector") {
        e.kind = EmitterKind::projector;
        e.texture_idx = textured_spectrum(o, "irradiance", e.radiance, scene, cache);
        e.radiance = e.radiance * o.get_float("scale", 1.0f);
        e.position = to_point(world.point({0, 0, 0}));
        const TextureImage* image = e.texture_idx >= 0 ? scene.textures[e.texture_idx].image.get() : nullptr;
        const double aspect = image ? double(image->width) / image->height : 1.0;
        const double tan_x = tan_half_fov(o, aspect);
        e.tan_x = float(tan_x);
        e.tan_y = float(tan_x / aspect);
    } else if (o.plugin == "directional") {
        e.kind = EmitterKind::directional;
        e.radiance = o.get_rgb("irradiance", Spectrum(1));
        if (o.has("direction")) {
            const Vector3<double> d = world.vector(o.get_vector("direction", {0, 0, 1}));
            if (!(length(d) > 0)) o.fail("direction", "the direction has no length");
            e.frame = Framef(Normal3f(normalize(Vector3f(d))));
        }
    } else {
        if (scene.environment_idx >= 0) o.fail("", "only one environment emitter is possible");
        scene.environment_idx = index;
        e.kind = o.plugin == "constant" ? EmitterKind::constant : EmitterKind::envmap;
        if (e.kind == EmitterKind::constant) {
            e.radiance = o.get_rgb("radiance", Spectrum(1));
        } else {
            e.map = std::make_shared<EnvironmentMap>(o.plugin == "envmap" ? load_environment(o, cache, scene.notes)
                                                                          : bake_sunsky(o, scene.notes));
            if (o.plugin == "sunsky") e.frame = sunsky_frame(o, e.frame);
            if (!e.map->prepare()) {
                e.kind = EmitterKind::constant;
                e.map.reset();
            }
        }
    }
    scene.emitters.push_back(std::move(e));
}

void record_triangles(Shape& shape) {
    const Mesh& mesh = shape.mesh;
    shape.triangles.reserve(mesh.n_triangles());
    for (std::size_t t = 0; t < mesh.n_triangles(); ++t) {
        const std::uint32_t* i = &mesh.indices[3 * t];
        const Point3f& p0 = mesh.positions[i[0]];
        const TriangleGeometry<float> triangle{p0, mesh.positions[i[1]] - p0, mesh.positions[i[2]] - p0};
        const Normal3f n = triangle.normal();
        shape.triangles.push_back({triangle, as_stored(shape.flip_normals ? -n : n)});
    }
}

/// Whether the corners of a rectangle are in the order (0, 0), (1, 0), (1, 1), (0, 1) in texture space, not reversed.
bool is_parallelogram(const Object& shape) {
    return shape.plugin == "rectangle" && shape.get_transform("to_world").determinant3() > 0;
}

void build_area_light(const Object& o, bool parallelogram, std::uint32_t shape_index, Scene& scene,
                      TextureCache& cache) {
    if (o.plugin != "area") o.fail("", "a shape can only have an area emitter");
    Emitter e;
    e.id = o.id;
    e.sampling_weight = o.get_float("sampling_weight", 1.0f);
    e.shape_idx = shape_index;
    e.parallelogram = parallelogram;
    e.texture_idx = textured_spectrum(o, "radiance", e.radiance, scene, cache);
    std::vector<double> areas;
    Shape& shape = scene.shapes[shape_index];
    e.area = shape_area(shape, &areas);
    if (!(e.area > 0)) o.fail("", "the shape of this emitter has no area");
    if (!areas.empty()) e.triangles = Distribution1(areas);
    for (std::size_t t = 0; t < areas.size(); ++t) {
        const Normal3f n = shape.triangles[t].normal();
        e.normals.push_back(shape.flip_normals ? -n : n);
    }
    shape.emitter_idx = int(scene.emitters.size());
    scene.emitters.push_back(std::move(e));
}

void find_features(Scene& scene) {
    SceneFeatures& f = scene.features;
    std::vector<bool> used(scene.materials.size(), false);
    for (const Shape& s : scene.shapes) {
        used[s.material_idx] = true;
        if (scene.materials[s.material_idx].back_idx >= 0) used[scene.materials[s.material_idx].back_idx] = true;
        f.smooth_normals |= !s.mesh.normals.empty();
    }
    for (std::size_t i = 0; i < used.size(); ++i) {
        if (!used[i]) continue;
        const Material& m = scene.materials[i];
        f.textured_diffuse |= m.diffuse_idx >= 0;
        f.textured_specular |= m.specular_idx >= 0;
        f.textured_transmittance |= m.transmittance_idx >= 0;
        f.textured_alpha |= m.alpha_u_idx >= 0 || m.alpha_v_idx >= 0;
        f.textured_opacity |= m.opacity_idx >= 0;
        f.textured_exponent |= m.exponent_idx >= 0;
        f.textured_index |= m.textured_index();
        f.perturbed_normals |= m.perturbed();
        const BsdfKind k = m.model.kind;
        const bool rough = k == BsdfKind::rough_conductor || k == BsdfKind::rough_dielectric || k == BsdfKind::ward;
        f.anisotropic |= rough && (m.model.alpha_u != m.model.alpha_v || m.alpha_u_idx != m.alpha_v_idx);
        f.dielectric |= k == BsdfKind::dielectric || k == BsdfKind::rough_dielectric;
        f.null_lobes |= k == BsdfKind::null || m.opacity_idx >= 0 || m.model.opacity < 1;
        f.delta_lobes |= k == BsdfKind::conductor || k == BsdfKind::dielectric || k == BsdfKind::thin_dielectric ||
                         k == BsdfKind::plastic;
    }
    f.delta_lobes |= f.null_lobes;
    f.smooth_normals |= f.perturbed_normals;
}

void find_bounds(Scene& scene) {
    Box3f all;
    for (const Shape& s : scene.shapes) {
        Box3f box = s.bounds();
        // The size of a scene must not depend on the rotation of its disks about their axes.
        if (s.kind == ShapeKind::disk) {
            box = {s.round.center, s.round.center};
            box.grow(std::max(length(s.round.u_axis), length(s.round.v_axis)));
        }
        all.add(box);
    }
    if (scene.shapes.empty()) return;
    scene.center = all.lo + (all.hi - all.lo) * 0.5f;
    scene.radius = 0.5f * length(all.hi - all.lo);
}

}  // namespace

View read_view(const Object& root) {
    const auto shapes = root.children(Category::shape);
    const int relay_wall = find_relay_wall(shapes);
    View view;
    build_sensor(root, relay_wall < 0 ? nullptr : shapes[std::size_t(relay_wall)].get(), view.sensor, view.transient);
    build_limits(root, view);
    return view;
}

std::unique_ptr<Scene> load_scene(const std::filesystem::path& file, const Defines& defines,
                                  const std::string& sensor) {
    return build_scene(read_scene(file, defines, sensor));
}

namespace {

std::shared_ptr<const RayEngine> make_engine(const Scene& scene, const KnownParts& known) {
    if (!known.scene) return std::make_shared<RayEngine>(scene.shapes);
    std::vector<std::uint32_t> of_base(known.scene->shapes.size());
    for (std::size_t i = 0; i < known.shape_idx.size(); ++i)
        if (known.shape_idx[i] != KnownParts::none) of_base[known.shape_idx[i]] = std::uint32_t(i);
    // Keeps the whole scene, whose shapes the engine borrows.
    std::shared_ptr<const RayEngine> base(known.scene, known.scene->rays.get());
    return std::make_shared<RayEngine>(scene.shapes, std::move(base), std::move(of_base));
}

}  // namespace

std::unique_ptr<Scene> build_scene(SceneDescription description, const KnownParts& known) {
    const Object& root = *description.root;
    auto scene = std::make_unique<Scene>();
    scene->notes = std::move(description.notes);
    scene->notes.insert(scene->notes.end(), description.warnings.begin(), description.warnings.end());
    const auto shapes = root.children(Category::shape);
    const int relay_wall = find_relay_wall(shapes);
    const View view = read_view(root);
    scene->sensor = view.sensor;
    scene->transient = view.transient;
    scene->max_depth = view.max_depth;
    scene->rr_depth = view.rr_depth;
    scene->hides_emitters = view.hides_emitters;
    note_near_plane(scene->sensor, scene->transient, scene->notes);

    TextureCache own_cache;
    TextureCache& cache = known.images ? *known.images : own_cache;
    MaterialBuilder materials(*scene, cache);
    scene->shapes.resize(shapes.size());
    std::vector<std::vector<std::string>> notes(shapes.size());
    tbb::parallel_for(std::size_t(0), shapes.size() + 1, [&](std::size_t i) {
        // One task reads the textures while the others read meshes.
        if (i == 0) {
            for (const ObjectPtr& o : shapes) materials.decode_images(o->child(Category::bsdf));
            return;
        }
        if (known.scene && known.shape_idx[i - 1] != KnownParts::none) {
            scene->shapes[i - 1] = known.scene->shapes[known.shape_idx[i - 1]];
            scene->shapes[i - 1].emitter_idx = -1;
            for (const Property& property : shapes[i - 1]->properties) property.is_read = true;
            return;
        }
        fill_shape(*shapes[i - 1], scene->shapes[i - 1], notes[i - 1]);
        record_triangles(scene->shapes[i - 1]);
        scene->shapes[i - 1].hit_error = hit_error(scene->shapes[i - 1]);
    });
    std::vector<ObjectPtr> emitters;  // in the order of scene->emitters
    for (std::size_t i = 0; i < shapes.size(); ++i) {
        Shape& shape = scene->shapes[i];
        shape.id = shapes[i]->id;
        shape.material_idx = materials.index(shapes[i]->child(Category::bsdf));
        if (const ObjectPtr e = shapes[i]->child(Category::emitter)) {
            build_area_light(*e, is_parallelogram(*shapes[i]), std::uint32_t(i), *scene, cache);
            emitters.push_back(e);
        }
        scene->notes.insert(scene->notes.end(), notes[i].begin(), notes[i].end());
    }
    for (const ObjectPtr& o : root.children(Category::emitter)) {
        build_emitter(*o, *scene, cache);
        emitters.push_back(o);
    }
    for (std::string& note : cache.notes()) scene->notes.push_back(std::move(note));
    if (scene->emitters.size() > 65535) root.fail("", "more than 65535 emitters");
    if (scene->materials.size() > 65535) root.fail("", "more than 65535 materials");
    build_choice_of_lights(emitters, *scene);
    find_features(*scene);
    find_bounds(*scene);
    scene->rays = scene->camera_rays = make_engine(*scene, known);
    const bool has_area_lights =
        std::any_of(scene->shapes.begin(), scene->shapes.end(), [](const Shape& s) { return s.emitter_idx >= 0; });
    if (scene->hides_emitters && has_area_lights)
        scene->camera_rays = std::make_shared<RayEngine>(scene->shapes, RayEngine::Use::camera_rays);
    scene->sensor_media = find_sensor_media(*scene);
    if (const ObjectPtr o = root.child(Category::integrator); o && o->plugin == "transient_nlos_path")
        build_nlos(root, relay_wall < 0 ? nullptr : shapes[std::size_t(relay_wall)].get(), std::uint32_t(relay_wall),
                   *scene);

    const std::vector<std::string> unread = unread_parameters(root);
    scene->notes.insert(scene->notes.end(), unread.begin(), unread.end());

    std::string identity;
    for (const auto& [name, value] : description.parameters) identity += fmt::format("{}={}\n", name, value);
    if (description.sensor > 0) identity += fmt::format("sensor {}\n", description.sensor);
    for (const std::string& name : description.files) identity += file_content_hash(name) + "\n";
    scene->content_hash = content_hash(std::as_bytes(std::span(identity)));
    return scene;
}

void set_camera(Scene& scene, const Object& root) {
    scene.sensor = read_view(root).sensor;
    scene.sensor_media = find_sensor_media(scene);
}

Defines parse_defines(const std::vector<std::string>& texts) {
    Defines defines;
    for (const std::string& text : texts) {
        const auto equals = text.find('=');
        if (equals == std::string::npos || equals == 0)
            throw InputError(fmt::format("-D {}: expected NAME=VALUE", text));
        defines.emplace_back(text.substr(0, equals), text.substr(equals + 1));
    }
    return defines;
}

}  // namespace loom
