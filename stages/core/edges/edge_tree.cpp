#include "stages/core/edges/edge_tree.h"

#include <immintrin.h>

#include <algorithm>
#include <bit>
#include <cmath>
#include <numeric>

#include "stages/core/math/box.h"
#include "stages/core/sampling/streams.h"

namespace loom {
namespace {

using Point3d = Point3<double>;
using Vector3d = Vector3<double>;
using Float4 = float __attribute__((vector_size(16)));
using StoredFloat4 = float __attribute__((vector_size(16), may_alias));
using Mask4 = std::int32_t __attribute__((vector_size(16)));

// Bound of the rounding of a sum of three products of floats, relative to the sum of their sizes, with a margin.
constexpr float slack = 1e-6f;

Float4 load(const std::array<float, 4>& lanes) {
    return reinterpret_cast<const StoredFloat4&>(lanes);
}
Float4 all(float x) {
    return Float4{x, x, x, x};
}
Float4 absolute(Float4 x) {
    return Float4(Mask4(x) & 0x7fffffff);
}
Float4 choose(Mask4 mask, Float4 a, Float4 b) {
    return mask ? a : b;
}
unsigned bits(Mask4 mask) {
    return unsigned(_mm_movemask_ps(__m128(mask)));
}

float rounded_up(double x) {
    return std::nextafter(float(x), INFINITY);
}

}  // namespace

/// A shaft in float.
struct EdgeTree::Query {
    std::array<float, 3> eye;
    float weight;
    struct Plane {
        float n[3], abs_n[3], offset;
    };
    std::array<Plane, 6> planes;
    int n_planes = 0;

