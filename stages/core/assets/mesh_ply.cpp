#include <fmt/format.h>

#include <algorithm>
#include <bit>
#include <charconv>
#include <string_view>

#include "formats/io/error.h"
#include "formats/io/mapped_file.h"
#include "stages/core/assets/mesh.h"
#include "stages/core/description/byte_order_mark.h"

namespace loom {
namespace {

enum class Type : std::uint8_t { int8, uint8, int16, uint16, int32, uint32, float32, float64 };
constexpr std::size_t type_size[] = {1, 1, 2, 2, 4, 4, 4, 8};
enum class Encoding : std::uint8_t { ascii, little, big };

struct PlyProperty {
    std::string name;
    Type type = Type::float32;
    bool list = false;
    Type count_type = Type::uint8;
};

struct PlyElement {
    std::string name;
    std::uint64_t count = 0;
    std::vector<PlyProperty> properties;
};

/// Destination of a vertex property.
enum class Target : std::uint8_t { x, y, z, nx, ny, nz, u, v, other };
Target target_of(std::string_view name) {
    constexpr std::pair<std::string_view, Target> names[] = {
        {"x", Target::x},   {"y", Target::y},   {"z", Target::z},         {"nx", Target::nx},
        {"ny", Target::ny}, {"nz", Target::nz}, {"u", Target::u},         {"s", Target::u},
        {"v", Target::v},   {"t", Target::v},   {"texture_u", Target::u}, {"texture_v", Target::v}};
    for (const auto& [known, target] : names)
        if (known == name) return target;
    return Target::other;
}

class PlyReader {
  public:
    PlyReader(std::string_view bytes, std::string file) : bytes_(bytes), file_(std::move(file)) {}

    Mesh read(bool flip_v) {
        read_header();
        for (const PlyElement& element : elements_) {
            if (element.name == "vertex")
                read_vertices(element, flip_v);
            else if (element.name == "face")
                read_faces(element);
            else
                skip(element);
        }
        return std::move(mesh_);
    }

  private:
    [[noreturn]] void fail(const std::string& what) const { throw InputError(fmt::format("{}: {}", file_, what)); }

    std::string_view header_line() {
        const std::size_t end = bytes_.find('\n', at_);
        if (end == std::string_view::npos) fail("truncated in the header");
        std::string_view line = bytes_.substr(at_, end - at_);
        if (line.ends_with('\r')) line.remove_suffix(1);
        at_ = end + 1;
        return line;
    }

    static std::string_view next_word(std::string_view& line) {
        const std::size_t start = std::min(line.find_first_not_of(" \t"), line.size());
        const std::size_t end = std::min(line.find_first_of(" \t", start), line.size());
        const std::string_view word = line.substr(start, end - start);
        line.remove_prefix(end);
        return word;
    }

    Type type_of(std::string_view word) const {
        constexpr std::pair<std::string_view, Type> names[] = {
            {"char", Type::int8},      {"int8", Type::int8},       {"uchar", Type::uint8},
            {"uint8", Type::uint8},    {"short", Type::int16},     {"int16", Type::int16},
            {"ushort", Type::uint16},  {"uint16", Type::uint16},   {"int", Type::int32},
            {"int32", Type::int32},    {"uint", Type::uint32},     {"uint32", Type::uint32},
            {"float", Type::float32},  {"float32", Type::float32}, {"double", Type::float64},
            {"float64", Type::float64}};
        for (const auto& [name, type] : names)
            if (name == word) return type;
        fail(fmt::format("unknown type '{}' in the header", word));
    }

