#include "stages/cluster/separate.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <memory>

#include "formats/io/octahedral.h"
#include "stages/core/scattering/bsdf_model.h"
#include "stages/core/scene/embree.h"
#include "stages/core/scene/scene.h"
#include "stages/core/transport/graph_reader.h"
#include "stages/core/transport/parallel.h"

namespace loom::cluster {
namespace {

constexpr std::uint64_t cells_per_chunk = 512, vertices_per_chunk = 1 << 16;
/// A segment between members is raised by this part of its length.
constexpr float raise = 0.1f;
/// Planes closer than this part of the distance between two members are one plane: half floats and 16-bit normals are
/// no finer.
constexpr float one_plane = 1e-3f;

/// A member's position and its geometric normal on the side of wo.
struct Member {
    Point3f p;
    Normal3f n;
};

/// Indices of refraction on the side of wo and, at surfaces that transmit, across; equal keys may share.
std::uint64_t media_key(const PathGraph& g, std::size_t j) {
    const auto& v = g.vertices;
    if (v.eta.empty()) return std::uint64_t{std::bit_cast<std::uint32_t>(1.0f)} << 32;
    const auto bits = [](float x) { return std::uint64_t{std::bit_cast<std::uint32_t>(x)}; };
    const std::size_t m = v.material[j];
    if (BsdfKind(g.materials.kind[m]) != BsdfKind::rough_dielectric) return bits(v.eta[j]) << 32;
    const Normal3f n = unit_vector<Normal3f>(v.ns, j);
    const bool outside = dot(n, Vector3f{v.wo[3 * j], v.wo[3 * j + 1], v.wo[3 * j + 2]}) >= 0;
    return bits(v.eta[j]) << 32 | bits(outside ? g.materials.int_ior[m] : g.materials.ext_ior[m]);
}

PackedVertex pack(const PathGraph& g, std::size_t j) {
    const auto& v = g.vertices;
    const auto& column = v.ng.empty() ? v.ns : v.ng;
    PackedVertex out{{v.p[3 * j], v.p[3 * j + 1], v.p[3 * j + 2]}, {column[2 * j], column[2 * j + 1]}, media_key(g, j)};
    const auto n = unit_vector<Normal3f>(column, j);
    if (dot(n, Vector3f{v.wo[3 * j], v.wo[3 * j + 1], v.wo[3 * j + 2]}) < 0)
        out.n = octahedral_from_unit(-n.x, -n.y, -n.z);
    return out;
}

Member unpack(const PackedVertex& vertex) {
    const auto n = unit_from_octahedral(vertex.n[0], vertex.n[1]);
    return {vertex.p, {n[0], n[1], n[2]}};
}

/// Where paths begin among the vertices of a pool.
struct Starts {
    std::vector<std::uint64_t> bits;  // of vertices
    std::uint32_t longest = 0;        // path, in vertices

    explicit Starts(const Pool& pool) : bits(pool.size() / 64 + 1) {
        pool.for_each_graph([&](const PathGraph& g, std::size_t offset) {
            const auto& first = g.paths.first_vertex;
            for (std::size_t path = 0; path < g.n_paths(); ++path) {
                if (first[path] == first[path + 1]) continue;
                bits[(offset + first[path]) / 64] |= std::uint64_t{1} << ((offset + first[path]) % 64);
                longest = std::max(longest, std::uint32_t(first[path + 1] - first[path]));
            }
        });
    }

