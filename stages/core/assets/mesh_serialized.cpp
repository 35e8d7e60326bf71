// Mitsuba's .serialized format: consecutive zlib streams of triangle meshes, and at the end of the file a table of
// their offsets.

#include <fmt/format.h>
#include <zlib.h>

#include <algorithm>
#include <cstring>
#include <span>

#include "formats/io/error.h"
#include "formats/io/mapped_file.h"
#include "stages/core/assets/mesh.h"

namespace loom {
namespace {

constexpr std::uint16_t magic = 0x041C;

/// Bits of the mesh header.
constexpr std::uint32_t has_normals = 0x1, has_uvs = 0x2, has_colors = 0x8, double_precision = 0x2000;

/// Decompresses a stream in pieces.
class Inflater {
  public:
    Inflater(std::span<const std::byte> compressed, const std::string& file) : file_(file), bytes_(compressed.size()) {
        stream_.next_in = reinterpret_cast<Bytef*>(const_cast<std::byte*>(compressed.data()));
        stream_.avail_in = uInt(std::min<std::size_t>(compressed.size(), ~uInt{0}));
        if (inflateInit(&stream_) != Z_OK) throw std::bad_alloc();
    }
    ~Inflater() { inflateEnd(&stream_); }
    Inflater(const Inflater&) = delete;
    Inflater& operator=(const Inflater&) = delete;

    void read(void* out, std::size_t n_bytes) {
        auto* next = static_cast<Bytef*>(out);
        while (n_bytes > 0) {
            const auto piece = uInt(std::min<std::size_t>(n_bytes, 1u << 30));
            stream_.next_out = next;
            stream_.avail_out = piece;
            const int status = inflate(&stream_, Z_NO_FLUSH);
            const std::size_t got = piece - stream_.avail_out;
            if (got == 0 || (status != Z_OK && status != Z_STREAM_END))
                throw InputError(fmt::format("{}: truncated or damaged mesh data ({})", file_,
                                             stream_.msg ? stream_.msg : "unexpected end"));
            next += got;
            n_bytes -= got;
        }
    }
    template <class T>
    T value() {
        T result;
        read(&result, sizeof result);
        return result;
    }
    /// Refuses counts that the compressed bytes cannot hold: deflate packs at most about 1032 to 1.
    void require_plausible(std::uint64_t count, std::size_t bytes_each) const {
        if (count > std::uint64_t(bytes_) * 1100 / bytes_each)
            throw InputError(
                fmt::format("{}: truncated or damaged: {} entries in {} compressed bytes", file_, count, bytes_));
    }
    std::vector<float> floats(std::uint64_t count, bool doubles) {
        require_plausible(count, doubles ? sizeof(double) : sizeof(float));
        std::vector<float> result(count);
        if (doubles) {
            std::vector<double> wide(count);
            read(wide.data(), count * sizeof(double));
            std::copy(wide.begin(), wide.end(), result.begin());
        } else {
            read(result.data(), count * sizeof(float));
        }
        return result;
    }

  private:
    const std::string& file_;
    std::size_t bytes_;
    z_stream stream_{};
};

template <class T>
T at_byte(std::span<const std::byte> bytes, std::size_t offset) {
    T value;
    std::memcpy(&value, bytes.data() + offset, sizeof value);
    return value;
}

/// Returns the bytes of one shape, header included.
std::span<const std::byte> shape_bytes(std::span<const std::byte> bytes, int shape_index, const std::string& file) {
    const auto bad = [&](const std::string& what) { return InputError(fmt::format("{}: {}", file, what)); };
    if (bytes.size() < 12) throw bad("truncated: shorter than its header");
    if (at_byte<std::uint16_t>(bytes, 0) != magic) throw bad("not a Mitsuba .serialized file");
    const auto version = at_byte<std::uint16_t>(bytes, 2);
    if (version != 3 && version != 4) throw bad(fmt::format("version {}, expected 3 or 4", version));
    const std::size_t entry = version == 3 ? 4 : 8;
    const std::uint64_t count = at_byte<std::uint32_t>(bytes, bytes.size() - 4);
    if (count == 0 || count * entry + 4 > bytes.size())
        throw bad("truncated: the table of shapes at its end is damaged");
    if (shape_index < 0 || std::uint64_t(shape_index) >= count)
        throw bad(fmt::format("has no shape {}, it holds {} (from 0)", shape_index, count));
    const std::size_t table = bytes.size() - 4 - count * entry;
    const auto offset = [&](std::uint64_t i) {
        const std::size_t place = table + i * entry;
        return version == 3 ? std::uint64_t(at_byte<std::uint32_t>(bytes, place))
                            : at_byte<std::uint64_t>(bytes, place);
    };
    const std::uint64_t start = offset(std::uint64_t(shape_index));
    const std::uint64_t end = std::uint64_t(shape_index) + 1 < count ? offset(std::uint64_t(shape_index) + 1) : table;
    if (start + 4 > end || end > table) throw bad(fmt::format("damaged: shape {} ends before it starts", shape_index));
    if (at_byte<std::uint16_t>(bytes, start) != magic || at_byte<std::uint16_t>(bytes, start + 2) != version)
        throw bad(fmt::format("damaged: shape {} has no header", shape_index));
    return bytes.subspan(start, end - start);
}

}  // namespace

Mesh load_serialized(const std::filesystem::path& path, int shape_index) {
    const std::string file = path.string();
    const MappedFile mapped(path);
    const std::span<const std::byte> shape = shape_bytes(mapped.bytes(), shape_index, file);
    Inflater in(shape.subspan(4), file);
    const auto flags = in.value<std::uint32_t>();
    if (at_byte<std::uint16_t>(shape, 2) == 4)
        while (in.value<char>() != '\0') {  // the shape's name
        }
    const auto n_vertices = in.value<std::uint64_t>(), n_triangles = in.value<std::uint64_t>();
    if (n_vertices > 0xFFFFFFFFu)
        throw InputError(fmt::format("{}: shape {} has {} vertices, more than 2^32", file, shape_index, n_vertices));
    in.require_plausible(n_triangles, 3 * sizeof(std::uint32_t));
    const bool doubles = (flags & double_precision) != 0;
    Mesh mesh;
    const std::vector<float> p = in.floats(3 * n_vertices, doubles);
    for (std::size_t i = 0; i < p.size(); i += 3) mesh.positions.push_back({p[i], p[i + 1], p[i + 2]});
    if (flags & has_normals) {
        const std::vector<float> n = in.floats(3 * n_vertices, doubles);
        for (std::size_t i = 0; i < n.size(); i += 3) mesh.normals.push_back({n[i], n[i + 1], n[i + 2]});
    }
    if (flags & has_uvs) {
        const std::vector<float> uv = in.floats(2 * n_vertices, doubles);
        for (std::size_t i = 0; i < uv.size(); i += 2) mesh.uvs.push_back({uv[i], uv[i + 1]});
    }
    if (flags & has_colors) in.floats(3 * n_vertices, doubles);
    mesh.indices.resize(3 * n_triangles);
    in.read(mesh.indices.data(), mesh.indices.size() * sizeof(std::uint32_t));
    check_mesh(mesh, file);
    return mesh;
}

}  // namespace loom
