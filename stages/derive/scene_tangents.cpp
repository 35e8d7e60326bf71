#include "stages/derive/scene_tangents.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <functional>
#include <map>
#include <optional>

#include "formats/io/error.h"
#include "stages/core/app/values.h"
#include "stages/core/edit/scene_match.h"
#include "stages/core/scene/build.h"
#include "stages/core/scene/materials.h"
#include "stages/core/scene/nlos.h"

namespace loom::derive {

bool AffineVelocity::is_zero() const {
    return std::all_of(linear.begin(), linear.end(), [](double x) { return x == 0; }) && offset == Vector3<double>{};
}

bool MaterialTangent::is_zero() const {
    bool zero = true;
    each(*this, [&](double x) { zero &= x == 0; });
    return zero;
}

bool MaterialTangent::scatters() const {
    MaterialTangent without = *this;
    without.int_ior = 0;
    return !without.is_zero();
}

MaterialTangent MaterialTangent::operator*(double s) const {
    MaterialTangent scaled = *this;
    each(scaled, [&](double& x) { x *= s; });
    return scaled;
}

MaterialTangent& MaterialTangent::operator+=(const MaterialTangent& o) {
    std::vector<double> others;
    each(o, [&](double x) { others.push_back(x); });
    std::size_t i = 0;
    each(*this, [&](double& x) { x += others[i++]; });
    return *this;
}

bool SceneTangents::any_shape_moves() const {
    for (std::uint32_t s = 0; s < shapes.size(); ++s)
        if (moves(s)) return true;
    return false;
}

bool SceneTangents::geometry() const {
    const auto some = [](const auto& effects) { return !effects.empty(); };
    return any_shape_moves() || camera_moves() || std::any_of(emitters.begin(), emitters.end(), some);
}

namespace {

using Vec = Vector3<double>;
using Pt = Point3<double>;

AffineVelocity translation(const Vec& direction) {
    AffineVelocity v;
    v.offset = direction;
    return v;
}

/// Rotation about an axis through a point, by one radian per unit.
AffineVelocity rotation(const Vec& axis, const Pt& through) {
    AffineVelocity v;
    v.linear = {0, -axis.z, axis.y, axis.z, 0, -axis.x, -axis.y, axis.x, 0};
    v.offset = -v.turned(Vec(through));
    return v;
}

AffineVelocity growth(const Pt& about) {
    AffineVelocity v;
    v.linear = {1, 0, 0, 0, 1, 0, 0, 0, 1};
    v.offset = -Vec(about);
    return v;
}

Vec unit_axis(int k) {
    Vec v;
    v[k] = 1;
    return v;
}

/// Derivatives at 0 from values at steps of one parameter; exact for polynomials of degree 4.
struct Stencil {
    std::array<double, 5> at;      // steps, from 0
    std::array<double, 4> weight;  // of the values at the others; that at 0 makes the sum of weights 0
    /// f'(0) of f(step index) -> double
    template <class F>
    double operator()(F&& f) const {
        // From differences, what does not change has a derivative of exactly 0.
        const double now = f(0);
        double sum = 0;
        for (std::size_t i = 1; i < at.size(); ++i) sum += weight[i - 1] * (f(i) - now);
        return sum;
    }
    static Stencil central(double h) {
        return {{0, -2 * h, -h, h, 2 * h}, {1 / (12 * h), -8 / (12 * h), 8 / (12 * h), -1 / (12 * h)}};
    }
    /// Towards larger values for h > 0, towards smaller ones for h < 0.
    static Stencil one_sided(double h) {
        return {{0, h, 2 * h, 3 * h, 4 * h}, {48 / (12 * h), -36 / (12 * h), 16 / (12 * h), -3 / (12 * h)}};
    }
};

/// The descriptions of a scene at the steps of a stencil.
struct Variants {
    Stencil stencil;
    std::vector<SceneDescription> at;  // [step]; [0]: as it is
    std::string name;

