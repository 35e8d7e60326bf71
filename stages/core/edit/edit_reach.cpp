#include "stages/core/edit/edit_reach.h"

#include <fmt/format.h>

#include <cstring>
#include <map>
#include <tuple>

namespace loom {
namespace {

/// Relative enlargement of obstacles; a ray's rounding is 1 % of it.
constexpr float margin = 1e-5f;
/// Maximum distance (m) from its vertex at which a ray may start in a scene.
float largest_offset(const Scene& scene) {
    float error = 0;
    for (const Shape& shape : scene.shapes) error = std::max(error, shape.hit_error);
    const Point3f& c = scene.center;
    return 2 * rounding_bound * (std::abs(c.x) + std::abs(c.y) + std::abs(c.z) + 2 * scene.radius) + error;
}

float largest(const Point3f& p) {
    return std::max({std::abs(p.x), std::abs(p.y), std::abs(p.z)});
}

template <class T>
bool same_bits(const std::vector<T>& a, const std::vector<T>& b) {
    return a.size() == b.size() && (a.empty() || std::memcmp(a.data(), b.data(), a.size() * sizeof(T)) == 0);
}

bool same_geometry(const Shape& a, const Shape& b) {
    return a.kind == b.kind && a.flip_normals == b.flip_normals && a.round.center == b.round.center &&
           a.round.radius == b.round.radius && a.round.u_axis == b.round.u_axis && a.round.v_axis == b.round.v_axis &&
           a.round.w_axis == b.round.w_axis && same_bits(a.mesh.positions, b.mesh.positions) &&
           same_bits(a.mesh.normals, b.mesh.normals) && same_bits(a.mesh.uvs, b.mesh.uvs) &&
           same_bits(a.mesh.indices, b.mesh.indices);
}

bool same_image(const TextureImage& a, const TextureImage& b) {
    return a.width == b.width && a.height == b.height && a.grey == b.grey && a.decode == b.decode &&
           same_bits(a.bytes, b.bytes) && same_bits(a.floats, b.floats);
}

bool same_texture(const Texture& a, const Texture& b) {
    const auto numbers = [](const Texture& t) {
        return std::tie(t.kind, t.wrap, t.nearest, t.to_uv, t.color0, t.color1, t.swaps_numbers);
    };
    if (numbers(a) != numbers(b) || !a.image != !b.image) return false;
    return a.image == b.image || same_image(*a.image, *b.image);
}

bool same_model(const BsdfModel& a, const BsdfModel& b) {
    const auto numbers = [](const BsdfModel& m) {
        return std::tie(m.kind, m.distribution, m.two_sided, m.nonlinear, m.sample_visible, m.variant, m.bump_shadowing,
                        m.int_ior, m.ext_ior, m.opacity, m.alpha_u, m.alpha_v, m.exponent, m.diffuse, m.specular,
                        m.transmittance, m.eta_c, m.k_c, m.coat.fdr_int, m.coat.fdr_ext, m.coat.external_transmittance);
    };
    return numbers(a) == numbers(b);
}

bool same_map(const EnvironmentMap& a, const EnvironmentMap& b) {
    return a.width == b.width && a.height == b.height && same_bits(a.texels, b.texels);
}

/// Compares the parts of two scenes, each pair once.
class Comparison {
  public:
    Comparison(const Scene& old_scene, const Scene& new_scene) : old_(old_scene), new_(new_scene) {}

    bool same_material(int a, int b) {
        if (a < 0 || b < 0) return a < 0 && b < 0;
        const auto known = materials_.find({a, b});
        if (known != materials_.end()) return known->second;
        const Material &m = old_.materials[std::size_t(a)], &n = new_.materials[std::size_t(b)];
        bool same = same_model(m.model, n.model) && m.bump_scale == n.bump_scale &&
                    m.reflectance_scale == n.reflectance_scale && m.index_scale == n.index_scale &&
                    m.flips_invalid_normals == n.flips_invalid_normals && same_material(m.back_idx, n.back_idx);
        for (const auto texture :
             {&Material::diffuse_idx, &Material::specular_idx, &Material::transmittance_idx, &Material::alpha_u_idx,
              &Material::alpha_v_idx, &Material::opacity_idx, &Material::exponent_idx, &Material::eta_c_idx,
              &Material::k_c_idx, &Material::normal_map_idx, &Material::bump_map_idx})
            same = same && same_texture(m.*texture, n.*texture);
        return materials_[{a, b}] = same;
    }
    /// Ignores the shape of an area light.
    bool same_emitter(const Emitter& a, const Emitter& b) {
        const auto numbers = [](const Emitter& e) {
            return std::tie(e.kind, e.radiance, e.area, e.parallelogram, e.frame.s, e.frame.t, e.frame.n, e.position,
                            e.cutoff_rad, e.beam_rad, e.tan_x, e.tan_y);
        };
        if (numbers(a) != numbers(b) || !same_texture(a.texture_idx, b.texture_idx) || !a.map != !b.map) return false;
        return a.map == b.map || same_map(*a.map, *b.map);
    }

