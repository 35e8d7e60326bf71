#pragma once
#include <array>
#include <string>
#include <string_view>
#include <vector>

namespace loom {

/// The colour channels of an EXR file.
struct ColourChannels {
    enum class Kind { none, grey, rgb, luminance_chroma };
    Kind kind = Kind::none;
    std::size_t part = 0;
    std::array<int, 3> at{};  // channel indices within the part: Y; R, G, B; or RY, Y, BY
    std::string problem;      // kind none: the reason, with the names of the channels

    int count() const { return kind == Kind::grey ? 1 : 3; }
};

/// Chooses channels by name, never by position. First choice: R, G, B (or Y, RY, BY, or Y) without a layer, in the
/// first part that has them. Second: those of the only layer that has them. Last: the only channel of the file, unless
/// it is a depth or a coordinate. Alpha is never a colour.
/// in:      parts  names of the channels of each part, such as "R" or "diffuse.R"
ColourChannels choose_colour(const std::vector<std::vector<std::string>>& parts);

}  // namespace loom
