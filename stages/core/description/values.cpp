#include "stages/core/description/values.h"

#include <fmt/format.h>

#include <algorithm>
#include <cctype>
#include <cfloat>
#include <charconv>
#include <cmath>
#include <fstream>
#include <limits>
#include <sstream>

#include "stages/core/description/byte_order_mark.h"
#include "stages/core/description/ior.h"
#include "stages/core/description/spectrum.h"
#include "stages/core/math/frame.h"

namespace loom::description {
namespace {

constexpr double rad_per_deg = pi_double / 180;

bool is_separator(char c) {
    return c == ',' || std::isspace(static_cast<unsigned char>(c));
}

bool same_ignoring_case(std::string_view a, std::string_view b) {
    const auto lower = [](char c) { return std::tolower(static_cast<unsigned char>(c)); };
    return std::equal(a.begin(), a.end(), b.begin(), b.end(), [&](char x, char y) { return lower(x) == lower(y); });
}

std::string trimmed(const std::string& text) {
    const auto blank = [](char c) { return std::isspace(static_cast<unsigned char>(c)) != 0; };
    const auto first = std::find_if_not(text.begin(), text.end(), blank);
    const auto last = std::find_if_not(text.rbegin(), std::make_reverse_iterator(first), blank).base();
    return {first, last};
}

double number_of(std::string_view word, const Location& at) {
    std::string_view digits = word;
    if (digits.starts_with('+')) digits.remove_prefix(1);
    double value = 0;
    const auto [end, error] = std::from_chars(digits.data(), digits.data() + digits.size(), value);
    const bool whole = end == digits.data() + digits.size() && !digits.empty();
    if (error == std::errc::result_out_of_range && whole) {
        // Out of the range of a double: a value that is too small becomes 0.
        const std::size_t exponent = digits.find_first_of("eE");
        if (exponent != std::string_view::npos && digits.substr(exponent + 1).starts_with('-')) return 0;
    } else if (error != std::errc{} || !whole) {
        fail(at, fmt::format("'{}' is not a number", word));
    }
    if (!(std::abs(value) <= double(FLT_MAX)) || error == std::errc::result_out_of_range)
        fail(at, fmt::format("'{}' is not a finite number", word));
    return value;
}

/// Returns the existing ones of x, y, z, or `value` with one or three numbers.
std::array<double, 3> xyz(const Element& e, double fallback) {
    std::array<double, 3> r{fallback, fallback, fallback};
    if (e.has("value")) {
        const Text text = e.text("value");
        const std::vector<double> numbers = parse_numbers(text);
        if (numbers.size() == 1) return {numbers[0], numbers[0], numbers[0]};
        if (numbers.size() != 3) fail(text.at, fmt::format("expected 3 numbers, got {}", numbers.size()));
        return {numbers[0], numbers[1], numbers[2]};
    }
    const char* names[] = {"x", "y", "z"};
    for (std::size_t i = 0; i < 3; ++i)
        if (e.has(names[i])) r[i] = parse_number(e.text(names[i]));
    return r;
}

Vector3<double> to_vector(const std::array<double, 3>& v) {
    return {v[0], v[1], v[2]};
}

std::array<double, 3> triple(const Text& text) {
    const std::vector<double> n = parse_numbers(text);
    if (n.size() != 3) fail(text.at, fmt::format("expected 3 numbers, got {}", n.size()));
    return {n[0], n[1], n[2]};
}

Matrix4d look_at(const Element& e) {
    const Vector3<double> origin = to_vector(triple(e.text("origin"))), target = to_vector(triple(e.text("target")));
    const Vector3<double> view = target - origin;
    if (!(length(view) > 0)) fail(e.text("target").at, "target and origin are the same point");
    Vector3<double> up = Frame<double>(Normal3<double>(normalize(view))).s;
    if (e.has("up")) {
        up = to_vector(triple(e.text("up")));
        if (!(length(cross(up, view)) > 1e-12 * length(up) * length(view)))
            fail(e.text("up").at, "up is zero or parallel to the direction of view");
    }
    return Matrix4d::look_at(Point3<double>(origin), Point3<double>(target), up);
}

Matrix4d matrix(const Element& e) {
    const Text text = e.text("value");
    const std::vector<double> n = parse_numbers(text);
    Matrix4d r;
    if (n.size() == 16) {
        std::copy(n.begin(), n.end(), r.m.begin());
    } else if (n.size() == 9) {
        for (int i = 0; i < 3; ++i)
            for (int j = 0; j < 3; ++j) r(i, j) = n[std::size_t(3 * i + j)];
    } else {
        fail(text.at, fmt::format("a matrix has 16 or 9 numbers, not {}", n.size()));
    }
    if (r(3, 0) != 0 || r(3, 1) != 0 || r(3, 2) != 0 || r(3, 3) != 1)
        fail(text.at, "the last row of a matrix must be 0 0 0 1");
    return r;
}

Matrix4d transform_step(const Element& e) {
    const std::string_view tag = e.tag();
    if (tag == "translate" || tag == "scale") {
        e.allow({"x", "y", "z", "value"});
        const bool scale = tag == "scale";
        const std::array<double, 3> v = xyz(e, scale ? 1.0 : 0.0);
        return scale ? Matrix4d::scaling(v[0], v[1], v[2]) : Matrix4d::translation(v[0], v[1], v[2]);
    }
    if (tag == "rotate") {
        e.allow({"x", "y", "z", "value", "angle"});
        const Vector3<double> axis = to_vector(xyz(e, 0));
        if (!(length(axis) > 0)) fail(e.at(), "the axis of a rotation must not be zero");
        return Matrix4d::rotation(axis, parse_number(e.text("angle")) * rad_per_deg);
    }
    if (tag == "matrix") {
        e.allow({"value"});
        return matrix(e);
    }
    if (tag == "lookat" || tag == "lookAt") {
        e.allow({"origin", "target", "up"});
        return look_at(e);
    }
    fail(e.at(), fmt::format("<{}> is not a transformation; allowed: {}", tag,
                             nearest_first(tag, {"translate", "rotate", "scale", "matrix", "lookat"})));
}

Matrix4d read_transform(const Element& e, bool invertible) {
    e.allow({"name", "id"});
    Matrix4d result;
    for (const pugi::xml_node& child : e.node.children()) {
        if (child.type() != pugi::node_element) fail(e.file->document.at(child), "unexpected text");
        result = transform_step(e.with(child)) * result;  // the first in the file is applied first
    }
    if (!result.finite()) fail(e.at(), "the matrix has entries that are not finite");
    if (invertible && result.singular())
        fail(e.at(), "the matrix is singular: it maps space onto a plane, line or point");
    return result;
}

/// Parses "#rrggbb", sRGB-encoded.
Spectrum hex_colour(const Text& text, const std::string& word) {
    unsigned bits = 0;
    const auto [end, error] = std::from_chars(word.data() + 1, word.data() + word.size(), bits, 16);
    if (word.size() != 7 || error != std::errc{} || end != word.data() + word.size())
        fail(text.at, fmt::format("'{}' is not a colour like #80ff00", word));
    const auto channel = [&](int shift) { return linear_from_srgb(float((bits >> shift) & 255) / 255.0f); };
    return {channel(16), channel(8), channel(0)};
}

Spectrum rgb_colour(const Text& text, bool encoded) {
    const std::string word = trimmed(text.text);
    if (word.starts_with('#')) return hex_colour(text, word);
    const std::vector<double> n = parse_numbers(text);
    if (n.size() != 1 && n.size() != 3) fail(text.at, fmt::format("a colour has 1 or 3 numbers, not {}", n.size()));
    Spectrum rgb(float(n[0]), float(n[n.size() / 2]), float(n.back()));
    if (encoded)
        for (int i = 0; i < 3; ++i) rgb[i] = linear_from_srgb(rgb[i]);
    return rgb;
}

SampledSpectrum parse_samples(const Text& text) {
    SampledSpectrum samples;
    std::string spaced = text.text;
    std::replace(spaced.begin(), spaced.end(), ':', ' ');
    const std::vector<double> n = parse_numbers({spaced, text.at});
    if (n.empty() || n.size() % 2 != 0) fail(text.at, "expected pairs like 400:0.5, 500:0.7");
    for (std::size_t i = 0; i < n.size(); i += 2) {
        if (!samples.empty() && !(n[i] > samples.back().first))
            fail(text.at, fmt::format("wavelengths must increase: {} nm after {} nm", n[i], samples.back().first));
        samples.emplace_back(n[i], n[i + 1]);
    }
    return samples;
}

/// Reads lines "wavelength value"; # starts a comment.
SampledSpectrum samples_of_file(const Element& e) {
    const Text name = e.text("filename");
    const std::filesystem::path file = find_file(name, e.file->folders);
    add_file(*e.file->used, file);
    std::ifstream in(file);
    std::string numbers, line;
    while (std::getline(in, line)) {
        const std::string_view text = numbers.empty() ? without_byte_order_mark(line) : line;
        numbers.append(text.substr(0, text.find('#'))) += ' ';
    }
    return parse_samples({numbers, name.at});
}

Spectrum spectrum_colour(const Element& e, SpectrumUse use) {
    e.allow({"name", "id", "value", "filename", "type"});
    if (e.has("type")) fail(e.text("type").at, "<spectrum type=...> is not supported yet; give a value");
    if (e.has("filename")) return rgb_from_spectrum(samples_of_file(e), use);
    const Text text = e.text("value");
    if (text.text.find(':') != std::string::npos) return rgb_from_spectrum(parse_samples(text), use);
    const std::vector<double> n = parse_numbers(text);
    if (n.size() == 1) {
        const auto value = float(n[0]);
        // Mitsuba 0.x in RGB mode read a single number as grey for every use.
        return e.file->legacy ? Spectrum(value) : rgb_from_constant_spectrum(value, use);
    }
    if (n.size() == 3 && e.file->legacy) return {float(n[0]), float(n[1]), float(n[2])};
    fail(text.at, e.file->legacy
                      ? "a spectrum is one number, three (RGB), or pairs like 400:0.5, 500:0.7"
                      : "a spectrum is one number or pairs like 400:0.5, 500:0.7; three numbers are an <rgb>");
}

Value read_colour(const Element& e, const Parameter& parameter, const PluginSchema& plugin, const Warn& warn) {
    const SpectrumUse use = parameter.kind == ValueKind::emission      ? SpectrumUse::emission
                            : parameter.kind == ValueKind::reflectance ? SpectrumUse::reflectance
                                                                       : SpectrumUse::index;
    Spectrum rgb;
    if (e.tag() == "spectrum") {
        rgb = spectrum_colour(e, use);
    } else {
        e.allow({"name", "id", "value"});
        const bool colour = e.tag() == "rgb" || e.tag() == "srgb";
        rgb = colour ? rgb_colour(e.text("value"), e.tag() == "srgb") : Spectrum(float(parse_number(e.text("value"))));
    }
    const float low = std::min({rgb.r, rgb.g, rgb.b}), high = std::max({rgb.r, rgb.g, rgb.b});
    const Location at = e.file->document.at(e.node, "value");
    if (use == SpectrumUse::emission && low < 0) fail(at, fmt::format("'{}' must not be negative", parameter.name));
    if (use == SpectrumUse::reflectance && (low < 0 || high > 1)) {
        if (!e.file->legacy) fail(at, fmt::format("'{}' must lie between 0 and 1", parameter.name));
        // Mitsuba 0.6 scales a reflectance above 1 to 0.99; phong and ward are scaled by the sum of their two lobes.
        constexpr float rounding = 1e-5f;
        if (plugin.category == Category::bsdf && low >= 0 && high > 1 + rounding) {
            if (plugin.type == "phong" || plugin.type == "ward") return rgb;
            const float scale = 0.99f / high;
            warn(at, fmt::format("'{}' is above 1 and is scaled by {:.4g}, as in Mitsuba 0.6",
                                 camel_case(parameter.name), scale));
            return rgb * scale;
        }
        warn(at, fmt::format("'{}' is clamped to [0, 1]", camel_case(parameter.name)));
        for (int i = 0; i < 3; ++i) rgb[i] = std::clamp(rgb[i], 0.0f, 1.0f);
    }
    return rgb;
}

void check_range(double value, const Parameter& parameter, const Location& at) {
    if ((parameter.flags & flag::positive) && !(value > 0))
        fail(at, fmt::format("'{}' must be greater than 0", parameter.name));
    if ((parameter.flags & flag::non_negative) && !(value >= 0))
        fail(at, fmt::format("'{}' must not be negative", parameter.name));
}

bool parse_boolean(const Text& text) {
    const std::string word = trimmed(text.text);
    const bool yes = same_ignoring_case(word, "true");
    if (!yes && !same_ignoring_case(word, "false"))
        fail(text.at, fmt::format("'{}' is neither true nor false", text.text));
    return yes;
}

std::vector<std::string> split_choices(std::string_view choices, bool legacy) {
    const std::size_t slash = choices.find('/');
    std::string list(choices.substr(0, slash));
    if (legacy && slash != std::string_view::npos) list.append("|").append(choices.substr(slash + 1));
    std::vector<std::string> result;
    std::stringstream in(list);
    for (std::string word; std::getline(in, word, '|');) result.push_back(word);
    return result;
}

/// Returns the value in the spelling of `allowed`, for any spelling in the file.
std::string one_of(const Text& text, const std::string& what, const std::vector<std::string>& allowed) {
    const auto found = std::find_if(allowed.begin(), allowed.end(),
                                    [&](const std::string& name) { return same_ignoring_case(name, text.text); });
    if (found == allowed.end())
        fail(text.at,
             fmt::format("{} '{}' is not known; allowed: {}", what, text.text, nearest_first(text.text, allowed)));
    return *found;
}

/// Returns a choice by its index, from 1.
std::string numbered_choice(const Text& text, const Parameter& parameter, bool legacy) {
    const std::vector<std::string> choices = split_choices(parameter.choices, legacy);
    const std::int64_t number = parse_integer(text);
    if (number < 1 || number > std::int64_t(choices.size()))
        fail(text.at, fmt::format("{} {} is not between 1 and {} ({})", parameter.name, number, choices.size(),
                                  fmt::join(choices, ", ")));
    return choices[std::size_t(number - 1)];
}

std::string read_string(const Text& text, const Parameter& parameter, bool legacy) {
    if (parameter.flags & flag::conductor) return one_of(text, "material", conductor_names());
    if (parameter.kind == ValueKind::ior) return one_of(text, "material", dielectric_names());
    if (!parameter.choices.empty())
        return one_of(text, std::string(parameter.name), split_choices(parameter.choices, legacy));
    return text.text;
}

bool tag_fits(std::string_view tag, const Parameter& parameter) {
    const bool number = tag == "float" || tag == "integer";
    if (tag == "integer" && (parameter.flags & flag::numbered)) return true;
    switch (parameter.kind) {
        case ValueKind::boolean:
            return tag == "boolean";
        case ValueKind::integer:
            return tag == "integer";
        case ValueKind::number:
            return number;
        case ValueKind::string:
        case ValueKind::file:
            return tag == "string";
        case ValueKind::ior:
            return number || tag == "string";
        case ValueKind::reflectance:
        case ValueKind::emission:
            return number || tag == "rgb" || tag == "srgb" || tag == "spectrum";
        case ValueKind::index:
            return number || tag == "vector" || tag == "rgb" || tag == "srgb" || tag == "spectrum";
        case ValueKind::transform:
        case ValueKind::uv_transform:
            return tag == "transform";
        case ValueKind::point:
        case ValueKind::vector:
            return tag == "point" || tag == "vector";
        case ValueKind::texture_only:
            return false;
    }
    return false;
}

/// Returns the first `folder / name` that passes the test.
std::filesystem::path find_in(const Folders& folders, const Text& name, std::string_view what,
                              bool (*is_kind)(const std::filesystem::path&, std::error_code&)) {
    std::string tried;
    for (const std::filesystem::path& folder : folders) {
        const std::filesystem::path candidate = (folder / name.text).lexically_normal();
        std::error_code error;
        if (!name.text.empty() && is_kind(candidate, error)) return candidate;
        if (tried.find(candidate.string()) == std::string::npos)
            tried += (tried.empty() ? "" : ", ") + candidate.string();
    }
    fail(name.at, fmt::format("{} '{}' not found (looked for {})", what, name.text, tried));
}

}  // namespace

Text Element::text(const char* attribute) const {
    const pugi::xml_attribute found = node.attribute(attribute);
    if (!found) fail(at(), fmt::format("<{}> needs the attribute '{}'", node.name(), attribute));
    const Location place = file->document.at(node, attribute);
    return {substitutions->apply(found.value(), place), place};
}

std::vector<std::string> value_tags() {
    return {"boolean", "integer", "float", "string", "rgb", "srgb", "spectrum", "point", "vector", "transform"};
}

bool is_value_tag(std::string_view tag) {
    const std::vector<std::string> tags = value_tags();
    return std::find(tags.begin(), tags.end(), tag) != tags.end();
}

double parse_number(const Text& text) {
    return number_of(trimmed(text.text), text.at);
}

std::int64_t parse_integer(const Text& text) {
    std::string word = trimmed(text.text);
    if (word.starts_with('+')) word.erase(0, 1);
    std::int32_t value = 0;
    const auto [end, error] = std::from_chars(word.data(), word.data() + word.size(), value);
    if (error != std::errc{} || end != word.data() + word.size())
        fail(text.at, fmt::format("'{}' is not an integer of 32 bits", text.text));
    return value;
}

std::vector<double> parse_numbers(const Text& text) {
    std::vector<double> numbers;
    const std::string_view all = text.text;
    for (std::size_t i = 0; i < all.size();) {
        if (is_separator(all[i])) {
            ++i;
            continue;
        }
        std::size_t end = i;
        while (end < all.size() && !is_separator(all[end])) ++end;
        numbers.push_back(number_of(all.substr(i, end - i), text.at));
        i = end;
    }
    if (numbers.empty()) fail(text.at, "expected numbers");
    return numbers;
}

std::filesystem::path find_file(const Text& name, const Folders& folders) {
    return find_in(folders, name, "file", [](const std::filesystem::path& path, std::error_code& error) {
        return std::filesystem::is_regular_file(path, error);
    });
}

std::filesystem::path find_folder(const Text& name, const Folders& folders) {
    return find_in(folders, name, "folder", [](const std::filesystem::path& path, std::error_code& error) {
        return std::filesystem::is_directory(path, error);
    });
}

void add_file(std::vector<std::string>& files, const std::filesystem::path& file) {
    if (std::find(files.begin(), files.end(), file.string()) == files.end()) files.push_back(file.string());
}

Value read_value(const Element& e, const Parameter& parameter, const PluginSchema& plugin, const Warn& warn) {
    const std::string_view tag = e.tag();
    if (!tag_fits(tag, parameter))
        fail(e.at(), fmt::format("{} '{}': parameter '{}' must be {}, not {}", name(plugin.category), plugin.type,
                                 parameter.name, expected_kinds(parameter), tag));
    switch (parameter.kind) {
        case ValueKind::reflectance:
        case ValueKind::emission:
        case ValueKind::index:
            return read_colour(e, parameter, plugin, warn);
        case ValueKind::transform:
            return read_transform(e, true);
        case ValueKind::uv_transform:
            return read_transform(e, false);
        case ValueKind::point:
        case ValueKind::vector: {
            e.allow({"name", "id", "value", "x", "y", "z"});
            const std::array<double, 3> v = xyz(e, 0);
            if (parameter.kind == ValueKind::point) return Point3<double>(v[0], v[1], v[2]);
            if (v == std::array<double, 3>{}) fail(e.at(), fmt::format("'{}' must not be zero", parameter.name));
            return to_vector(v);
        }
        default:
            break;
    }
    e.allow({"name", "id", "value"});
    const Text text = e.text("value");
    if (tag == "boolean") return parse_boolean(text);
    if (tag == "string") return read_string(text, parameter, e.file->legacy);
    if (parameter.flags & flag::numbered) return numbered_choice(text, parameter, e.file->legacy);
    if (parameter.kind == ValueKind::integer) {
        const std::int64_t value = parse_integer(text);
        check_range(double(value), parameter, text.at);
        return value;
    }
    const double value = tag == "integer" ? double(parse_integer(text)) : parse_number(text);
    check_range(value, parameter, text.at);
    return value;
}

}  // namespace loom::description