    const Object& root(std::size_t i) const { return *at[i].root; }
};

/// Drops what the rounding of text and matrices leaves of a zero.
double cleaned(double x, double scale) {
    constexpr double rounding = 1e-11;
    return std::abs(x) < rounding * scale ? 0 : x;
}

/// A' A^-1 from matrices at the steps; A at step 0.
AffineVelocity velocity(const Stencil& stencil, const std::function<Matrix4d(std::size_t)>& matrix) {
    std::array<Matrix4d, 5> at;
    for (std::size_t i = 0; i < at.size(); ++i) at[i] = matrix(i);
    Matrix4d rate;
    double size = 0;
    for (int r = 0; r < 3; ++r)
        for (int c = 0; c < 4; ++c) {
            size = std::max(size, std::abs(at[0](r, c)));
            rate(r, c) = stencil([&](std::size_t i) { return at[i](r, c); });
        }
    for (int r = 0; r < 3; ++r)
        for (int c = 0; c < 4; ++c) rate(r, c) = cleaned(rate(r, c), std::max(size, 1.0));
    const std::array<double, 9> inverse_transpose = at[0].normal_matrix();
    AffineVelocity v;
    for (int r = 0; r < 3; ++r)
        for (int c = 0; c < 3; ++c)
            for (int k = 0; k < 3; ++k)
                v.linear[std::size_t(3 * r + c)] += rate(r, k) * inverse_transpose[std::size_t(3 * c + k)];
    const Vec moved = v.turned({at[0](0, 3), at[0](1, 3), at[0](2, 3)});
    v.offset = Vec{rate(0, 3), rate(1, 3), rate(2, 3)} - moved;
    return v;
}

MaterialTangent material_tangent(const Stencil& stencil, const std::function<const BsdfModel&(std::size_t)>& model) {
    const auto number = [&](auto&& get) {
        return cleaned(stencil([&](std::size_t i) { return double(get(model(i))); }),
                       1e5 * std::abs(double(get(model(0)))));
    };
    const auto colour = [&](Spectrum BsdfModel::*member) {
        Rgb<double> d;
        for (int c = 0; c < 3; ++c) d[c] = number([&](const BsdfModel& m) { return (m.*member)[c]; });
        return d;
    };
    MaterialTangent t;
    t.diffuse = colour(&BsdfModel::diffuse);
    t.specular = colour(&BsdfModel::specular);
    t.transmittance = colour(&BsdfModel::transmittance);
    t.eta_c = colour(&BsdfModel::eta_c);
    t.k_c = colour(&BsdfModel::k_c);
    t.alpha_u = number([](const BsdfModel& m) { return m.alpha_u; });
    t.alpha_v = number([](const BsdfModel& m) { return m.alpha_v; });
    t.eta = number([](const BsdfModel& m) { return m.eta(); });
    t.opacity = number([](const BsdfModel& m) { return m.opacity; });
    t.exponent = number([](const BsdfModel& m) { return m.exponent; });
    t.int_ior = number([](const BsdfModel& m) { return m.int_ior; });
    return t;
}

/// Finds the effects of one $parameter by reading the scene at several of its values.
class Finder {
  public:
    Finder(const Scene& scene, const Variants& variants, std::uint32_t parameter, SceneTangents& out)
        : scene_(scene), v_(variants), parameter_(parameter), out_(out) {}

    void find() {
        compare_shapes();
        compare_emitters();
        compare_view();
    }

  private:
    [[noreturn]] void refuse(const Object& object, const std::string& why) const {
        object.fail("", fmt::format("with ${}, {}: no derivative by it", v_.name, why));
    }

    /// Returns the objects of a category by step, as many in each, of equal plugins.
    std::vector<Objects> objects(Category category) const {
        std::vector<Objects> all;
        for (std::size_t i = 0; i < v_.at.size(); ++i) {
            all.push_back(v_.root(i).children(category));
            if (all[i].size() != all[0].size())
                v_.root(0).fail("", fmt::format("with ${}, the number of {}s changes: no derivative by it", v_.name,
                                                loom::name(category)));
            for (std::size_t k = 0; k < all[i].size(); ++k)
                if (all[i][k]->plugin != all[0][k]->plugin)
                    refuse(*all[0][k], fmt::format("{} becomes {}", all[0][k]->plugin, all[i][k]->plugin));
        }
        return all;
    }

    bool differs(const std::vector<Objects>& all, std::size_t k, auto&& text) {
        for (std::size_t i = 1; i < all.size(); ++i)
            if (text(*all[i][k]) != text(*all[0][k])) return true;
        return false;
    }