    explicit Query(const Shaft& shaft) : weight(float(shaft.weight())) {
        for (int c = 0; c < 3; ++c) eye[std::size_t(c)] = float(shaft.eye()[c]);
        for (const Shaft::Plane& from : shaft.planes()) {
            // The sizes of the components add up to 1, so that rounding is relative to distances.
            const double scale = 1 / (std::abs(from.n.x) + std::abs(from.n.y) + std::abs(from.n.z));
            Plane& plane = planes[std::size_t(n_planes++)];
            for (int c = 0; c < 3; ++c) {
                plane.n[c] = float(from.n[c] * scale);
                plane.abs_n[c] = std::abs(plane.n[c]);
            }
            plane.offset = float(from.offset * scale);
            plane.offset += slack * std::abs(plane.offset);
        }
    }
    /// Vectors to the eye, and the sum of the sizes of their components.
    struct Sight {
        Float4 x, y, z, size;
    };
    Sight sight(const std::array<std::array<float, 4>, 3>& from) const {
        Sight d;
        d.x = all(eye[0]) - all(weight) * load(from[0]);
        d.y = all(eye[1]) - all(weight) * load(from[1]);
        d.z = all(eye[2]) - all(weight) * load(from[2]);
        d.size = absolute(d.x) + absolute(d.y) + absolute(d.z);
        return d;
    }
};

/// Returns the children that may hold silhouettes within the shaft, as bits.
unsigned EdgeTree::open_children(const Node& node, const Query& query) {
    const Query::Sight d = query.sight(node.center);
    // All n . (eye - a) have one sign where |d . n| >= |d| cos(angle from the axis + angle of the cone) exceeds the reach
    // of the edges along n.
    const Float4 along = load(node.axis[0]) * d.x + load(node.axis[1]) * d.y + load(node.axis[2]) * d.z;
    const Float4 d2 = d.x * d.x + d.y * d.y + d.z * d.z, across2 = d2 - along * along;
    const Float4 across2_bound = choose(across2 > 0, across2, all(0)) + all(slack) * d2;
    const Float4 reach = choose(along > 0, load(node.above), load(node.below));
    const Float4 excess = absolute(along) * load(node.cos) - all(query.weight) * reach - all(slack) * d.size;
    Mask4 closed = (excess > 0) & (excess * excess > load(node.sin2) * across2_bound);
    // Boxes beyond a plane.
    const Float4 hx = load(node.half[0]), hy = load(node.half[1]), hz = load(node.half[2]);
    const Float4 margin = all(slack) * (d.size + hx + hy + hz);
    for (int i = 0; i < query.n_planes; ++i) {
        const Query::Plane& plane = query.planes[std::size_t(i)];
        const Float4 center =
            all(plane.offset) - (all(plane.n[0]) * d.x + all(plane.n[1]) * d.y + all(plane.n[2]) * d.z);
        const Float4 half = all(plane.abs_n[0]) * hx + all(plane.abs_n[1]) * hy + all(plane.abs_n[2]) * hz;
        closed |= center + half + margin < 0;
    }
    return ~bits(closed) & ((1u << node.n_children) - 1);
}

/// Returns the edges of a block that may be silhouettes within the shaft, as bits.
unsigned EdgeTree::possible_silhouettes(const Block& block, const Query& query) {
    const Query::Sight d = query.sight(block.a);
    const Float4 margin = all(slack) * d.size;
    const Float4 cos0 = load(block.n0[0]) * d.x + load(block.n0[1]) * d.y + load(block.n0[2]) * d.z;
    const Float4 cos1 = load(block.n1[0]) * d.x + load(block.n1[1]) * d.y + load(block.n1[2]) * d.z;
    const Mask4 towards = (cos0 > margin) & (cos1 > margin), away = (cos0 < -margin) & (cos1 < -margin);
    Mask4 closed = towards | away;
    if (query.n_planes > 0) {
        // Both ends beyond a plane.
        const Query::Sight e = query.sight(block.b);
        const Float4 wide = all(slack) * (d.size + e.size);
        for (int i = 0; i < query.n_planes; ++i) {
            const Query::Plane& plane = query.planes[std::size_t(i)];
            const Float4 nx = all(plane.n[0]), ny = all(plane.n[1]), nz = all(plane.n[2]);
            const Float4 limit = all(plane.offset) + wide;
            closed |= (limit - (nx * d.x + ny * d.y + nz * d.z) < 0) & (limit - (nx * e.x + ny * e.y + nz * e.z) < 0);
        }
    }
    return ~bits(closed) & 15u;
}

void EdgeTree::list(std::uint32_t block_idx, const Shaft& shaft, const Query& query, float share,
                    std::vector<EdgeSegment>& found) const {
    std::array<EdgeInterval, 2> inside;
    for (unsigned open = possible_silhouettes(blocks_[block_idx], query); open; open &= open - 1) {
        const std::uint32_t edge_idx = width * block_idx + std::uint32_t(std::countr_zero(open));
        if (edge_idx >= set_.edges.size()) break;
        const Edge& edge = set_.edges[edge_idx];
        if (!shaft.is_silhouette(edge)) continue;
        const int n = shaft.clip(edge, inside);
        for (int i = 0; i < n; ++i) {
            const auto [s0, s1] = inside[std::size_t(i)];
            found.push_back({s0, s1, edge_idx, float(edge.length() * (s1 - s0)), share});
        }
    }
}

std::size_t EdgeTree::collect(const Shaft& shaft, std::vector<EdgeSegment>& found, std::size_t most) const {
    found.clear();
    if (shaft.empty() || blocks_.empty()) return 0;
    const Query query(shaft);
    std::array<std::uint32_t, stack_size> stack;
    std::size_t n_waiting = 0, n_visited = 0;
    for (std::uint32_t at = root_;; at = stack[--n_waiting]) {
        if (++n_visited > most) return n_visited;
        if (at & is_block) {
            list(at & ~is_block, shaft, query, 1, found);
        } else {
            // Push the last child first, for ascending edges.
            const Node& node = nodes_[at];
            for (unsigned open = open_children(node, query); open;) {
                const int child = std::bit_width(open) - 1;
                stack[n_waiting++] = node.child[std::size_t(child)];
                open &= ~(1u << child);
            }
        }
        if (n_waiting == 0) return n_visited;
    }
}

std::size_t EdgeTree::collect_some(const Shaft& shaft, double n_blocks, double end_speed, std::uint64_t seed,
                                   std::vector<EdgeSegment>& found) const {
    found.clear();
    if (shaft.empty() || blocks_.empty()) return 0;
    const Query query(shaft);
    struct Visit {
        std::uint32_t at;
        float n_blocks, share;
    };
    std::array<Visit, stack_size> stack;
    stack[0] = {root_, std::max(float(n_blocks), 1.0f), 1};
    std::size_t n_visited = 0;
    for (std::size_t n_waiting = 1; n_waiting > 0;) {
        const Visit visit = stack[--n_waiting];
        ++n_visited;
        if (visit.at & is_block) {
            list(visit.at & ~is_block, shaft, query, visit.share, found);
            continue;
        }
        const Node& node = nodes_[visit.at];
        const unsigned open = open_children(node, query);
        Lanes length{}, motion{};
        float all_length = 0, all_motion = 0;
        for (unsigned rest = open; rest; rest &= rest - 1) {
            const auto i = std::size_t(std::countr_zero(rest));
            float d2 = 0, half2 = 0;
            for (std::size_t c = 0; c < 3; ++c) {
                d2 += sqr(query.eye[c] - query.weight * node.center[c][i]);
                half2 += sqr(node.half[c][i]);
            }
            // Seen along a direction, distance does not count. Edges nearer than their box is large count as at its size.
            const float near = query.weight > 0 ? 1 / std::max(d2, half2) : 1;
            length[i] = node.edge_length[i] * near;
            motion[i] = (node.edge_motion[i] + float(end_speed) * node.edge_length[i]) * near;
            all_length += length[i];
            all_motion += motion[i];
        }
        if (!(all_length > 0) || !std::isfinite(all_length) || !std::isfinite(all_motion)) continue;
        const float at_rest = all_motion > 0 ? 0.2f : 1;
        const auto part_of = [&](std::size_t i) {
            return at_rest * length[i] / all_length + (at_rest < 1 ? (1 - at_rest) * motion[i] / all_motion : 0);
        };
        const float u = float(streams::numbered(seed, std::uint64_t(visit.at) + 1) >> 40) * 0x1p-24f;
        float before = u;
        for (unsigned rest = open; rest; rest &= rest - 1) {
            const auto i = std::size_t(std::countr_zero(rest));
            const float n = visit.n_blocks * part_of(i);
            if (n >= 1) {
                stack[n_waiting++] = {node.child[i], n, visit.share};
                continue;
            }
            const float after = before + n;
            if (std::floor(after) > std::floor(before)) stack[n_waiting++] = {node.child[i], 1, visit.share * n};
            before = after;
        }
    }
    return n_visited;
}

void EdgeTree::split_part(std::uint32_t node_idx) {
    const Node& node = nodes_[node_idx];
    for (std::size_t i = 0; i < std::size_t(node.n_children); ++i) {
        Part part;
        for (std::size_t c = 0; c < 3; ++c) {
            part.edges.center[int(c)] = double(node.center[c][i]);
            part.edges.half2 += sqr(double(node.half[c][i]));
        }
        part.edges.length = double(node.edge_length[i]), part.edges.motion = double(node.edge_motion[i]);
        part.at = node.child[i];
        parts_.push_back(part);
    }
}

void EdgeTree::find_parts() {
    constexpr std::size_t most = 16;
    // Split what moves most and is largest; at rest, what is longest and largest.
    const bool at_rest = !(parts_[0].edges.motion > 0);
    const auto size = [&](const Part& part) {
        return part.at & is_block ? -1 : (at_rest ? part.edges.length : part.edges.motion) * part.edges.half2;
    };
    while (parts_.size() + width <= most + 1) {
        const auto largest = std::max_element(parts_.begin(), parts_.end(),
                                              [&](const Part& a, const Part& b) { return size(a) < size(b); });
        if (!(size(*largest) > 0)) return;
        const std::uint32_t at = largest->at;
        parts_.erase(largest);
        split_part(at);
    }
}

double EdgeTree::motion_around(const Point3d& eye, double end_speed) const {
    double sum = 0;
    for (const Part& part : parts_) sum += part.edges.motion_around(eye, end_speed);
    return sum;
}

template <class Apart, class IsWanted>
bool EdgeTree::any_edge(Apart&& apart, IsWanted&& is_wanted, std::size_t most) const {
    if (blocks_.empty()) return false;
    std::array<std::uint32_t, stack_size> stack{root_};
    std::size_t n_visited = 0;
    for (std::size_t n_waiting = 1; n_waiting > 0;) {
        const std::uint32_t at = stack[--n_waiting];
        if (++n_visited > most) return true;
        if (at & is_block) {
            const auto begin = set_.edges.begin() + std::ptrdiff_t(width * std::size_t(at & ~is_block));
            const auto end = begin + std::min<std::ptrdiff_t>(width, set_.edges.end() - begin);
            if (std::any_of(begin, end, is_wanted)) return true;
            continue;
        }
        const Node& node = nodes_[at];
        for (std::size_t child = 0; child < std::size_t(node.n_children); ++child)
            if (!apart(node, child)) stack[n_waiting++] = node.child[child];
    }
    return false;
}

bool EdgeTree::any_inside(std::span<const HalfSpace> region, std::size_t most) const {
    const auto apart = [&](const Node& node, std::size_t child) {
        return std::any_of(region.begin(), region.end(), [&](const HalfSpace& h) {
            double farthest = h.offset;
            for (std::size_t c = 0; c < 3; ++c)
                farthest +=
                    h.n[int(c)] * double(node.center[c][child]) + std::abs(h.n[int(c)]) * double(node.half[c][child]);
            return farthest < 0;
        });
    };
    const auto is_inside = [&](const Edge& edge) {
        double s0 = 0, s1 = 1;
        for (const HalfSpace& h : region) {
            const double at_a = dot(h.n, Vector3d(edge.a)) + h.offset, at_b = dot(h.n, Vector3d(edge.b)) + h.offset;
            if (at_a < 0 && at_b < 0) return false;
            if (at_a < 0) s0 = std::max(s0, at_a / (at_a - at_b));
            if (at_b < 0) s1 = std::min(s1, at_a / (at_a - at_b));
        }
        return s1 >= s0;
    };
    return any_edge(apart, is_inside, most);
}

std::optional<std::uint32_t> EdgeTree::find_near(const Point3d& p, double distance,
                                                 const std::function<bool(std::uint32_t)>& wanted) const {
    const auto apart = [&](const Node& node, std::size_t child) {
        double sum = 0;
        for (std::size_t c = 0; c < 3; ++c)
            sum +=
                sqr(std::max(std::abs(p[int(c)] - double(node.center[c][child])) - double(node.half[c][child]), 0.0));
        return sum > sqr(distance);
    };
    std::optional<std::uint32_t> found;
    any_edge(apart, [&](const Edge& edge) {
        if (length2(edge.point(edge.nearest(p)) - p) > sqr(distance)) return false;
        const auto i = std::uint32_t(&edge - set_.edges.data());
        if (wanted(i)) found = i;
        return found.has_value();
    });
    return found;
}

struct EdgeTree::Builder {
    EdgeTree& tree;
    std::vector<Edge> edges;           // of the set, in its order
    std::vector<float> speeds;         // [edge]
    std::vector<std::uint32_t> order;  // of the tree
    std::vector<Point3f> middles;