    void read_header() {
        if (bytes_.size() < 4 || header_line() != "ply") fail("not a PLY file");
        bool format_known = false;
        for (;;) {
            std::string_view line = header_line();
            const std::string_view keyword = next_word(line);
            if (keyword == "end_header") break;
            if (keyword == "format") {
                const std::string_view format = next_word(line);
                if (format == "ascii")
                    encoding_ = Encoding::ascii;
                else if (format == "binary_little_endian")
                    encoding_ = Encoding::little;
                else if (format == "binary_big_endian")
                    encoding_ = Encoding::big;
                else
                    fail(fmt::format("unknown format '{}'", format));
                format_known = true;
            } else if (keyword == "element") {
                read_element(line);
            } else if (keyword == "property") {
                read_property(line);
            }  // skip comments and obj_info
        }
        if (!format_known) fail("the header names no format");
    }

    void read_element(std::string_view line) {
        PlyElement element;
        element.name = next_word(line);
        const std::string_view count = next_word(line);
        const auto [end, error] = std::from_chars(count.data(), count.data() + count.size(), element.count);
        if (error != std::errc{} || end != count.data() + count.size())
            fail(fmt::format("'{}' is not a number of elements", count));
        // A row has at least one byte, so a larger count is invalid and must not be allocated.
        if (element.count > bytes_.size())
            fail(fmt::format("truncated: {} elements '{}' in {} bytes", element.count, element.name, bytes_.size()));
        elements_.push_back(std::move(element));
    }

    void read_property(std::string_view line) {
        if (elements_.empty()) fail("a property stands before the first element");
        PlyProperty property;
        std::string_view type = next_word(line);
        property.list = type == "list";
        if (property.list) {
            property.count_type = type_of(next_word(line));
            type = next_word(line);
        }
        property.type = type_of(type);
        property.name = next_word(line);
        elements_.back().properties.push_back(std::move(property));
    }

    double number(Type type) {
        if (encoding_ == Encoding::ascii) return ascii_number();
        const std::size_t size = type_size[int(type)];
        if (bytes_.size() - at_ < size) fail(fmt::format("truncated at byte {}", bytes_.size()));
        std::uint64_t bits = 0;
        for (std::size_t i = 0; i < size; ++i) {
            const std::size_t place = encoding_ == Encoding::little ? i : size - 1 - i;
            bits |= std::uint64_t{std::uint8_t(bytes_[at_ + i])} << (8 * place);
        }
        at_ += size;
        const auto as = [&]<class T>(T) {
            if constexpr (sizeof(T) == 1)
                return double(std::bit_cast<T>(std::uint8_t(bits)));
            else if constexpr (sizeof(T) == 2)
                return double(std::bit_cast<T>(std::uint16_t(bits)));
            else if constexpr (sizeof(T) == 4)
                return double(std::bit_cast<T>(std::uint32_t(bits)));
            else
                return double(std::bit_cast<T>(bits));
        };
        switch (type) {
            case Type::int8:
                return as(std::int8_t{});
            case Type::uint8:
                return as(std::uint8_t{});
            case Type::int16:
                return as(std::int16_t{});
            case Type::uint16:
                return as(std::uint16_t{});
            case Type::int32:
                return as(std::int32_t{});
            case Type::uint32:
                return as(std::uint32_t{});
            case Type::float32:
                return as(float{});
            case Type::float64:
                return as(double{});
        }
        return 0;
    }

    double ascii_number() {
        const auto blank = [](char c) { return c == ' ' || c == '\t' || c == '\r' || c == '\n'; };
        while (at_ < bytes_.size() && blank(bytes_[at_])) ++at_;
        if (at_ >= bytes_.size()) fail(fmt::format("truncated at byte {}", bytes_.size()));
        if (bytes_[at_] == '+') ++at_;  // from_chars accepts no plus sign
        double value = 0;
        const char* start = bytes_.data() + at_;
        const auto [end, error] = std::from_chars(start, bytes_.data() + bytes_.size(), value);
        if (error != std::errc{}) fail(fmt::format("byte {} does not start a number", at_));
        at_ += std::size_t(end - start);
        return value;
    }