    void compare_shapes() {
        const std::vector<Objects> shapes = objects(Category::shape);
        for (std::size_t k = 0; k < shapes[0].size(); ++k) {
            const Object& shape = *shapes[0][k];
            if (differs(shapes, k, [&](const Object& o) { return texts_.text(o); })) {
                if (differs(shapes, k, [&](const Object& o) { return texts_.form(o); }))
                    refuse(shape, "its form changes otherwise than by to_world");
                AffineVelocity v = velocity(v_.stencil, [&](std::size_t i) { return placement(*shapes[i][k]); });
                if (!v.is_zero()) {
                    if (is_wall(k)) refuse(shape, "the relay wall of an NLOS capture moves");
                    out_.shapes[k].push_back({parameter_, v});
                }
            }
            compare_bsdf(shapes, k);
            compare_area_light(shapes, k);
        }
    }
    bool is_wall(std::size_t shape) const { return scene_.nlos && scene_.nlos->relay_wall == shape; }

    void compare_bsdf(const std::vector<Objects>& shapes, std::size_t k) {
        const auto bsdf = [](const Object& o) { return o.child(Category::bsdf); };
        if (!differs(shapes, k, [&](const Object& o) { return texts_.text(bsdf(o)); })) return;
        const std::uint32_t front = scene_.shapes[k].material_idx;
        if (std::find(materials_done_.begin(), materials_done_.end(), front) != materials_done_.end()) return;
        materials_done_.push_back(front);
        std::vector<Scene> scratch(v_.at.size());
        std::vector<std::uint32_t> index;
        for (std::size_t i = 0; i < scratch.size(); ++i)
            index.push_back(MaterialBuilder(scratch[i], cache_).index(bsdf(*shapes[i][k])));
        const auto material = [&](std::size_t i, bool back) -> const Material& {
            const Material& m = scratch[i].materials[index[i]];
            return back ? scratch[i].materials[std::size_t(m.back_idx)] : m;
        };
        const int back = scene_.materials[front].back_idx;
        bool any = false;
        for (const bool behind : {false, true}) {
            if (behind && back < 0) continue;
            for (std::size_t i = 1; i < scratch.size(); ++i)
                check_textures(*bsdf(*shapes[0][k]), scratch[0], scratch[i]);
            const MaterialTangent t = material_tangent(
                v_.stencil, [&](std::size_t i) -> const BsdfModel& { return material(i, behind).model; });
            if (t.is_zero()) continue;
            any = true;
            out_.materials[behind ? std::size_t(back) : front].push_back({parameter_, t});
        }
        if (!any) refuse(*bsdf(*shapes[0][k]), "none of its numbers changes");
    }

    void check_textures(const Object& bsdf, const Scene& a, const Scene& b) const {
        bool same = a.textures.size() == b.textures.size() && a.materials.size() == b.materials.size();
        for (std::size_t i = 0; same && i < a.textures.size(); ++i) {
            const Texture &s = a.textures[i], &t = b.textures[i];
            same = s.to_uv == t.to_uv && s.color0 == t.color0 && s.color1 == t.color1 && s.image == t.image;
        }
        for (std::size_t i = 0; same && i < a.materials.size(); ++i) {
            const Material &s = a.materials[i], &t = b.materials[i];
            same = s.bump_scale == t.bump_scale && s.reflectance_scale == t.reflectance_scale &&
                   s.index_scale == t.index_scale && s.model.kind == t.model.kind;
        }
        if (!same) refuse(bsdf, "one of its textures changes");
    }

    void compare_area_light(const std::vector<Objects>& shapes, std::size_t k) {
        const auto light = [](const Object& o) { return o.child(Category::emitter); };
        if (!light(*shapes[0][k]) || !differs(shapes, k, [&](const Object& o) { return texts_.text(light(o)); }))
            return;
        Objects lights;
        for (const Objects& at : shapes) lights.push_back(light(*at[k]));
        add_radiance(lights, "radiance", std::uint32_t(scene_.shapes[k].emitter_idx));
    }