    /// Range of `order`.
    struct Range {
        std::size_t begin, end;
        std::size_t size() const { return end - begin; }
    };

    Builder(EdgeTree& tree_, std::span<const float> speeds_)
        : tree(tree_), edges(std::move(tree_.set_.edges)), speeds(speeds_.begin(), speeds_.end()), order(edges.size()) {
        speeds.resize(edges.size());
        std::iota(order.begin(), order.end(), 0u);
        middles.reserve(edges.size());
        for (const Edge& edge : edges) middles.push_back(Point3f(edge.point(0.5)));
    }

    Box3f bounds(Range range) const {
        Box3f box;
        for (std::size_t i = range.begin; i < range.end; ++i) {
            box.add(edges[order[i]].a);
            box.add(edges[order[i]].b);
        }
        return box;
    }

    /// Splits a range of more than four in two by the surface area heuristic over 16 bins. All blocks but the last must
    /// be full, so the first part has a multiple of four. Neither part has less than about a quarter, which bounds the
    /// depth.
    std::array<Range, 2> split(Range range) {
        constexpr int n_bins = 16;
        Box3f box;
        for (std::size_t i = range.begin; i < range.end; ++i) box.add(middles[order[i]]);
        int best_axis = 0;
        double least_cost = INFINITY;
        std::size_t n_first = range.size() / 2;
        for (int axis = 0; axis < 3; ++axis) {
            const double extent = double(box.hi[axis]) - box.lo[axis];
            if (!(extent > 0)) continue;
            std::array<Box3f, n_bins> boxes;
            std::array<std::size_t, n_bins> counts{};
            for (std::size_t i = range.begin; i < range.end; ++i) {
                const double share = (double(middles[order[i]][axis]) - box.lo[axis]) / extent;
                const auto bin = std::size_t(std::clamp(int(share * n_bins), 0, n_bins - 1));
                boxes[bin].add(edges[order[i]].a);
                boxes[bin].add(edges[order[i]].b);
                ++counts[bin];
            }
            std::array<double, n_bins> cost_above{};
            Box3f above;
            std::size_t n_above = 0;
            for (std::size_t bin = n_bins - 1; bin > 0; --bin) {
                above.add(boxes[bin]);
                n_above += counts[bin];
                cost_above[bin] = half_area(above) * double(n_above);
            }
            Box3f below;
            std::size_t n_below = 0;
            for (std::size_t bin = 1; bin < n_bins; ++bin) {
                below.add(boxes[bin - 1]);
                n_below += counts[bin - 1];
                const double cost = half_area(below) * double(n_below) + cost_above[bin];
                if (n_below == 0 || n_below == range.size() || !(cost < least_cost)) continue;
                least_cost = cost;
                best_axis = axis;
                n_first = n_below;
            }
        }
        const std::size_t quarter = (range.size() / 4 + 3) / 4 * 4;
        const std::size_t least = std::max<std::size_t>(quarter, 4);
        n_first = (n_first + 2) / 4 * 4;
        n_first = std::max(least, std::min(n_first, (range.size() - least) / 4 * 4));
        const auto begin = order.begin() + std::ptrdiff_t(range.begin), middle = begin + std::ptrdiff_t(n_first);
        const auto before = [&](std::uint32_t i, std::uint32_t j) {
            return std::pair(middles[i][best_axis], i) < std::pair(middles[j][best_axis], j);
        };
        std::nth_element(begin, middle, order.begin() + std::ptrdiff_t(range.end), before);
        return {Range{range.begin, range.begin + n_first}, Range{range.begin + n_first, range.end}};
    }