    /// Whether two vertices, a before b, are of one path.
    bool one_path(std::uint32_t a, std::uint32_t b) const {
        if (b - a >= longest) return false;
        for (std::uint32_t word = (a + 1) / 64; word <= b / 64; ++word) {
            std::uint64_t set = bits[word];
            if (word == (a + 1) / 64) set &= ~std::uint64_t{0} << ((a + 1) % 64);
            if (word == b / 64) set &= ~std::uint64_t{0} >> (63 - b % 64);
            if (set) return false;
        }
        return true;
    }
};

/// The segment between two members, raised off their surface; see separate().
Ray segment(const Member& a, const Member& b) {
    const Vector3f d = b.p - a.p;
    const float distance = length(d);
    const float plane_offset = 0.5f * std::abs(dot(a.n, d) + dot(b.n, d));
    float height = raise * distance;
    if (plane_offset > one_plane * distance) {
        const float turn = length(Vector3f(b.n) - Vector3f(a.n));
        height = std::clamp(0.25f * plane_offset, std::min(0.25f * turn * distance, height), height);
    }
    const Point3f from = a.p + Vector3f(a.n) * height, to = b.p + Vector3f(b.n) * height;
    const Vector3f along = to - from;
    const float l = length(along);
    return {from, along / l, 0, l};
}

/// Working memory of one thread.
struct Group {
    std::vector<std::uint32_t> members, rest;
    std::vector<Member> places;
    std::vector<Ray> rays;
    std::vector<const Ray*> pointers[2];
    std::vector<std::uint32_t> whose[2];
    std::unique_ptr<bool[]> blocked;
    std::size_t capacity = 0;  // of blocked
    std::vector<std::uint8_t> hidden;
};

class Separator {
  public:
    /// in: packed  all vertices of the pool, or none where neither of the two tests that read them is wanted;
    ///     n_first  vertices from here on are of the second engine's scene;  first  null: no visibility test
    Separator(std::span<const PackedVertex> packed, bool has_media, const Starts& starts, std::size_t n_first,
              const RayEngine* first, const RayEngine* second)
        : packed_(packed), has_media_(has_media), starts_(starts), n_first_(n_first), engines_{first, second} {}

    /// Appends groups of one cell to `out`, their sizes to `sizes`.
    /// in: next  cell that comes after it, for which the cache is asked already: members lie far apart in the graph
    void cut(std::span<const std::uint32_t> cell, std::span<const std::uint32_t> next, Group& w,
             std::vector<std::uint32_t>& out, std::vector<std::uint32_t>& sizes, Separation& count) const {
        if (!packed_.empty())
            for (const std::uint32_t vertex : next) __builtin_prefetch(&packed_[vertex]);
        w.rest.assign(cell.begin(), cell.end());
        while (!w.rest.empty()) {
            w.members.swap(w.rest);
            w.rest.clear();
            if (has_media_) keep_one_medium(w, count);
            keep_one_of_each_path(w, count);
            if (engines_[0]) keep_visible(w, count);
            sizes.push_back(std::uint32_t(w.members.size()));
            out.insert(out.end(), w.members.begin(), w.members.end());
        }
    }

  private:
    void keep_one_medium(Group& w, Separation& count) const {
        const std::uint64_t kept = packed_[w.members[0]].media;
        const auto other = std::stable_partition(w.members.begin(), w.members.end(),
                                                 [&](std::uint32_t v) { return packed_[v].media == kept; });
        count.n_media += std::uint64_t(w.members.end() - other);
        w.rest.assign(other, w.members.end());
        w.members.erase(other, w.members.end());
    }

    /// Members ascend, so those of one path follow one another.
    void keep_one_of_each_path(Group& w, Separation& count) const {
        std::size_t kept = 1;
        const std::size_t n_before = w.rest.size();
        for (std::size_t i = 1; i < w.members.size(); ++i) {
            const std::uint32_t vertex = w.members[i];
            if (starts_.one_path(w.members[kept - 1], vertex))
                w.rest.push_back(vertex);
            else
                w.members[kept++] = vertex;
        }
        w.members.resize(kept);
        count.n_same_path += w.rest.size() - n_before;
        ascend(w.rest, n_before);
    }

    /// What was cut off before and what is new, as one ascending row.
    static void ascend(std::vector<std::uint32_t>& rest, std::size_t n_before) {
        std::inplace_merge(rest.begin(), rest.begin() + std::ptrdiff_t(n_before), rest.end());
    }

