// A reader of this project, because the common libraries join, split by material or reorder vertices. The computed
// normals and the path graph depend on the order and identity of the file's vertices.

#include <fmt/format.h>

#include <charconv>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <limits>
#include <string_view>

#include "formats/io/error.h"
#include "formats/io/mapped_file.h"
#include "stages/core/assets/mesh.h"
#include "stages/core/description/byte_order_mark.h"

namespace loom {
namespace {

constexpr std::uint32_t none = std::numeric_limits<std::uint32_t>::max();

bool is_blank(char c) {
    return c == ' ' || c == '\t' || c == '\r' || c == '\\';
}

class ObjReader {
  public:
    ObjReader(std::string_view text, std::string file, bool flip_v)
        : at_(text.data()), end_(text.data() + text.size()), file_(std::move(file)), flip_v_(flip_v) {}

    Mesh read() {
        for (line_ = 1; at_ < end_; ++line_) read_line();
        if (!any_uv_) mesh_.uvs.clear();
        // With normals at some corners only, the other normals are undefined.
        if (!any_normal_ || missing_normal_) mesh_.normals.clear();
        return std::move(mesh_);
    }

  private:
    [[noreturn]] void fail(const std::string& what) const {
        throw InputError(fmt::format("{}:{}: {}", file_, line_, what));
    }

    void skip_blanks() {
        while (at_ < end_ && is_blank(*at_)) {
            // A backslash at the end of a line continues it.
            if (*at_ == '\\') {
                const char* next = at_ + 1;
                if (next < end_ && *next == '\r') ++next;
                if (next < end_ && *next == '\n') {
                    at_ = next;
                    ++line_;
                }
            }
            ++at_;
        }
    }
    bool at_end_of_line() {
        skip_blanks();
        return at_ >= end_ || *at_ == '\n' || *at_ == '#';
    }

    std::string_view word() {
        skip_blanks();
        const char* start = at_;
        while (at_ < end_ && !is_blank(*at_) && *at_ != '\n') ++at_;
        return {start, std::size_t(at_ - start)};
    }

    void read_line() {
        if (!at_end_of_line()) {
            const std::string_view keyword = word();
            if (keyword == "v")
                points_.push_back({number("v"), number("v"), number("v")});
            else if (keyword == "vt")
                read_uv();
            else if (keyword == "vn")
                directions_.push_back({number("vn"), number("vn"), number("vn")});
            else if (keyword == "f")
                read_face();
        }
        // Groups, materials, lines, and text after the numbers have no effect.
        const void* newline = at_ < end_ ? std::memchr(at_, '\n', std::size_t(end_ - at_)) : nullptr;
        at_ = newline ? static_cast<const char*>(newline) + 1 : end_;
    }

    float number(const char* keyword) {
        skip_blanks();
        if (at_ < end_ && *at_ == '+') ++at_;
        float value = 0;
        const auto [end, error] = std::from_chars(at_, end_, value);
        if (error == std::errc::result_out_of_range) {
            // from_chars refuses values out of a float's range; here too small becomes 0, too large becomes infinite.
            const std::string word_text(at_, end);
            value = float(std::strtod(word_text.c_str(), nullptr));
        } else if (error != std::errc{}) {
            fail(fmt::format("'{}' needs more numbers, found '{}'", keyword, word()));
        }
        at_ = end;
        return value;
    }

    void read_uv() {
        const float u = number("vt");
        const float v = at_end_of_line() ? 0.0f : number("vt");
        texture_points_.push_back({u, flip_v_ ? 1.0f - v : v});
    }

    /// Parses one index of a corner: from 1, or from the end when negative.
    std::uint32_t index(std::size_t count, const char* what) {
        std::int64_t value = 0;
        const auto [end, error] = std::from_chars(at_, end_, value);
        if (error != std::errc{}) fail("a corner of a face is not v, v/vt, v//vn or v/vt/vn");
        at_ = end;
        const std::int64_t position = value < 0 ? std::int64_t(count) + value : value - 1;
        if (position < 0 || position >= std::int64_t(count))
            fail(fmt::format("face refers to {} {}, {} are known so far", what, value, count));
        return std::uint32_t(position);
    }

    /// Returns false between two slashes and after the last one: some programs write v/vt/ and v//.
    bool has_index() const { return at_ < end_ && *at_ != '/' && *at_ != '\n' && !is_blank(*at_); }

    std::uint32_t corner() {
        const std::uint32_t p = index(points_.size(), "vertex");
        std::uint32_t t = none, n = none;
        if (at_ < end_ && *at_ == '/') {
            ++at_;
            if (has_index()) t = index(texture_points_.size(), "texture coordinate");
            if (at_ < end_ && *at_ == '/') {
                ++at_;
                if (has_index()) n = index(directions_.size(), "normal");
            }
        }
        return vertex(p, t, n);
    }

    /// Returns the mesh vertex of these indices; corners with three equal indices share one.
    std::uint32_t vertex(std::uint32_t p, std::uint32_t t, std::uint32_t n) {
        if (p >= first_.size()) first_.resize(points_.size(), none);
        std::uint32_t* link = &first_[p];
        while (*link != none) {
            const Key& key = keys_[*link];
            if (key.t == t && key.n == n) return *link;
            link = &keys_[*link].next;
        }
        const auto made = std::uint32_t(keys_.size());
        *link = made;
        keys_.push_back({t, n, none});
        mesh_.positions.push_back(points_[p]);
        mesh_.uvs.push_back(t == none ? Point2f{} : texture_points_[t]);
        mesh_.normals.push_back(n == none ? Normal3f{} : directions_[n]);
        any_uv_ |= t != none;
        (n == none ? missing_normal_ : any_normal_) = true;
        return made;
    }

    void read_face() {
        std::uint32_t corners[3];
        int count = 0;
        while (!at_end_of_line()) {
            const std::uint32_t v = corner();
            if (count < 3) {
                corners[count] = v;
            } else {
                corners[1] = corners[2];
                corners[2] = v;
            }
            if (++count >= 3) mesh_.indices.insert(mesh_.indices.end(), corners, corners + 3);
        }
        if (count < 3) fail(fmt::format("a face needs 3 vertices, this one has {}", count));
    }

    struct Key {
        std::uint32_t t, n, next;
    };

    const char* at_;
    const char* end_;
    std::string file_;
    bool flip_v_;
    std::size_t line_ = 1;
    std::vector<Point3f> points_;
    std::vector<Point2f> texture_points_;
    std::vector<Normal3f> directions_;
    std::vector<std::uint32_t> first_;  // [point] the first mesh vertex made from it
    std::vector<Key> keys_;             // [mesh vertex]
    Mesh mesh_;
    bool any_uv_ = false, any_normal_ = false, missing_normal_ = false;
};

}  // namespace

Mesh load_obj(const std::filesystem::path& file, bool flip_tex_coords) {
    const MappedFile mapped(file);
    const std::string_view text(reinterpret_cast<const char*>(mapped.bytes().data()), mapped.bytes().size());
    Mesh mesh = ObjReader(without_byte_order_mark(text), file.string(), flip_tex_coords).read();
    check_mesh(mesh, file.string());
    return mesh;
}

}  // namespace loom