    static double half_area(const Box3f& box) {
        if (!(box.hi.x >= box.lo.x)) return 0;
        const Vector3d d = Point3d(box.hi) - Point3d(box.lo);
        return d.x * d.y + d.y * d.z + d.z * d.x;
    }

    /// Returns the node or block over a range.
    std::uint32_t build(Range range) {
        if (range.size() <= width) {
            // A set order within a block.
            std::sort(order.begin() + std::ptrdiff_t(range.begin), order.begin() + std::ptrdiff_t(range.end));
            return std::uint32_t(range.begin / width) | is_block;
        }
        std::array<Range, width> parts{range};
        std::size_t n = 1;
        for (int level = 0; level < 2; ++level)
            for (std::size_t i = n; i-- > 0;)
                if (parts[i].size() > width) {
                    const std::array<Range, 2> halves = split(parts[i]);
                    std::move_backward(parts.begin() + std::ptrdiff_t(i) + 1, parts.begin() + std::ptrdiff_t(n),
                                       parts.begin() + std::ptrdiff_t(n) + 1);
                    parts[i] = halves[0];
                    parts[i + 1] = halves[1];
                    ++n;
                }
        const auto node_idx = std::uint32_t(tree.nodes_.size());
        tree.nodes_.emplace_back();
        Node node{};
        node.n_children = int(n);
        for (std::size_t i = 0; i < n; ++i) {
            bound(node, i, parts[i]);
            node.child[i] = build(parts[i]);
        }
        tree.nodes_[node_idx] = node;
        return node_idx;
    }

