#include "stages/cluster/separate.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <memory>

#include "formats/io/octahedral.h"
#include "stages/core/compute/parallel.h"
#include "stages/core/graph/graph_reader.h"
#include "stages/core/scattering/bsdf_model.h"
#include "stages/core/scene/embree.h"
#include "stages/core/scene/scene.h"

namespace loom::cluster {
namespace {

constexpr std::uint64_t vertices_per_chunk = 1 << 16;
/// Factor on the length of a segment between members by which it is raised.
constexpr float raise = 0.1f;
/// Planes are taken as one below this fraction of the distance of two members, the precision of half floats and 16-bit
/// normals.
constexpr float one_plane = 1e-3f;

/// A member's position and its geometric normal on the side of wo.
struct Member {
    Point3f p;
    Normal3f n;
    float rounding;  // of p
};

/// Returns a key of the indices of refraction on the side of wo and, at transmissive surfaces, across. Vertices with
/// equal keys may share.
std::uint64_t media_key(const PathGraph& g, std::size_t j) {
    const auto& v = g.vertices;
    if (v.eta.empty()) return std::uint64_t{std::bit_cast<std::uint32_t>(1.0f)} << 32;
    const auto bits = [](float x) { return std::uint64_t{std::bit_cast<std::uint32_t>(x)}; };
    const std::size_t m = v.material[j];
    if (BsdfKind(g.materials.kind[m]) != BsdfKind::rough_dielectric) return bits(v.eta[j]) << 32;
    const bool outside = dot(shading_normal(g, j), outgoing(g, j)) >= 0;
    return bits(v.eta[j]) << 32 | bits(outside ? g.materials.int_ior[m] : g.materials.ext_ior[m]);
}

/// Returns the segment between two members, raised off their surface; see Separator.
Ray segment(const Member& a, const Member& b) {
    const Vector3f d = b.p - a.p;
    const float distance = length(d);
    const float plane_offset = 0.5f * std::abs(dot(a.n, d) + dot(b.n, d));
    float height = raise * distance;
    if (plane_offset > one_plane * distance) {
        const float turn = length(Vector3f(b.n) - Vector3f(a.n));
        height = std::clamp(0.25f * plane_offset, std::min(0.25f * turn * distance, height), height);
    }
    height = std::max(height, a.rounding + b.rounding);
    const Point3f from = a.p + Vector3f(a.n) * height, to = b.p + Vector3f(b.n) * height;
    const Vector3f along = to - from;
    const float l = length(along);
    return {from, along / l, 0, l};
}

}  // namespace

/// Working memory of one task.
struct Separator::Group {
    std::vector<Point> members, rest;
    std::vector<Member> places;
    std::vector<Ray> rays;
    std::vector<const Ray*> pointers[2];
    std::vector<std::uint32_t> whose[2];
    std::unique_ptr<bool[]> blocked;
    std::size_t capacity = 0;  // of `blocked`
    std::vector<std::uint8_t> hidden;

