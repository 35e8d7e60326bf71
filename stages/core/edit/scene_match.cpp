#include "stages/core/edit/scene_match.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <functional>

#include "formats/io/content_hash.h"
#include "stages/core/description/ior.h"
#include "stages/core/description/schema.h"

namespace loom {
namespace {

const Parameter* parameter_of(const Object& object, std::string_view name) {
    const PluginSchema* schema = find_plugin(object.category, object.plugin);
    return schema ? schema->find(name) : nullptr;
}

/// Includes the dialect where it affects the meaning: the values of a checkerboard.
std::string plugin_text(const Object& object) {
    return fmt::format("{} {}{}", name(object.category), object.plugin,
                       object.legacy && object.plugin == "checkerboard" ? " 0.x" : "");
}

/// Nine digits: a placement given as a matrix equals the same one given as rotations.
std::string number(double x) {
    return fmt::format("{:.9g}", x + 0.0);
}
std::string triple(double x, double y, double z) {
    return number(x) + "," + number(y) + "," + number(z);
}

std::string joined(const std::map<std::string, std::string>& values) {
    std::string text;
    for (const auto& [name, value] : values) text += fmt::format(" {}={}", name, value);
    return text;
}

struct ValueText {
    CanonicalTexts& texts;
    const Parameter* parameter;