    /// Adds the change of an emission that is a constant colour; refuses other changes.
    void add_radiance(const Objects& lights, const char* parameter, std::uint32_t emitter) {
        Rgb<double> rate;
        for (int c = 0; c < 3; ++c)
            rate[c] = v_.stencil([&](std::size_t i) {
                const auto got = lights[i]->get_texture_or_rgb(parameter, Spectrum(1));
                if (std::holds_alternative<ObjectPtr>(got)) refuse(*lights[0], "its texture changes");
                return double(std::get<Spectrum>(got)[c]);
            });
        if (rate == Rgb<double>{}) refuse(*lights[0], "it changes otherwise than in its " + std::string(parameter));
        out_.radiance[emitter].push_back({parameter_, rate});
    }

    void compare_emitters() {
        const std::vector<Objects> all = objects(Category::emitter);
        const std::size_t first = scene_.emitters.size() - all[0].size();  // area lights come first
        for (std::size_t k = 0; k < all[0].size(); ++k) {
            if (!differs(all, k, [&](const Object& o) { return texts_.text(o); })) continue;
            const Object& light = *all[0][k];
            const Emitter& emitter = scene_.emitters[first + k];
            if (scene_.nlos) refuse(light, "the laser of an NLOS capture changes");
            bool any = false;
            const AffineVelocity v = velocity(v_.stencil, [&](std::size_t i) { return pose(*all[i][k]); });
            if (!v.is_zero()) out_.emitters[first + k].push_back({parameter_, v}), any = true;
            Objects lights;
            for (const Objects& at : all) lights.push_back(at[k]);
            const char* colour = emitter.kind == EmitterKind::directional || emitter.kind == EmitterKind::projector
                                     ? "irradiance"
                                 : emitter.kind == EmitterKind::constant && light.plugin == "constant" ? "radiance"
                                 : emitter.is_delta()                                                  ? "intensity"
                                                                                                       : "scale";
            if (differs(all, k, [&](const Object& o) {
                    const Property* p = o.find(colour);
                    return p ? texts_.value(o, *p) : std::string();
                })) {
                add_radiance(lights, colour, std::uint32_t(first + k)), any = true;
            }
            if (!any) refuse(light, "it changes otherwise than in position and radiance");
        }
    }
    /// Position and axes of an emitter without area.
    static Matrix4d pose(const Object& light) {
        const Matrix4d world = light.get_transform("to_world");
        if (light.plugin == "directional" && light.has("direction")) {
            // The direction's own axes: only the turn of the direction counts.
            const Vec d = normalize(world.vector(light.get_vector("direction", {0, 0, 1})));
            const Frame<double> axes{Normal3<double>(d)};
            Matrix4d m;
            for (int r = 0; r < 3; ++r) m(r, 0) = axes.s[r], m(r, 1) = axes.t[r], m(r, 2) = d[r];
            return m;
        }
        const Pt p = light.get_point("position", {0, 0, 0});
        return world * Matrix4d::translation(p.x, p.y, p.z);
    }

    void compare_view() {
        std::vector<View> views;
        for (std::size_t i = 0; i < v_.at.size(); ++i) views.push_back(read_view(v_.root(i)));
        const View& now = views[0];
        for (const View& view : views) {
            const Sensor &a = now.sensor, &b = view.sensor;
            if (a.width != b.width || a.height != b.height || a.kind != b.kind || a.filter != b.filter ||
                a.filter_radius != b.filter_radius || a.gaussian_stddev != b.gaussian_stddev)
                v_.root(0).fail("", fmt::format("with ${}, the film changes: no derivative by it", v_.name));
            if (a.near_clip != b.near_clip || a.far_clip != b.far_clip || a.principal_x != b.principal_x ||
                a.principal_y != b.principal_y || now.max_depth != view.max_depth ||
                now.hides_emitters != view.hides_emitters || now.transient.n_bins != view.transient.n_bins ||
                now.transient.start_opl != view.transient.start_opl ||
                now.transient.bin_width_opl != view.transient.bin_width_opl)
                v_.root(0).fail("", fmt::format("with ${}, more of the sensor changes than its to_world and field of "
                                                "view: no derivative by it",
                                                v_.name));
        }
        const AffineVelocity v = velocity(v_.stencil, [&](std::size_t i) {
            Matrix4d m;
            m.m = views[i].sensor.world_from_camera;
            return m;
        });
        const double lens = cleaned(
            v_.stencil([&](std::size_t i) { return views[i].sensor.tan_half_fov_x; }) / now.sensor.tan_half_fov_x, 1);
        if (scene_.nlos && !(v.is_zero() && lens == 0))
            v_.root(0).fail("",
                            fmt::format("with ${}, the sensor of an NLOS capture moves: no derivative by it", v_.name));
        if (!v.is_zero()) out_.camera.push_back({parameter_, v});
        if (lens != 0) out_.lens.push_back({parameter_, lens});
    }

