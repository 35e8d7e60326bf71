#include "stages/core/edit/edit.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <optional>

#include "stages/core/edit/scene_match.h"
#include "stages/core/scene/build.h"

namespace loom {
namespace {

std::string shown(const Property* property) {
    if (!property) return "its default";
    struct Show {
        std::string operator()(bool x) const { return x ? "true" : "false"; }
        std::string operator()(std::int64_t x) const { return fmt::format("{}", x); }
        std::string operator()(double x) const { return fmt::format("{:.6g}", x); }
        std::string operator()(const std::string& x) const { return std::filesystem::path(x).filename().string(); }
        std::string operator()(const Spectrum& x) const {
            return fmt::format("({:.6g}, {:.6g}, {:.6g})", x.r, x.g, x.b);
        }
        std::string operator()(const Point3<double>& x) const {
            return fmt::format("({:.6g}, {:.6g}, {:.6g})", x.x, x.y, x.z);
        }
        std::string operator()(const Vector3<double>& x) const {
            return fmt::format("({:.6g}, {:.6g}, {:.6g})", x.x, x.y, x.z);
        }
        std::string operator()(const Matrix4d&) const { return "a transform"; }
        std::string operator()(const ObjectPtr& x) const { return fmt::format("a {}", x->plugin); }
    };
    return std::visit(Show{}, property->value);
}

bool centred(const Object& shape) {
    return shape.plugin == "sphere" || shape.plugin == "cube" || shape.plugin == "rectangle" || shape.plugin == "disk";
}

std::string motion_of(const Object& from, const Object& to) {
    const Matrix4d a = placement(from);
    const std::optional<Matrix4d> motion = rigid_motion(a, placement(to));
    return motion ? motion_words(*motion, a.point({0, 0, 0}), from.category != Category::shape || centred(from))
                  : "elsewhere";
}

/// Lists the differences of two objects of one kind as text: "reflectance (1, 0, 0) -> (0, 0, 1)".
void tell(const Object& a, const Object& b, CanonicalTexts& texts, std::vector<std::string>& words,
          const std::string& what = "") {
    if (texts.text(a) == texts.text(b)) return;
    if (a.plugin != b.plugin) {
        words.push_back(fmt::format("{}{} -> {}", what, a.plugin, b.plugin));
        return;
    }
    std::vector<std::string> names;
    for (const Object* o : {&a, &b})
        for (const Property& p : o->properties)
            if (texts.counts(*o, p) && std::find(names.begin(), names.end(), p.name) == names.end())
                names.push_back(p.name);
    for (const std::string& name : names) {
        const Property *p = a.find(name), *q = b.find(name);
        if (p && q && texts.value(a, *p) == texts.value(b, *q)) continue;
        const auto* inner_a = p ? std::get_if<ObjectPtr>(&p->value) : nullptr;
        const auto* inner_b = q ? std::get_if<ObjectPtr>(&q->value) : nullptr;
        if (inner_a && inner_b)
            tell(**inner_a, **inner_b, texts, words, what + name + ": ");
        else if (name == "to_world")
            words.push_back(what + "moved " + motion_of(a, b));
        else if (p && q && shown(p) == shown(q))
            words.push_back(fmt::format("{}{}: other content", what, shown(p)));
        else
            words.push_back(fmt::format("{}{} {} -> {}", what, name, shown(p), shown(q)));
    }
    if (a.nested.size() != b.nested.size()) {
        words.push_back(fmt::format("{}{} parts -> {}", what, a.nested.size(), b.nested.size()));
        return;
    }
    for (std::size_t i = 0; i < a.nested.size(); ++i) tell(*a.nested[i].first, *b.nested[i].first, texts, words, what);
}

std::string differences(const ObjectPtr& a, const ObjectPtr& b, CanonicalTexts& texts) {
    if (!a || !b) return fmt::format("{} -> {}", a ? a->plugin : "the default", b ? b->plugin : "the default");
    std::vector<std::string> words;
    tell(*a, *b, texts, words);
    return words.empty() ? "its parts are in another order" : fmt::format("{}", fmt::join(words, "; "));
}

/// Names an object without folders, because the text becomes part of an output's plan.
std::string title(const Object& o) {
    return o.has_own_id
               ? o.id
               : fmt::format("the {} at {}", o.plugin, std::filesystem::path(o.at.where()).filename().string());
}

/// Returns the location of a parameter, or of the object that could have it.
Location place(const Object& root, std::initializer_list<Category> way, std::initializer_list<std::string_view> names) {
    const Object* o = &root;
    ObjectPtr child;
    for (Category category : way) {
        child = o->child(category);
        while (child && category == Category::integrator && child->child(category)) child = child->child(category);
        if (!child) return o->at;
        o = child.get();
    }
    for (std::string_view name : names)
        if (const Property* p = o->find(name)) return p->at;
    return o->at;
}

void check_views(const Object& old_root, const Object& new_root, Edit& edit) {
    const View a = read_view(old_root), b = read_view(new_root);
    for (const auto& [root, view] : {std::pair{&old_root, &a}, std::pair{&new_root, &b}})
        if (view->sensor.kind == SensorKind::nlos_capture_meter)
            root->fail("", "an NLOS capture is no image and has no residual; render the new scene by itself");
    const auto refuse = [&](bool differs, std::initializer_list<Category> way,
                            std::initializer_list<std::string_view> names, const std::string& what) {
        if (differs)
            fail(place(new_root, way, names),
                 fmt::format(
                     "{} as in the old scene, at {}: a residual needs equal views; render the new scene by itself",
                     what, place(old_root, way, names).where()));
    };
    using enum Category;
    const Sensor &s = a.sensor, &t = b.sensor;
    refuse(s.width != t.width, {sensor, film}, {"width"},
           fmt::format("the film's width is {}, not {}", t.width, s.width));
    refuse(s.height != t.height, {sensor, film}, {"height"},
           fmt::format("the film's height is {}, not {}", t.height, s.height));
    refuse(s.filter != t.filter || (s.filter == Filter::gaussian ? s.gaussian_stddev != t.gaussian_stddev
                                                                 : s.filter_radius != t.filter_radius),
           {sensor, film, rfilter}, {"radius", "stddev"}, "the pixel filter is not the same");
    refuse(s.kind != t.kind, {sensor}, {}, "the camera is not of the same kind");
    Matrix4d camera_a, camera_b;
    camera_a.m = s.world_from_camera;
    camera_b.m = t.world_from_camera;
    refuse(!same_placement(camera_a, camera_b), {sensor}, {"to_world"},
           "the camera's position or direction is not the same");
    refuse(s.kind == SensorKind::perspective && s.tan_half_fov_x != t.tan_half_fov_x, {sensor},
           {"fov", "focal_length", "fov_axis"}, "the camera's field of view is not the same");
    refuse(s.near_clip != t.near_clip, {sensor}, {"near_clip"}, "the camera's near_clip is not the same");
    refuse(s.far_clip != t.far_clip, {sensor}, {"far_clip"}, "the camera's far_clip is not the same");
    refuse(s.principal_x != t.principal_x, {sensor}, {"principal_point_offset_x"},
           "the camera's principal point is not the same");
    refuse(s.principal_y != t.principal_y, {sensor}, {"principal_point_offset_y"},
           "the camera's principal point is not the same");
    refuse(a.max_depth != b.max_depth, {integrator}, {"max_depth"},
           fmt::format("max_depth is {}, not {}", b.max_depth, a.max_depth));
    refuse(a.hides_emitters != b.hides_emitters, {integrator}, {"hide_emitters"},
           fmt::format("hide_emitters is {}, not {}", b.hides_emitters, a.hides_emitters));
    if (a.rr_depth != b.rr_depth)
        edit.notes.push_back(
            fmt::format("rr_depth {} -> {}: without effect on the mean; both scenes are traced with the new one",
                        a.rr_depth, b.rr_depth));
}

/// Merges lines with equal text about several shapes into one.
class Lines {
  public:
    void add(const std::string& verb, const std::string& who, const std::string& what) {
        for (auto& [v, names, w] : lines_)
            if (v == verb && w == what && !what.empty()) {
                names.push_back(who);
                return;
            }
        lines_.push_back({verb, {who}, what});
    }
    std::vector<std::string> texts() const {
        std::vector<std::string> texts;
        for (const auto& [verb, names, what] : lines_) {
            constexpr std::size_t named = 8;
            std::string who = fmt::format(
                "{}", fmt::join(names.begin(), names.begin() + std::ptrdiff_t(std::min(named, names.size())), ", "));
            if (names.size() > named) who += fmt::format(" and {} more", names.size() - named);
            texts.push_back(fmt::format("{}: {}{}{}", verb, who, what.empty() ? "" : ": ", what));
        }
        return texts;
    }