    void keep_visible(Group& w, Separation& count) const {
        const std::size_t n = w.members.size();
        if (n < 2) return;
        w.places.clear();
        Vector3f sum{};
        for (const std::uint32_t vertex : w.members) {
            w.places.push_back(unpack(packed_[vertex]));
            sum = sum + (w.places.back().p - w.places[0].p);
        }
        const Point3f centroid = w.places[0].p + sum * (1 / float(n));
        std::size_t middle = 0;
        for (std::size_t i = 1; i < n; ++i)
            if (length2(w.places[i].p - centroid) < length2(w.places[middle].p - centroid)) middle = i;

        w.rays.resize(n);
        for (int e = 0; e < 2; ++e) w.pointers[e].clear(), w.whose[e].clear();
        for (std::size_t i = 0; i < n; ++i) {
            w.rays[i] = segment(w.places[i], w.places[middle]);
            if (i == middle || !(w.rays[i].t_max > 0)) continue;  // at one point
            const int e = w.members[i] < n_first_ ? 0 : 1;
            w.pointers[e].push_back(&w.rays[i]);
            w.whose[e].push_back(std::uint32_t(i));
        }
        w.hidden.assign(n, 0);
        if (n > w.capacity) w.blocked = std::make_unique<bool[]>(w.capacity = n);
        for (int e = 0; e < 2; ++e) {
            if (w.pointers[e].empty()) continue;
            engines_[e]->occluded(w.pointers[e].data(), w.pointers[e].size(), w.blocked.get());
            count.n_rays += w.pointers[e].size();
            for (std::size_t i = 0; i < w.whose[e].size(); ++i) w.hidden[w.whose[e][i]] = w.blocked[i];
        }
        std::size_t kept = 0;
        const std::size_t n_before = w.rest.size();
        for (std::size_t i = 0; i < n; ++i) {
            if (w.hidden[i])
                w.rest.push_back(w.members[i]);
            else
                w.members[kept++] = w.members[i];
        }
        count.n_occluded += w.rest.size() - n_before;
        ascend(w.rest, n_before);
        w.members.resize(kept);
    }

    std::span<const PackedVertex> packed_;
    bool has_media_;
    const Starts& starts_;
    std::size_t n_first_;
    const RayEngine* engines_[2];
};

}  // namespace

Separation separate(const Pool& pool, const RayEngine* first, const RayEngine* second, int threads,
                    Scratch<PackedVertex>& memory, Cells& cells) {
    const std::size_t n_cells = cells.first.empty() ? 0 : cells.first.size() - 1;
    Separation sum{.tested_visibility = first != nullptr};
    // Read in the order of the graph: cell by cell each column of each member would be a page of its own.
    const std::span<PackedVertex> packed = memory.get(first || pool.has_media() ? pool.size() : 0);
    parallel_chunks(packed.size(), vertices_per_chunk, threads,
                    [&](std::uint64_t, std::uint64_t begin, std::uint64_t end) {
                        for (std::uint64_t j = begin; j < end; ++j) {
                            const auto [graph, row] = pool[j];
                            packed[j] = pack(graph, row);
                        }
                    });
    const Starts starts(pool);
    const Separator separator(packed, pool.has_media(), starts, pool.n_first(), first, second);
    const std::uint64_t n_chunks = (n_cells + cells_per_chunk - 1) / cells_per_chunk;
    std::vector<std::vector<std::uint32_t>> sizes(n_chunks);
    std::vector<Separation> counts(n_chunks);
    parallel_chunks(n_cells, cells_per_chunk, threads,
                    [&](std::uint64_t chunk, std::uint64_t begin, std::uint64_t end) {
                        Group group;
                        std::vector<std::uint32_t> out;
                        out.reserve(cells.first[end] - cells.first[begin]);
                        const auto cell = [&](std::uint64_t c) {
                            return std::span(cells.member).subspan(cells.first[c], cells.first[c + 1] - cells.first[c]);
                        };
                        for (std::uint64_t c = begin; c < end; ++c)
                            separator.cut(cell(c), c + 1 < end ? cell(c + 1) : cell(begin).first(0), group, out,
                                          sizes[chunk], counts[chunk]);
                        std::copy(out.begin(), out.end(), cells.member.begin() + cells.first[begin]);
                    });
    cells.first.assign(1, 0);
    for (const auto& of_chunk : sizes)
        for (const std::uint32_t size : of_chunk) cells.first.push_back(cells.first.back() + size);
    for (const Separation& c : counts) {
        sum.n_rays += c.n_rays;
        sum.n_media += c.n_media;
        sum.n_occluded += c.n_occluded;
        sum.n_same_path += c.n_same_path;
    }
    return sum;
}

}  // namespace loom::cluster