    const Scene& scene_;
    const Variants& v_;
    std::uint32_t parameter_;
    SceneTangents& out_;
    CanonicalTexts texts_;
    TextureCache cache_;
    std::vector<std::uint32_t> materials_done_;
};

/// Reads the scene at the steps of a central stencil, or of a one-sided one where values beyond are refused.
Variants read_variants(const SceneDescription& description, const std::filesystem::path& file, const Defines& defines,
                       const std::string& sensor, const std::string& name, double value) {
    // Large against the rounding of colours to float, small against a turn in degrees.
    const double h = value == 0 ? 1e-2 : std::min(1e-2 * std::abs(value), 5.0);
    std::string why;
    for (const Stencil& stencil : {Stencil::central(h), Stencil::one_sided(h), Stencil::one_sided(-h)}) {
        Variants variants{stencil, {}, name};
        variants.at.push_back(description);
        try {
            for (std::size_t i = 1; i < stencil.at.size(); ++i) {
                Defines with = defines;
                with.emplace_back(name, fmt::format("{:.17g}", value + stencil.at[i]));
                variants.at.push_back(read_scene(file, with, sensor));
                (void)read_view(*variants.at.back().root);
            }
            return variants;
        } catch (const InputError& error) {
            if (why.empty()) why = error.what();
        }
    }
    throw InputError(fmt::format("--wrt {}: the scene cannot be read at {} = {} plus and minus {:.3g}: {}", name, name,
                                 value, h, why));
}

/// Adds the effects of named parts of a scene.
class NamedParts {
  public:
    NamedParts(const Scene& scene, SceneTangents& out) : scene_(scene), out_(out) {}

    /// out:     false when the text is not of a named part's form
    bool add(const std::string& text) {
        text_ = text;
        const auto colon = text.find(':');
        if (text == "sensor/pose") return add_camera(), true;
        if (colon == std::string::npos) return false;
        const std::string category = text.substr(0, colon);
        const auto slash = text.find('/', colon);
        if (slash == std::string::npos) refuse("expected CATEGORY:ID/PART");
        const std::string id = text.substr(colon + 1, slash - colon - 1), part = text.substr(slash + 1);
        if (category == "shape") return add_shape(id, part), true;
        if (category == "bsdf") return add_bsdf(index_of(scene_.materials, id, "BSDF"), part), true;
        if (category == "emitter") return add_emitter(index_of(scene_.emitters, id, "emitter"), part), true;
        refuse(fmt::format("'{}' is none of shape, bsdf, emitter", category));
    }

  private:
    [[noreturn]] void refuse(const std::string& why) const {
        throw InputError(fmt::format("--wrt {}: {}", text_, why));
    }

    template <class Things>
    std::uint32_t index_of(const Things& things, const std::string& id, const char* what) const {
        for (std::size_t i = 0; i < things.size(); ++i)
            if (things[i].id == id) return std::uint32_t(i);
        std::string known;
        for (const auto& thing : things) known += (known.empty() ? "" : ", ") + thing.id;
        refuse(fmt::format("the scene has no {} '{}'; it has {}", what, id, known.empty() ? "none" : known));
    }

    std::uint32_t column(const std::string& component, const std::string& unit, double value = 0) {
        out_.parameters.push_back({component.empty() ? text_ : text_ + "." + component, unit, value});
        return std::uint32_t(out_.parameters.size() - 1);
    }

    /// Six columns: translations along x, y, z (m) and rotations about the axes through a centre (rad).
    void add_pose(Effects<AffineVelocity>& effects, const Pt& centre) {
        static constexpr std::array<const char*, 3> shift{"x", "y", "z"}, turn{"rx", "ry", "rz"};
        for (int k = 0; k < 3; ++k) effects.push_back({column(shift[std::size_t(k)], "m"), translation(unit_axis(k))});
        for (int k = 0; k < 3; ++k)
            effects.push_back({column(turn[std::size_t(k)], "rad"), rotation(unit_axis(k), centre)});
    }