  private:
    struct Line {
        std::string verb;
        std::vector<std::string> names;
        std::string what;
    };
    std::vector<Line> lines_;
};

}  // namespace

std::string motion_words(const Matrix4d& motion, const Point3<double>& centre, bool has_centre) {
    const auto triple = [](double x, double y, double z) {
        const double largest = std::max({std::abs(x), std::abs(y), std::abs(z)});
        const auto clean = [&](double v) { return std::abs(v) < 1e-9 * largest ? 0.0 : v; };
        return fmt::format("({:.4g}, {:.4g}, {:.4g})", clean(x), clean(y), clean(z));
    };
    // Twice the sine of the angle times the axis; near 180 degrees the axis is in R + 1 instead.
    Vector3<double> axis{motion(2, 1) - motion(1, 2), motion(0, 2) - motion(2, 0), motion(1, 0) - motion(0, 1)};
    const double cosine = std::clamp((motion(0, 0) + motion(1, 1) + motion(2, 2) - 1) / 2, -1.0, 1.0),
                 sine = length(axis) / 2;
    const double angle = std::atan2(sine, cosine);
    constexpr double least_angle = 1e-6;
    const Point3<double> to = motion.point(centre);
    const std::string shift = triple(to.x - centre.x, to.y - centre.y, to.z - centre.z);
    if (angle < least_angle) return "by " + shift;
    if (sine < 1e-4) {
        int k = 0;
        for (int i = 1; i < 3; ++i)
            if (motion(i, i) > motion(k, k)) k = i;
        axis = {motion(0, k) + (k == 0), motion(1, k) + (k == 1), motion(2, k) + (k == 2)};
    }
    axis = axis * (1 / length(axis));
    const std::string turn =
        fmt::format("turned by {:.4g} degrees about {}", angle * 180 / pi_double, triple(axis.x, axis.y, axis.z));
    const Vector3<double> moved{to.x - centre.x, to.y - centre.y, to.z - centre.z};
    if (has_centre)
        return turn + " through its centre" +
               (length(moved) > 1e-6 * (1 + length(Vector3<double>(centre))) ? ", and by " + shift : "");
    // A screw motion: the points of its axis move along it.
    const Vector3<double> t{motion(0, 3), motion(1, 3), motion(2, 3)};
    const double along = dot(t, axis);
    const Vector3<double> across = t - axis * along;
    const Vector3<double> point = (across + cross(axis, across) * (1 / std::tan(angle / 2))) * 0.5;
    const std::string through = " through " + triple(point.x, point.y, point.z);
    const Vector3<double> d = axis * along;
    return turn + through + (std::abs(along) > 1e-6 ? ", and by " + triple(d.x, d.y, d.z) : "");
}

std::size_t Edit::n_dynamic() const {
    return std::size_t(
        std::count_if(new_shapes.begin(), new_shapes.end(), [](const ShapeEdit& s) { return s.dynamic(); }));
}
std::size_t Edit::n_ghosts() const {
    return std::size_t(
        std::count_if(old_shapes.begin(), old_shapes.end(), [](const ShapeEdit& s) { return s.dynamic(); }));
}
std::size_t Edit::n_repainted() const {
    return std::size_t(std::count_if(new_shapes.begin(), new_shapes.end(), [](const ShapeEdit& s) {
        return (s.changes & shape_change::repainted) && !s.dynamic();
    }));
}
std::size_t Edit::n_dyed() const {
    return std::size_t(
        std::count_if(new_shapes.begin(), new_shapes.end(), [](const ShapeEdit& s) { return s.dyed(); }));
}
std::size_t Edit::n_emitters() const {
    const auto changed = [](const EmitterEdit& e) { return e.changed; };
    return std::size_t(std::max(std::count_if(old_emitters.begin(), old_emitters.end(), changed),
                                std::count_if(new_emitters.begin(), new_emitters.end(), changed)));
}

namespace {

constexpr std::uint32_t no_light = EmitterEdit::none;

/// Indices of the area lights of shapes, in the order of build_scene(): area lights by shape, then the emitters of the
/// scene.
struct AreaLights {
    std::vector<std::uint32_t> of_shape;
    std::uint32_t n = 0;

