#include "stages/core/assets/colour_channels.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <cctype>

namespace loom {
namespace {

using Kind = ColourChannels::Kind;

enum Base { red, green, blue, luminance, red_chroma, blue_chroma, n_bases };

int base_of(std::string_view name) {
    constexpr std::array<std::array<std::string_view, 2>, n_bases> known{
        {{"r", "red"}, {"g", "green"}, {"b", "blue"}, {"y", "luminance"}, {"ry", "ry"}, {"by", "by"}}};
    for (int base = 0; base < n_bases; ++base)
        if (name == known[std::size_t(base)][0] || name == known[std::size_t(base)][1]) return base;
    return n_bases;
}

/// A channel name split into layer and base: "diffuse.R" -> "diffuse" and "r".
struct ChannelName {
    std::string layer, base;
    explicit ChannelName(const std::string& name) {
        const std::size_t dot = name.rfind('.');
        layer = dot == std::string::npos ? "" : name.substr(0, dot);
        base = name.substr(dot == std::string::npos ? 0 : dot + 1);
        std::transform(base.begin(), base.end(), base.begin(), [](unsigned char c) { return char(std::tolower(c)); });
    }
    bool is_alpha() const { return base == "a" || base == "alpha"; }
    /// Whether the channel is geometry, which is never a colour, even alone.
    bool is_geometry() const {
        constexpr std::array<std::string_view, 7> names{"x", "z", "zback", "zfront", "depth", "nx", "nz"};
        return std::find(names.begin(), names.end(), base) != names.end();
    }
};

struct Layer {
    std::size_t part = 0;
    std::string name;
    std::array<int, n_bases> at{-1, -1, -1, -1, -1, -1};
    bool has_x = false;  // Y is then a coordinate, not a luminance

    bool has(std::initializer_list<Base> bases) const {
        return std::all_of(bases.begin(), bases.end(), [&](Base base) { return at[base] >= 0; });
    }
    ColourChannels colour() const {
        if (has({red, green, blue})) return {Kind::rgb, part, {at[red], at[green], at[blue]}, {}};
        if (has({luminance, red_chroma, blue_chroma}))
            return {Kind::luminance_chroma, part, {at[red_chroma], at[luminance], at[blue_chroma]}, {}};
        if (has({luminance}) && !has_x) return {Kind::grey, part, {at[luminance], 0, 0}, {}};
        return {};
    }
};

std::vector<Layer> layers_of(const std::vector<std::vector<std::string>>& parts) {
    std::vector<Layer> layers;
    for (std::size_t part = 0; part < parts.size(); ++part)
        for (std::size_t i = 0; i < parts[part].size(); ++i) {
            const ChannelName name(parts[part][i]);
            auto layer = std::find_if(layers.begin(), layers.end(),
                                      [&](const Layer& l) { return l.part == part && l.name == name.layer; });
            if (layer == layers.end()) layer = layers.insert(layers.end(), {part, name.layer});
            layer->has_x |= name.base == "x";
            if (const int base = base_of(name.base); base < n_bases) layer->at[std::size_t(base)] = int(i);
        }
    return layers;
}

/// Returns the only channel beside alpha.
ColourChannels sole_channel(const std::vector<std::vector<std::string>>& parts) {
    ColourChannels found;
    std::size_t n_channels = 0, n_colours = 0;
    for (std::size_t part = 0; part < parts.size(); ++part)
        for (std::size_t i = 0; i < parts[part].size(); ++i) {
            const ChannelName name(parts[part][i]);
            ++n_channels;
            if (name.is_geometry()) return {};
            if (name.is_alpha() && (n_channels > 1 || parts.size() > 1 || parts[part].size() > 1)) continue;
            ++n_colours;
            found = {Kind::grey, part, {int(i), 0, 0}, {}};
        }
    return n_colours == 1 ? found : ColourChannels{};
}

ColourChannels none(std::string problem) {
    return {Kind::none, 0, {}, std::move(problem)};
}

}  // namespace

ColourChannels choose_colour(const std::vector<std::vector<std::string>>& parts) {
    const std::vector<Layer> layers = layers_of(parts);
    for (const Layer& layer : layers)
        if (layer.name.empty())
            if (const ColourChannels colour = layer.colour(); colour.kind != Kind::none) return colour;
    for (const bool grey : {false, true}) {
        std::vector<const Layer*> with_colour;
        for (const Layer& layer : layers)
            if (const Kind kind = layer.colour().kind; kind != Kind::none && (kind == Kind::grey) == grey)
                with_colour.push_back(&layer);
        if (with_colour.size() == 1) return with_colour[0]->colour();
        if (with_colour.empty()) continue;
        std::vector<std::string> names;
        for (const Layer* layer : with_colour) names.push_back(layer->name);
        return none(fmt::format("several layers hold a colour: {}; keep one of them, or name its channels R, G, B",
                                fmt::join(names, ", ")));
    }
    if (const ColourChannels sole = sole_channel(parts); sole.kind != Kind::none) return sole;
    std::vector<std::string> names;
    for (const auto& part : parts) names.insert(names.end(), part.begin(), part.end());
    return none(fmt::format("no colour among its channels: {}; a colour has R, G, B or Y", fmt::join(names, ", ")));
}

}  // namespace loom