  private:
    bool same_texture(int a, int b) {
        if (a < 0 || b < 0) return a < 0 && b < 0;
        const auto known = textures_.find({a, b});
        if (known != textures_.end()) return known->second;
        return textures_[{a, b}] = loom::same_texture(old_.textures[std::size_t(a)], new_.textures[std::size_t(b)]);
    }

    const Scene &old_, &new_;
    std::map<std::pair<int, int>, bool> materials_, textures_;
};

bool same_sensor(const Sensor& a, const Sensor& b) {
    const auto numbers = [](const Sensor& s) {
        return std::tie(s.kind, s.width, s.height, s.filter, s.filter_radius, s.gaussian_stddev, s.world_from_camera,
                        s.tan_half_fov_x, s.principal_x, s.principal_y, s.near_clip, s.far_clip);
    };
    return numbers(a) == numbers(b);
}

/// Whether holds(material) is true for a material and for that of its back.
template <class Holds>
bool of_both_sides(const Scene& scene, std::uint32_t material, Holds&& holds) {
    const Material& front = scene.materials[material];
    return holds(front) && (front.back_idx < 0 || holds(scene.materials[std::size_t(front.back_idx)]));
}

/// Returns an enlarged copy with only the members that a ray engine reads.
Shape enlarged(const Shape& shape) {
    Shape large;
    large.kind = shape.kind;
    large.round.center = shape.round.center;
    large.round.radius = shape.round.radius * (1 + margin) + margin * largest(shape.round.center);
    const float more =
        1 + margin * (1 + largest(shape.round.center) /
                              std::max(std::min(length(shape.round.u_axis), length(shape.round.v_axis)), 1e-20f));
    large.round.u_axis = shape.round.u_axis * more;
    large.round.v_axis = shape.round.v_axis * more;
    large.round.w_axis = shape.round.w_axis;
    const auto& index = shape.mesh.indices;
    for (std::size_t i = 0; i + 2 < index.size(); i += 3) {
        const Point3f corners[] = {shape.mesh.positions[index[i]], shape.mesh.positions[index[i + 1]],
                                   shape.mesh.positions[index[i + 2]]};
        const Point3f centre = corners[0] + ((corners[1] - corners[0]) + (corners[2] - corners[0])) * (1.0f / 3);
        for (const Point3f& p : corners) {
            const Vector3f out = p - centre;
            const float size = length(out);
            large.mesh.indices.push_back(std::uint32_t(large.mesh.positions.size()));
            large.mesh.positions.push_back(size > 0 ? p + out * (margin * (1 + largest(p) / size)) : p);
        }
    }
    return large;
}

}  // namespace

void Obstacles::add(const Shape& shape) {
    Box3f box = shape.bounds();
    if (!(box.lo.x <= box.hi.x)) return;  // a mesh without triangles
    box.grow(margin * (largest(box.lo) + largest(box.hi)));
    box_.add(box);
    boxes_.push_back(box);
    shapes_.push_back(enlarged(shape));
}

void Obstacles::finish(float around) {
    if (empty()) return;
    rays_ = std::make_unique<RayEngine>(shapes_);
    box_.grow(around);
    for (Box3f& box : boxes_) box.grow(around);
    constexpr std::size_t most = 32;  // testing more boxes costs more than it saves
    if (boxes_.size() > most) boxes_ = {box_};
}

bool Obstacles::may_meet(const Point3f& a, const Vector3f& d) const {
    float beyond = 0;
    for (int k = 0; k < 3; ++k) beyond += std::max(std::abs(box_.lo[k] - a[k]), std::abs(box_.hi[k] - a[k]));
    return may_meet(a, a + d * (2 * beyond));
}

namespace {

/// Fills an EditReach in steps.
class ReachFinder {
  public:
    ReachFinder(EditReach& out, const Scene& old_scene, const Scene& new_scene, const Edit& edit)
        : out_(out), old_(old_scene), new_(new_scene), edit_(edit), compare_(old_scene, new_scene) {}

    void find() {
        compare_shapes();
        out_.everything = reason_for_everything();
        if (!out_.everything.empty()) return;
        compare_emitters();
        mark_shapes_of_emitters();
        const int sky = old_.environment_idx;
        out_.sky = sky != new_.environment_idx || (sky >= 0 && out_.emitters[std::size_t(sky)]);
        bound_emitters();
    }

  private:
    static constexpr std::uint32_t none = ShapeEdit::none;

    bool stays(const ShapeEdit& shape, std::uint32_t old_idx, std::uint32_t new_idx) const {
        return shape.partner_idx != none && !shape.dynamic() &&
               same_geometry(old_.shapes[old_idx], new_.shapes[new_idx]);
    }