    explicit AreaLights(const Objects& shapes) : of_shape(shapes.size(), no_light) {
        for (std::size_t i = 0; i < shapes.size(); ++i)
            if (shapes[i]->child(Category::emitter)) of_shape[i] = n++;
    }
};

/// Compares two scenes, shape by shape and emitter by emitter.
class EditFinder {
  public:
    EditFinder(const Object& old_root, const Object& new_root)
        : old_shapes_(old_root.children(Category::shape)),
          new_shapes_(new_root.children(Category::shape)),
          old_emitters_(old_root.children(Category::emitter)),
          new_emitters_(new_root.children(Category::emitter)),
          old_lights_(old_shapes_),
          new_lights_(new_shapes_) {
        check_views(old_root, new_root, edit_);
        shape_match_ = match_shapes(old_shapes_, new_shapes_, texts_);
        edit_.old_shapes.resize(old_shapes_.size());
        edit_.new_shapes.resize(new_shapes_.size());
        edit_.old_emitters.assign(old_lights_.n + old_emitters_.size(), {true, no_light});
        edit_.new_emitters.assign(new_lights_.n + new_emitters_.size(), {true, no_light});
        for (std::size_t i = 0; i < old_shapes_.size(); ++i) compare_shape(i);
        for (std::size_t j = 0; j < new_shapes_.size(); ++j) find_added(j);
        if (read_view(new_root).hides_emitters) {
            refuse_hidden(old_shapes_, edit_.old_shapes);
            refuse_hidden(new_shapes_, edit_.new_shapes);
        }
        compare_emitters();
        edit_.changes = lines_.texts();
    }