    /// Merges earlier and newly separated members into one ascending sequence.
    void ascend(std::size_t n_before) {
        std::inplace_merge(rest.begin(), rest.begin() + std::ptrdiff_t(n_before), rest.end(),
                           [](const Point& a, const Point& b) { return a.vertex < b.vertex; });
    }
};

Separator::Separator(const Pool& pool, const Metric& metric, const RayEngine* first, const RayEngine* second,
                     int threads, Scratch<std::uint64_t>& memory)
    : metric_(metric), n_first_(pool.n_first()), engines_{first, second}, starts_(pool.size() / 64 + 1) {
    if (pool.has_media()) {
        media_ = memory.get(pool.size());
        parallel_chunks(media_.size(), vertices_per_chunk, threads,
                        [&](std::uint64_t, std::uint64_t begin, std::uint64_t end) {
                            for (std::uint64_t j = begin; j < end; ++j) {
                                const auto [graph, row] = pool[j];
                                media_[j] = media_key(graph, row);
                            }
                        });
    }
    pool.for_each_graph([&](const PathGraph& g, std::size_t offset) {
        const auto& first_vertex = g.paths.first_vertex;
        for (std::size_t path = 0; path < g.n_paths(); ++path) {
            if (first_vertex[path] == first_vertex[path + 1]) continue;
            const std::size_t start = offset + first_vertex[path];
            starts_[start / 64] |= std::uint64_t{1} << (start % 64);
            longest_ = std::max(longest_, std::uint32_t(first_vertex[path + 1] - first_vertex[path]));
        }
    });
}

/// Whether two vertices, a before b, belong to one path.
bool Separator::one_path(std::uint32_t a, std::uint32_t b) const {
    if (b - a >= longest_) return false;
    for (std::uint32_t word = (a + 1) / 64; word <= b / 64; ++word) {
        std::uint64_t set = starts_[word];
        if (word == (a + 1) / 64) set &= ~std::uint64_t{0} << ((a + 1) % 64);
        if (word == b / 64) set &= ~std::uint64_t{0} >> (63 - b % 64);
        if (set) return false;
    }
    return true;
}

void Separator::cut(std::span<Point> points, std::vector<std::uint32_t>& sizes, Separation& count) const {
    const std::vector<std::uint32_t> cells = std::move(sizes);
    sizes.clear();
    sizes.reserve(cells.size() * 5 / 4 + 1);
    for (const Point& p : points)
        if (!media_.empty()) __builtin_prefetch(&media_[p.vertex]);
    Group group;
    auto at = points.begin();
    for (const std::uint32_t size : cells) {
        auto to = at;
        at += size;
        group.rest.assign(to, at);
        while (!group.rest.empty()) {
            group.members.swap(group.rest);
            group.rest.clear();
            if (!media_.empty()) keep_one_medium(group, count);
            keep_one_of_each_path(group, count);
            if (engines_[0]) keep_visible(group, count);
            sizes.push_back(std::uint32_t(group.members.size()));
            to = std::ranges::copy(group.members, to).out;
        }
    }
}

void Separator::keep_one_medium(Group& group, Separation& count) const {
    auto& members = group.members;
    const std::uint64_t kept = media_[members[0].vertex];
    const auto other =
        std::stable_partition(members.begin(), members.end(), [&](const Point& p) { return media_[p.vertex] == kept; });
    count.n_media += std::uint64_t(members.end() - other);
    group.rest.assign(other, members.end());
    members.erase(other, members.end());
}

/// Members ascend, so those of one path are consecutive.
void Separator::keep_one_of_each_path(Group& group, Separation& count) const {
    auto& members = group.members;
    std::size_t kept = 1;
    const std::size_t n_before = group.rest.size();
    for (std::size_t i = 1; i < members.size(); ++i) {
        if (one_path(members[kept - 1].vertex, members[i].vertex))
            group.rest.push_back(members[i]);
        else
            members[kept++] = members[i];
    }
    members.resize(kept);
    count.n_same_path += group.rest.size() - n_before;
    group.ascend(n_before);
}

void Separator::keep_visible(Group& group, Separation& count) const {
    auto& members = group.members;
    const std::size_t n = members.size();
    if (n < 2) return;
    group.places.clear();
    Vector3f sum{};
    for (const Point& member : members) {
        const auto ng = unit_from_octahedral(member.ng[0], member.ng[1]);
        group.places.push_back({metric_.position(member), {ng[0], ng[1], ng[2]}, metric_.rounding(member)});
        sum = sum + (group.places.back().p - group.places[0].p);
    }
    const Point3f centroid = group.places[0].p + sum * (1 / float(n));
    std::size_t middle = 0;
    for (std::size_t i = 1; i < n; ++i)
        if (length2(group.places[i].p - centroid) < length2(group.places[middle].p - centroid)) middle = i;

    group.rays.resize(n);
    for (int e = 0; e < 2; ++e) group.pointers[e].clear(), group.whose[e].clear();
    for (std::size_t i = 0; i < n; ++i) {
        group.rays[i] = segment(group.places[i], group.places[middle]);
        if (i == middle || !(group.rays[i].t_max > 0)) continue;  // equal positions
        const int e = members[i].vertex < n_first_ ? 0 : 1;
        group.pointers[e].push_back(&group.rays[i]);
        group.whose[e].push_back(std::uint32_t(i));
    }
    group.hidden.assign(n, 0);
    if (n > group.capacity) group.blocked = std::make_unique<bool[]>(group.capacity = n);
    for (int e = 0; e < 2; ++e) {
        if (group.pointers[e].empty()) continue;
        engines_[e]->occluded(group.pointers[e].data(), group.pointers[e].size(), group.blocked.get());
        count.n_rays += group.pointers[e].size();
        for (std::size_t i = 0; i < group.whose[e].size(); ++i) group.hidden[group.whose[e][i]] = group.blocked[i];
    }
    std::size_t kept = 0;
    const std::size_t n_before = group.rest.size();
    for (std::size_t i = 0; i < n; ++i) {
        if (group.hidden[i])
            group.rest.push_back(members[i]);
        else
            members[kept++] = members[i];
    }
    count.n_occluded += group.rest.size() - n_before;
    group.ascend(n_before);
    members.resize(kept);
}

}  // namespace loom::cluster