    void compare_shapes() {
        for (std::uint32_t i = 0; i < old_.shapes.size(); ++i) compare_shape(i);
        for (std::uint32_t j = 0; j < new_.shapes.size(); ++j)
            if (const ShapeEdit& shape = edit_.new_shapes[j]; !stays(shape, shape.partner_idx, j))
                out_.new_places.add(new_.shapes[j]);
        const float around = std::max(largest_offset(old_), largest_offset(new_));
        out_.old_places.finish(around);
        out_.new_places.finish(around);
    }

    void compare_shape(std::uint32_t i) {
        const ShapeEdit& shape = edit_.old_shapes[i];
        const Shape& before = old_.shapes[i];
        const bool in_place = stays(shape, i, shape.partner_idx);
        if (!in_place) {
            out_.old_places.add(before);
            scatters_alike_.push_back(false);
            out_.shapes.push_back(true);
            out_.repainted.push_back(-1);
            return;
        }
        const Shape& after = new_.shapes[shape.partner_idx];
        scatters_alike_.push_back(!(shape.changes & shape_change::repainted) &&
                                  compare_.same_material(int(before.material_idx), int(after.material_idx)));
        const bool same = scatters_alike_[i] && !shape.dyed();
        out_.shapes.push_back(!same);
        const bool only_repainted =
            !same && before.emitter_idx < 0 && after.emitter_idx < 0 &&
            of_both_sides(old_, before.material_idx, [](const Material& m) { return !m.perturbed(); }) &&
            of_both_sides(new_, after.material_idx, [](const Material& m) { return !m.needs_uv(); });
        out_.repainted.push_back(only_repainted ? int(after.material_idx) : -1);
    }

    /// Returns why every path may have changed; empty: some may be unchanged.
    std::string reason_for_everything() const {
        std::string reason;
        if (!same_sensor(old_.sensor, new_.sensor)) reason = "the cameras differ in their last digits";
        if (old_.features.anisotropic != new_.features.anisotropic)
            reason = "only one of the scenes has an anisotropic surface, which turns all shading frames";
        const std::size_t n = old_.emitters.size();
        if (n != new_.emitters.size())
            reason =
                fmt::format("{} lights, now {}: the same random number picks another light", n, new_.emitters.size());
        for (std::uint32_t i = 0; reason.empty() && i < n; ++i) {
            const std::uint32_t partner_idx = edit_.old_emitters[i].partner_idx;
            if (partner_idx != none && partner_idx != i)
                reason = "the lights are in another order: the same random number picks another light";
            if (n > 1 && old_.emitter_pmf.pmf(i) != new_.emitter_pmf.pmf(i))
                reason = "the lights are chosen with other probabilities";
        }
        return reason;
    }

    void compare_emitters() {
        for (std::uint32_t i = 0; i < old_.emitters.size(); ++i) {
            const Emitter &before = old_.emitters[i], &after = new_.emitters[i];
            const bool area = before.kind == EmitterKind::area;
            const ShapeEdit* shape = area ? &edit_.old_shapes[before.shape_idx] : nullptr;
            const bool in_place = area && stays(*shape, before.shape_idx, after.shape_idx);
            const bool changed = edit_.old_emitters[i].changed || edit_.old_emitters[i].partner_idx == none ||
                                 !compare_.same_emitter(before, after) ||
                                 (area && (shape->partner_idx != after.shape_idx || !in_place));
            Emitter as_before = after;
            as_before.radiance = before.radiance;
            const bool even =
                in_place || (before.kind == EmitterKind::constant && old_.environment_idx == new_.environment_idx);
            out_.relit.push_back(changed && even && before.texture_idx < 0 && !is_black(before.radiance) &&
                                 compare_.same_emitter(before, as_before));
            out_.emitters.push_back(changed && !out_.relit[i]);
            out_.any_emitter |= out_.emitters[i] != 0;
            out_.any_relit |= out_.relit[i] != 0;
        }
    }

    void mark_shapes_of_emitters() {
        for (std::uint32_t i = 0; i < out_.shapes.size(); ++i) {
            const Shape& shape = old_.shapes[i];
            if (shape.emitter_idx < 0) continue;
            const auto emitter = std::size_t(shape.emitter_idx);
            out_.shapes[i] = (out_.shapes[i] || out_.emitters[emitter]) && !(scatters_alike_[i] && out_.relit[emitter]);
            out_.dark_light |= out_.shapes[i] && old_.materials[shape.material_idx].black();
        }
    }

    void bound_emitters() {
        for (const Emitter& emitter : old_.emitters) {
            if (emitter.is_infinite()) out_.bounded_lights = false;
            if (emitter.kind == EmitterKind::area)
                out_.lights.add(old_.shapes[emitter.shape_idx].bounds());
            else
                out_.lights.add(emitter.position);
        }
    }

    EditReach& out_;
    const Scene &old_, &new_;
    const Edit& edit_;
    Comparison compare_;
    std::vector<std::uint8_t> scatters_alike_;  // [shape of the old scene]
};

}  // namespace

EditReach::EditReach(const Scene& old_scene, const Scene& new_scene, const Edit& edit) {
    ReachFinder(*this, old_scene, new_scene, edit).find();
}

}  // namespace loom