    void read_vertices(const PlyElement& element, bool flip_v) {
        bool present[9] = {};
        std::vector<Target> targets;
        for (const PlyProperty& property : element.properties) {
            targets.push_back(property.list ? Target::other : target_of(property.name));
            present[int(targets.back())] = true;
        }
        const auto has = [&](Target t) { return present[int(t)]; };
        if (!has(Target::x) || !has(Target::y) || !has(Target::z)) fail("vertices need the properties x, y, z");
        const bool normals = has(Target::nx) && has(Target::ny) && has(Target::nz);
        const bool uvs = has(Target::u) && has(Target::v);
        mesh_.positions.resize(element.count);
        if (normals) mesh_.normals.resize(element.count);
        if (uvs) mesh_.uvs.resize(element.count);
        for (std::size_t i = 0; i < element.count; ++i) {
            float values[9] = {};
            for (std::size_t k = 0; k < targets.size(); ++k) {
                const PlyProperty& property = element.properties[k];
                if (property.list)
                    skip_list(property);
                else
                    values[int(targets[k])] = float(number(property.type));
            }
            mesh_.positions[i] = {values[0], values[1], values[2]};
            if (normals) mesh_.normals[i] = {values[3], values[4], values[5]};
            if (uvs) mesh_.uvs[i] = {values[6], flip_v ? 1.0f - values[7] : values[7]};
        }
    }

    std::uint64_t list_size(const PlyProperty& property) {
        const double count = number(property.count_type);
        if (!(count >= 0)) fail(fmt::format("a list of {} entries", count));
        return std::uint64_t(count);
    }

    void skip_list(const PlyProperty& property) {
        for (std::uint64_t n = list_size(property); n > 0; --n) number(property.type);
    }

    void read_faces(const PlyElement& element) {
        bool found = false;
        for (const PlyProperty& property : element.properties) found |= is_index_list(property);
        if (!found) fail("faces need the list property vertex_indices");
        mesh_.indices.reserve(3 * element.count);
        for (std::size_t face = 0; face < element.count; ++face)
            for (const PlyProperty& property : element.properties) {
                if (is_index_list(property))
                    read_polygon(property, face);
                else if (property.list)
                    skip_list(property);
                else
                    number(property.type);
            }
    }

    static bool is_index_list(const PlyProperty& property) {
        return property.list && (property.name == "vertex_indices" || property.name == "vertex_index");
    }

    void read_polygon(const PlyProperty& property, std::size_t face) {
        const std::uint64_t n_corners = list_size(property);
        if (n_corners < 3) fail(fmt::format("face {} has {} vertices, needs 3", face, n_corners));
        std::uint32_t corners[3] = {};
        for (std::uint64_t k = 0; k < n_corners; ++k) {
            const double value = number(property.type);
            if (!(value >= 0 && value < double(mesh_.positions.size())))
                fail(fmt::format("face {} refers to vertex {}, the mesh has {}", face, value, mesh_.positions.size()));
            const auto index = std::uint32_t(value);
            if (k >= 3) corners[1] = corners[2];
            corners[std::min<std::uint64_t>(k, 2)] = index;
            if (k >= 2) mesh_.indices.insert(mesh_.indices.end(), corners, corners + 3);
        }
    }

    void skip(const PlyElement& element) {
        for (std::uint64_t i = 0; i < element.count; ++i)
            for (const PlyProperty& property : element.properties) {
                if (property.list)
                    skip_list(property);
                else
                    number(property.type);
            }
    }

    std::string_view bytes_;
    std::size_t at_ = 0;
    std::string file_;
    Encoding encoding_ = Encoding::ascii;
    std::vector<PlyElement> elements_;
    Mesh mesh_;
};

}  // namespace

Mesh load_ply(const std::filesystem::path& file, bool flip_tex_coords) {
    const MappedFile mapped(file);
    const std::string_view bytes(reinterpret_cast<const char*>(mapped.bytes().data()), mapped.bytes().size());
    Mesh mesh = PlyReader(without_byte_order_mark(bytes), file.string()).read(flip_tex_coords);
    check_mesh(mesh, file.string());
    return mesh;
}

}  // namespace loom