    Edit take() && { return std::move(edit_); }

  private:
    static std::string title_of(const Object& shape) {
        return title(shape) + (shape.child(Category::emitter) ? " (a light)" : "");
    }

    void compare_shape(std::size_t i) {
        const Object& a = *old_shapes_[i];
        const std::uint32_t j = shape_match_.new_of_old[i];
        std::optional<Matrix4d> motion;
        if (j != SceneMatch::none && texts_.form(a) == texts_.form(*new_shapes_[j]))
            motion = rigid_motion(placement(a), placement(*new_shapes_[j]));
        if (!motion) {
            remove(i, j);
            return;
        }
        const Object& b = *new_shapes_[j];
        unsigned changes = 0;
        if (!same_placement(placement(a), placement(b))) {
            changes |= shape_change::moved;
            lines_.add("moved", title_of(b), motion_words(*motion, placement(a).point({0, 0, 0}), centred(a)));
        }
        const ObjectPtr bsdf_a = a.child(Category::bsdf), bsdf_b = b.child(Category::bsdf);
        if (texts_.text(bsdf_a) != texts_.text(bsdf_b)) {
            changes |= shape_change::repainted;
            lines_.add("repainted", title(b), differences(bsdf_a, bsdf_b, texts_));
        }
        changes |= compare_light(i, j, changes);
        edit_.old_shapes[i] = {changes, j, {}};
        edit_.new_shapes[j] = {changes, std::uint32_t(i), {}};
        if (changes & shape_change::moved) {
            edit_.old_shapes[i].to_partner = *motion;
            edit_.new_shapes[j].to_partner = inverse_of_rigid(*motion);
        }
    }