    void bound(Node& node, std::size_t lane, Range range) const {
        const Box3f box = bounds(range);
        Point3f center;
        for (int c = 0; c < 3; ++c) {
            const auto k = std::size_t(c);
            center[c] = float(0.5 * (double(box.lo[c]) + box.hi[c]));
            node.center[k][lane] = center[c];
            node.half[k][lane] = rounded_up(std::max(double(box.hi[c]) - center[c], double(center[c]) - box.lo[c]));
        }
        node.edge_length[lane] = node.edge_motion[lane] = 0;
        for (std::size_t i = range.begin; i < range.end; ++i) {
            const auto length = float(edges[order[i]].length());
            node.edge_length[lane] += length;
            node.edge_motion[lane] += length * speeds[order[i]];
        }
        // Without a cone, as with a border: there may be silhouettes from everywhere.
        node.sin2[lane] = 1;
        // The axis is the mean of the normals, each pair on the side of the mean so far.
        Vector3d sum;
        for (std::size_t i = range.begin; i < range.end; ++i) {
            const Edge& edge = edges[order[i]];
            const Vector3d both = Vector3d(edge.n0) + Vector3d(edge.n1);
            sum = dot(both, sum) < 0 ? sum - both : sum + both;
        }
        if (!(length2(sum) > 0)) return;
        const Vector3f axis(normalize(sum));
        double cos = 1, above = -INFINITY, below = -INFINITY;
        for (std::size_t i = range.begin; i < range.end; ++i) {
            const Edge& edge = edges[order[i]];
            const double turn = dot(Vector3d(edge.n0) + Vector3d(edge.n1), Vector3d(axis)) < 0 ? -1 : 1;
            for (const Normal3f& normal : {edge.n0, edge.n1}) {
                const Vector3d n = Vector3d(normal) * turn;
                cos = std::min(cos, dot(n, Vector3d(axis)));
                for (const Point3f& end : {edge.a, edge.b}) {
                    const double reach = dot(n, Point3d(end) - Point3d(center));
                    above = std::max(above, reach);
                    below = std::max(below, -reach);
                }
            }
        }
        cos -= slack;
        if (!(cos > 0)) return;
        for (int c = 0; c < 3; ++c) node.axis[std::size_t(c)][lane] = axis[c];
        node.cos[lane] = float(cos);
        node.sin2[lane] = rounded_up(1 - cos * cos + slack);
        node.above[lane] = rounded_up(above + slack * std::abs(above));
        node.below[lane] = rounded_up(below + slack * std::abs(below));
    }