    Pt centre(const Shape& shape) const {
        const Box3f box = shape.bounds();
        return Pt(box.lo + (box.hi - box.lo) * 0.5f);
    }

    void add_shape(const std::string& id, const std::string& part) {
        const std::uint32_t s = index_of(scene_.shapes, id, "shape");
        const Shape& shape = scene_.shapes[s];
        if (scene_.nlos && scene_.nlos->relay_wall == s && (part == "pose" || part == "scale" || part == "vertices"))
            refuse("the relay wall of an NLOS capture cannot move");
        if (part == "pose") {
            add_pose(out_.shapes[s], centre(shape));
        } else if (part == "scale") {
            out_.shapes[s].push_back({column("", "1"), growth(centre(shape))});
        } else if (part == "normals") {
            static constexpr std::array<const char*, 3> turn{"rx", "ry", "rz"};
            for (int k = 0; k < 3; ++k)
                out_.shading_normals[s].push_back({column(turn[std::size_t(k)], "rad"), rotation(unit_axis(k), {})});
        } else if (part == "vertices") {
            add_vertices(s);
        } else if (part == "radiance") {
            if (shape.emitter_idx < 0) refuse("the shape emits no light");
            add_emitter(std::uint32_t(shape.emitter_idx), part);
        } else if (part.starts_with("bsdf/")) {
            add_bsdf(shape.material_idx, part.substr(5));
        } else {
            refuse(fmt::format("'{}' is none of pose, scale, normals, vertices, radiance, bsdf/PARAMETER", part));
        }
    }

    /// Three columns for each distinct position of a mesh.
    void add_vertices(std::uint32_t s) {
        const Shape& shape = scene_.shapes[s];
        if (shape.kind != ShapeKind::mesh) refuse("a sphere or disk has no vertices");
        if (shape.emitter_idx >= 0) refuse("vertices of an emitter cannot move alone");
        std::map<std::array<float, 3>, std::vector<std::uint32_t>> distinct;
        std::vector<std::array<float, 3>> order;
        for (std::uint32_t i = 0; i < shape.mesh.positions.size(); ++i) {
            const Point3f& p = shape.mesh.positions[i];
            auto& copies = distinct[{p.x, p.y, p.z}];
            if (copies.empty()) order.push_back({p.x, p.y, p.z});
            copies.push_back(i);
        }
        out_.vertices[s].resize(shape.mesh.positions.size());
        for (std::size_t k = 0; k < order.size(); ++k)
            for (int axis = 0; axis < 3; ++axis) {
                const std::uint32_t p = column(fmt::format("{}.{}", k, "xyz"[axis]), "m");
                for (const std::uint32_t i : distinct[order[k]]) out_.vertices[s][i].push_back({p, unit_axis(axis)});
            }
    }