    /// Records a removed shape, or one whose partner j of the same id has another form or size.
    void remove(std::size_t i, std::uint32_t j) {
        const Object& a = *old_shapes_[i];
        edit_.old_shapes[i].changes = shape_change::removed;
        if (j == SceneMatch::none) {
            lines_.add("removed", title_of(a), "");
            return;
        }
        shape_match_.old_of_new[j] = SceneMatch::none;
        const Object& b = *new_shapes_[j];
        const std::string why = a.plugin != b.plugin ? fmt::format("{} -> {}", a.plugin, b.plugin)
                                : texts_.form(a) != texts_.form(b)
                                    ? std::string("its shape has changed")
                                    : std::string("it is moved by more than a rotation and a translation");
        lines_.add("removed and added", title_of(a), why);
        edit_.new_shapes[j].changes = shape_change::added;
    }

    /// Compares the area lights of a pair of shapes.
    /// in:      changes  of the shapes so far
    /// out:     shape_change::relit or 0
    unsigned compare_light(std::size_t i, std::uint32_t j, unsigned changes) {
        const Object& b = *new_shapes_[j];
        const ObjectPtr light_a = old_shapes_[i]->child(Category::emitter), light_b = b.child(Category::emitter);
        const bool same = texts_.text(light_a) == texts_.text(light_b);
        if (!same && light_a && light_b)
            lines_.add("light changed", title(b), differences(light_a, light_b, texts_));
        else if (!same)
            lines_.add(light_b ? "light added" : "light removed", title(b), "");
        if (light_a && light_b) {
            const bool changed = !same || (changes & shape_change::moved);
            edit_.old_emitters[old_lights_.of_shape[i]] = {changed, new_lights_.of_shape[j]};
            edit_.new_emitters[new_lights_.of_shape[j]] = {changed, old_lights_.of_shape[i]};
        }
        return same ? 0 : shape_change::relit;
    }

    void find_added(std::size_t j) {
        unsigned& changes = edit_.new_shapes[j].changes;
        if (shape_match_.old_of_new[j] != SceneMatch::none || (changes & shape_change::added)) return;
        changes = shape_change::added;
        lines_.add("added", title_of(*new_shapes_[j]), "");
    }

    static void refuse_hidden(const Objects& shapes, const std::vector<ShapeEdit>& edits) {
        for (std::size_t i = 0; i < shapes.size(); ++i)
            if (edits[i].changes != 0 && shapes[i]->has_child(Category::emitter))
                fail(shapes[i]->at,
                     "an edit of a light with an area is not supported yet where hide_emitters hides it from the "
                     "camera; render the new scene by itself");
    }

    void compare_emitters() {
        const SceneMatch match = match_emitters(old_emitters_, new_emitters_, texts_);
        for (std::size_t i = 0; i < old_emitters_.size(); ++i) {
            const Object& a = *old_emitters_[i];
            const std::uint32_t j = match.new_of_old[i];
            if (j == SceneMatch::none) {
                lines_.add("light removed", title(a), "");
                continue;
            }
            const Object& b = *new_emitters_[j];
            const bool changed = texts_.text(a) != texts_.text(b);
            edit_.old_emitters[old_lights_.n + i] = {changed, std::uint32_t(new_lights_.n + j)};
            edit_.new_emitters[new_lights_.n + j] = {changed, std::uint32_t(old_lights_.n + i)};
            if (changed)
                lines_.add(is_sky(a) ? "sky changed" : "light changed", title(b),
                           differences(old_emitters_[i], new_emitters_[j], texts_));
        }
        for (std::size_t j = 0; j < new_emitters_.size(); ++j)
            if (match.old_of_new[j] == SceneMatch::none) lines_.add("light added", title(*new_emitters_[j]), "");
    }

    CanonicalTexts texts_;
    Lines lines_;
    Edit edit_;
    Objects old_shapes_, new_shapes_, old_emitters_, new_emitters_;
    AreaLights old_lights_, new_lights_;
    SceneMatch shape_match_;
};

}  // namespace

Edit find_edit(const SceneDescription& old_scene, const SceneDescription& new_scene) {
    return EditFinder(*old_scene.root, *new_scene.root).take();
}

}  // namespace loom