    EdgeCluster cluster(Range range) const {
        const Box3f box = bounds(range);
        EdgeCluster all;
        for (int c = 0; c < 3; ++c) {
            all.center[c] = 0.5 * (double(box.lo[c]) + box.hi[c]);
            all.half2 += sqr(double(box.hi[c]) - all.center[c]);
        }
        for (std::size_t i = range.begin; i < range.end; ++i) {
            all.length += edges[order[i]].length();
            all.motion += edges[order[i]].length() * double(speeds[order[i]]);
        }
        return all;
    }

    void finish() {
        tree.set_.edges.reserve(edges.size());
        for (std::uint32_t i : order) tree.set_.edges.push_back(edges[i]);
        tree.blocks_.resize((edges.size() + width - 1) / width);
        for (std::size_t i = 0; i < edges.size(); ++i) {
            const Edge& edge = tree.set_.edges[i];
            Block& block = tree.blocks_[i / width];
            for (int c = 0; c < 3; ++c) {
                const auto k = std::size_t(c);
                block.a[k][i % width] = edge.a[c];
                block.b[k][i % width] = edge.b[c];
                block.n0[k][i % width] = edge.n0[c];
                block.n1[k][i % width] = edge.n1[c];
            }
        }
    }
};

EdgeTree::EdgeTree(EdgeSet set, std::span<const float> speeds) : set_(std::move(set)) {
    if (set_.edges.empty()) return;
    Builder builder(*this, speeds);
    root_ = builder.build({0, builder.edges.size()});
    builder.finish();
    parts_ = {{builder.cluster({0, builder.edges.size()}), root_}};
    find_parts();
}

}  // namespace loom