    std::string operator()(bool x) const { return x ? "true" : "false"; }
    std::string operator()(double x) const {
        if (parameter && (parameter->kind == ValueKind::reflectance || parameter->kind == ValueKind::emission)) {
            const double grey = double(float(x));
            return triple(grey, grey, grey);
        }
        return number(parameter && parameter->kind == ValueKind::ior ? double(float(x)) : x);
    }
    std::string operator()(std::int64_t x) const { return (*this)(double(x)); }
    std::string operator()(const std::string& x) const { return x; }
    std::string operator()(const Spectrum& x) const { return triple(double(x.r), double(x.g), double(x.b)); }
    template <class Kind>
    std::string operator()(const Triple<double, Kind>& x) const {
        return triple(x.x, x.y, x.z);
    }
    std::string operator()(const Matrix4d& x) const {
        std::string text;
        for (double m : x.m) text += number(std::round(m * 1e9) / 1e9) + ",";
        return text;
    }
    std::string operator()(const ObjectPtr& x) const { return "(" + texts.text(*x) + ")"; }
};

constexpr double rigid_tolerance = 1e-5, place_tolerance = 1e-7;

}  // namespace

const std::string& CanonicalTexts::text(const Object& object) {
    const auto known = texts_.find(&object);
    if (known != texts_.end()) return known->second;
    std::map<std::string, std::string> values;
    for (const Property& property : object.properties)
        if (counts(object, property)) values[property.name] = value(object, property);
    std::string text = plugin_text(object) + joined(values);
    for (const auto& [child, location] : object.nested) text += fmt::format(" ({})", this->text(*child));
    return texts_.emplace(&object, text).first->second;
}

std::string CanonicalTexts::form(const Object& shape) {
    std::map<std::string, std::string> values;
    const bool sphere = shape.plugin == "sphere";
    for (const Property& property : shape.properties) {
        if (property.name == "to_world" || !counts(shape, property)) continue;
        if (sphere && (property.name == "center" || property.name == "radius")) continue;
        values[property.name] = value(shape, property);
    }
    return plugin_text(shape) + joined(values);
}

std::string CanonicalTexts::value(const Object& object, const Property& property) {
    const Parameter* parameter = parameter_of(object, property.name);
    if (const auto* text = std::get_if<std::string>(&property.value)) {
        if (parameter && parameter->kind == ValueKind::file) return file(*text);
        if (parameter && parameter->kind == ValueKind::ior) return number(double(object.get_ior(property.name, *text)));
    }
    return std::visit(ValueText{*this, parameter}, property.value);
}

bool CanonicalTexts::counts(const Object& object, const Property& property) const {
    const Parameter* parameter = parameter_of(object, property.name);
    return !parameter || !(parameter->flags & flag::ignored);
}

const std::string& CanonicalTexts::file(const std::string& path) {
    const auto known = files_.find(path);
    return known != files_.end() ? known->second : files_.emplace(path, file_content_hash(path)).first->second;
}

std::optional<Matrix4d> rigid_motion(const Matrix4d& from, const Matrix4d& to) {
    for (int k = 0; k < 4; ++k)
        if (from(3, k) != (k == 3 ? 1 : 0) || to(3, k) != (k == 3 ? 1 : 0)) return std::nullopt;
    // R = B A^-1, and A^-1 is the transpose of the normal matrix.
    const std::array<double, 9> inverse_transpose = from.normal_matrix();
    Matrix4d motion;
    for (int i = 0; i < 3; ++i)
        for (int j = 0; j < 3; ++j) {
            motion(i, j) = 0;
            for (int k = 0; k < 3; ++k) motion(i, j) += to(i, k) * inverse_transpose[std::size_t(j * 3 + k)];
        }
    for (int i = 0; i < 3; ++i)
        for (int j = 0; j < 3; ++j) {
            double product = 0;
            for (int k = 0; k < 3; ++k) product += motion(k, i) * motion(k, j);
            if (!(std::abs(product - (i == j ? 1 : 0)) < rigid_tolerance)) return std::nullopt;
        }
    if (!(motion.determinant3() > 0)) return std::nullopt;
    for (int i = 0; i < 3; ++i) {
        motion(i, 3) = to(i, 3);
        for (int k = 0; k < 3; ++k) motion(i, 3) -= motion(i, k) * from(k, 3);
    }
    return motion;
}

bool same_placement(const Matrix4d& a, const Matrix4d& b) {
    constexpr double cancelled = 1e-14;  // a sum that is 0 except for rounding
    double size = 0, distance = 0;
    for (int i = 0; i < 3; ++i) {
        for (int k = 0; k < 3; ++k) size = std::max(size, std::abs(a(i, k)));
        distance = std::max(distance, std::abs(a(i, 3)));
    }
    for (int i = 0; i < 3; ++i) {
        for (int k = 0; k < 3; ++k)
            if (!(std::abs(a(i, k) - b(i, k)) <= place_tolerance * size)) return false;
        if (!(std::abs(a(i, 3) - b(i, 3)) <= place_tolerance * distance + cancelled * size)) return false;
    }
    for (int k = 0; k < 4; ++k)
        if (a(3, k) != b(3, k)) return false;
    return true;
}

Matrix4d inverse_of_rigid(const Matrix4d& m) {
    Matrix4d inverse;
    for (int i = 0; i < 3; ++i) {
        inverse(i, 3) = 0;
        for (int k = 0; k < 3; ++k) {
            inverse(i, k) = m(k, i);
            inverse(i, 3) -= m(k, i) * m(k, 3);
        }
    }
    return inverse;
}

Matrix4d placement(const Object& shape) {
    const Matrix4d world = shape.get_transform("to_world");
    if (shape.plugin != "sphere") return world;
    const Point3<double> c = shape.get_point("center", {0, 0, 0});
    const double r = shape.get_double("radius", 1);
    return world * Matrix4d::translation(c.x, c.y, c.z) * Matrix4d::scaling(r, r, r);
}

bool is_sky(const Object& emitter) {
    return emitter.plugin == "constant" || emitter.plugin == "envmap" || emitter.plugin == "sunsky";
}

namespace {

/// Pairs objects of equal keys, in order, among those without a partner. `eligible` may reject a pair.
using Key = std::function<std::string(std::size_t)>;  // empty: not paired
void pair_up(SceneMatch& match, const Key& old_key, const Key& new_key,
             const std::function<bool(std::size_t, std::size_t)>& eligible) {
    constexpr std::uint32_t none = SceneMatch::none;
    std::map<std::string, std::vector<std::size_t>> waiting;
    for (std::size_t j = 0; j < match.old_of_new.size(); ++j)
        if (match.old_of_new[j] == none)
            if (const std::string key = new_key(j); !key.empty()) waiting[key].push_back(j);
    for (std::size_t i = 0; i < match.new_of_old.size(); ++i) {
        if (match.new_of_old[i] != none) continue;
        const auto found = waiting.find(old_key(i));
        if (found == waiting.end()) continue;
        const auto partner =
            std::find_if(found->second.begin(), found->second.end(), [&](std::size_t j) { return eligible(i, j); });
        if (partner == found->second.end()) continue;
        match.new_of_old[i] = std::uint32_t(*partner);
        match.old_of_new[*partner] = std::uint32_t(i);
        found->second.erase(partner);
    }
}

SceneMatch no_partners(std::size_t n_old, std::size_t n_new) {
    return {std::vector<std::uint32_t>(n_old, SceneMatch::none), std::vector<std::uint32_t>(n_new, SceneMatch::none)};
}

}  // namespace

SceneMatch match_shapes(const Objects& old_shapes, const Objects& new_shapes, CanonicalTexts& texts) {
    SceneMatch match = no_partners(old_shapes.size(), new_shapes.size());
    const auto always = [](std::size_t, std::size_t) { return true; };
    const auto unnamed = [&](std::size_t i, std::size_t j) {
        return !old_shapes[i]->has_own_id || !new_shapes[j]->has_own_id;
    };
    const auto pass = [&](const auto& key, const auto& eligible) {
        pair_up(
            match, [&](std::size_t i) { return key(*old_shapes[i]); },
            [&](std::size_t j) { return key(*new_shapes[j]); }, eligible);
    };
    const auto bsdf = [&](const Object& o) { return texts.text(o.child(Category::bsdf)); };
    pass([](const Object& o) { return o.has_own_id ? o.id : std::string(); }, always);
    pass([&](const Object& o) { return texts.text(o); }, always);
    const auto movable = [&](std::size_t i, std::size_t j) {
        return unnamed(i, j) && rigid_motion(placement(*old_shapes[i]), placement(*new_shapes[j])).has_value();
    };
    const auto in_place = [&](std::size_t i, std::size_t j) {
        return unnamed(i, j) && same_placement(placement(*old_shapes[i]), placement(*new_shapes[j]));
    };
    pass([&](const Object& o) { return texts.form(o) + " " + bsdf(o); }, in_place);
    pass([&](const Object& o) { return texts.form(o) + " " + bsdf(o); }, movable);
    pass([&](const Object& o) { return texts.form(o); }, in_place);
    pass([&](const Object& o) { return texts.form(o); }, movable);
    return match;
}

SceneMatch match_emitters(const Objects& old_emitters, const Objects& new_emitters, CanonicalTexts& texts) {
    SceneMatch match = no_partners(old_emitters.size(), new_emitters.size());
    const auto pass = [&](const auto& key, const auto& eligible) {
        pair_up(
            match, [&](std::size_t i) { return key(*old_emitters[i]); },
            [&](std::size_t j) { return key(*new_emitters[j]); }, eligible);
    };
    const auto always = [](std::size_t, std::size_t) { return true; };
    pass([&](const Object& o) { return is_sky(o) ? std::string("sky") : std::string(); }, always);
    pass([](const Object& o) { return o.has_own_id ? o.plugin + " " + o.id : std::string(); }, always);
    pass([&](const Object& o) { return texts.text(o); }, always);
    pass([](const Object& o) { return o.plugin; },
         [&](std::size_t i, std::size_t j) { return !old_emitters[i]->has_own_id || !new_emitters[j]->has_own_id; });
    return match;
}

}  // namespace loom