    void add_bsdf(std::uint32_t m, std::string part) {
        const Material& material = scene_.materials[m];
        bool by_channel = false;
        if (part.ends_with("/rgb")) by_channel = true, part.resize(part.size() - 4);
        struct Colour {
            const char* name;
            Rgb<double> MaterialTangent::*member;
            Spectrum BsdfModel::*value;
            int texture;
        };
        const Colour colours[] = {
            {"reflectance", &MaterialTangent::diffuse, &BsdfModel::diffuse, material.diffuse_idx},
            {"diffuse_reflectance", &MaterialTangent::diffuse, &BsdfModel::diffuse, material.diffuse_idx},
            {"specular_reflectance", &MaterialTangent::specular, &BsdfModel::specular, material.specular_idx},
            {"specular_transmittance", &MaterialTangent::transmittance, &BsdfModel::transmittance,
             material.transmittance_idx},
            {"eta", &MaterialTangent::eta_c, &BsdfModel::eta_c, material.eta_c_idx},
            {"k", &MaterialTangent::k_c, &BsdfModel::k_c, material.k_c_idx},
        };
        const BsdfModel& model = material.model;
        for (const Colour& colour : colours) {
            if (part != colour.name) continue;
            if (colour.texture >= 0) refuse(fmt::format("'{}' is textured", part));
            for (int c = 0; c < (by_channel ? 3 : 1); ++c) {
                MaterialTangent t;
                if (by_channel)
                    (t.*colour.member)[c] = 1;
                else
                    t.*colour.member = Rgb<double>(1);
                const std::string channel(by_channel ? std::string(1, "rgb"[c]) : std::string());
                add_material(m, column(channel, "1", double((model.*colour.value)[c])), t);
            }
            return;
        }
        MaterialTangent t;
        double value = 0;
        if (part == "alpha") {
            t.alpha_u = t.alpha_v = 1, value = model.alpha_u;
        } else if (part == "alpha_u") {
            t.alpha_u = 1, value = model.alpha_u;
        } else if (part == "alpha_v") {
            t.alpha_v = 1, value = model.alpha_v;
        } else if (part == "int_ior") {
            t.eta = 1 / model.ext_ior, t.int_ior = 1, value = model.int_ior;
        } else if (part == "exponent") {
            t.exponent = 1, value = model.exponent;
        } else if (part == "opacity") {
            t.opacity = 1, value = model.opacity;
        } else {
            refuse(
                fmt::format("'{}' is none of reflectance, diffuse_reflectance, specular_reflectance, "
                            "specular_transmittance, eta, k (each also with /rgb), alpha, alpha_u, alpha_v, int_ior, "
                            "exponent, opacity",
                            part));
        }
        add_material(m, column("", "1", value), t);
    }
    void add_material(std::uint32_t m, std::uint32_t parameter, const MaterialTangent& t) {
        out_.materials[m].push_back({parameter, t});
        if (const int back = scene_.materials[m].back_idx; back >= 0)
            out_.materials[std::size_t(back)].push_back({parameter, t});
    }

    void add_emitter(std::uint32_t e, const std::string& part) {
        const Emitter& emitter = scene_.emitters[e];
        if (part == "radiance" || part == "intensity" || part == "irradiance") {
            if (emitter.kind == EmitterKind::envmap || emitter.texture_idx >= 0) {
                out_.radiance[e].push_back({column("", "1", 1), Rgb<double>(1)});
            } else {
                out_.radiance[e].push_back({column("", "W m^-2 sr^-1", double(emitter.radiance.r)), Rgb<double>(1)});
            }
        } else if (part == "pose") {
            if (emitter.kind == EmitterKind::area) refuse("an area light moves with its shape: shape:ID/pose");
            if (scene_.nlos) refuse("the laser of an NLOS capture cannot move");
            add_pose(out_.emitters[e], Pt(emitter.position));
        } else {
            refuse(fmt::format("'{}' is none of radiance, pose", part));
        }
    }

    void add_camera() {
        if (scene_.nlos) refuse("the sensor of an NLOS capture cannot move");
        const auto& m = scene_.sensor.world_from_camera;
        add_pose(out_.camera, {m[3], m[7], m[11]});
    }

    const Scene& scene_;
    SceneTangents& out_;
    std::string text_;
};

}  // namespace

SceneTangents find_tangents(const Scene& scene, const SceneDescription& description, const std::filesystem::path& file,
                            const Defines& defines, const std::string& sensor, const std::vector<std::string>& names) {
    SceneTangents tangents(scene);
    for (const std::string& name : names) {
        if (NamedParts(scene, tangents).add(name)) continue;
        const auto found = description.parameters.find(name);
        if (found == description.parameters.end()) {
            std::string known;
            for (const auto& [parameter, value] : description.parameters)
                known += (known.empty() ? "" : ", ") + parameter;
            throw InputError(fmt::format("--wrt {}: {} has no parameter ${}; it has {}", name, file.native(), name,
                                         known.empty() ? "none" : known));
        }
        const std::optional<double> value = app::parse_number<double>(found->second);
        if (!value)
            throw InputError(
                fmt::format("--wrt {}: its value '{}' in {} is not a number", name, found->second, file.native()));
        const Variants variants = read_variants(description, file, defines, sensor, name, *value);
        tangents.parameters.push_back({name, fmt::format("unit of ${}", name), *value});
        Finder(scene, variants, std::uint32_t(tangents.n() - 1), tangents).find();
    }
    return tangents;
}

}  // namespace loom::derive
