#include "stages/core/edges/seams.h"

#include <algorithm>
#include <cmath>
#include <optional>
#include <tuple>

#include "stages/core/math/box.h"

namespace loom {
namespace {

using Pt = Point3<double>;
using Vec = Vector3<double>;

constexpr double rounding = 1e-6;    // of coordinates
constexpr double least_sine = 1e-4;  // between planes
constexpr std::uint32_t none = ~0u, mixed = ~0u - 1;

/// A triangle in double precision.
struct Triangle {
    std::array<Pt, 3> p;
    Vec n;             // unit; 0: no area
    double error = 0;  // m

    explicit Triangle(const std::array<Pt, 3>& corners) : p(corners) { finish(); }
    Triangle(const Mesh& mesh, std::uint32_t triangle_idx) {
        const std::uint32_t* i = &mesh.indices[3 * std::size_t(triangle_idx)];
        for (std::size_t k = 0; k < 3; ++k) p[k] = Pt(mesh.positions[i[k]]);
        finish();
    }
    void finish() {
        for (const Pt& corner : p) error = std::max(error, seam_rounding(corner));
        n = cross(p[1] - p[0], p[2] - p[0]);
        const double size = length(n);
        if (size > 0) n = n / size;
    }
};

/// How a triangle lies to the plane of another one.
struct Cut {
    enum class Kind : std::uint8_t { none, proper, edge } kind = Kind::none;
    int side = 0;                  // edge: of the third corner
    std::array<int, 2> corners{};  // edge: on the plane
    std::array<Pt, 2> chord;       // the part on the plane
};

Cut cut(const Triangle& t, const Triangle& plane, double error) {
    std::array<double, 3> d;
    std::array<int, 3> sign;
    for (std::size_t k = 0; k < 3; ++k) {
        d[k] = dot(plane.n, t.p[k] - plane.p[0]);
        sign[k] = d[k] > error ? 1 : d[k] < -error ? -1 : 0;
    }
    const auto [low, high] = std::minmax({sign[0], sign[1], sign[2]});
    Cut out;
    if (low < 0 && high > 0) {
        out.kind = Cut::Kind::proper;
    } else {
        int n_on = 0;
        for (int k = 0; k < 3; ++k)
            if (sign[std::size_t(k)] != 0)
                out.side = sign[std::size_t(k)];
            else if (n_on++ < 2)
                out.corners[std::size_t(n_on - 1)] = k;
        if (n_on != 2) return out;
        out.kind = Cut::Kind::edge;
    }
    std::size_t n = 0;
    for (std::size_t k = 0; k < 3 && n < 2; ++k)
        if (sign[k] == 0) out.chord[n++] = t.p[k];
    for (std::size_t k = 0; k < 3 && n < 2; ++k) {
        const std::size_t j = (k + 1) % 3;
        if (sign[k] * sign[j] < 0) out.chord[n++] = t.p[k] + (t.p[j] - t.p[k]) * (d[k] / (d[k] - d[j]));
    }
    return out;
}

/// An edge of a mesh in the plane of a triangle that it cuts: a seam if the mesh goes on beyond it.
struct Touch {
    std::tuple<std::uint32_t, std::uint32_t, std::uint32_t> shapes;  // of the edge; of the other triangle, its index
    std::array<float, 6> edge;                                       // its ends in a set order
    int side;
    Seam seam;

    auto key() const { return std::tie(shapes, edge); }
};

struct Node {
    Box3f box;
    std::uint32_t first = 0, n = 0;            // leaf: triangles of `order`
    std::uint32_t left = 0, right = 0;         // else
    std::uint32_t shape = none, group = none;  // of all triangles below; mixed
};

bool boxes_overlap(const Box3f& a, const Box3f& b) {
    return a.lo.x <= b.hi.x && b.lo.x <= a.hi.x && a.lo.y <= b.hi.y && b.lo.y <= a.hi.y && a.lo.z <= b.hi.z &&
           b.lo.z <= a.hi.z;
}

/// Whether shapes matter as a pair.
bool is_wanted(const SeamQuery& query, std::uint32_t a, std::uint32_t b) {
    return query.resting || query.group[a] != query.group[b] || query.group[a] == SeamQuery::deforms;
}

class Finder {
  public:
    Finder(std::span<const Shape> shapes, const SeamQuery& query) : shapes_(shapes), query_(query) {}

    SeamSet find() {
        std::vector<std::uint32_t> meshes;
        for (std::uint32_t s = 0; s < shapes_.size(); ++s)
            if (shapes_[s].kind == ShapeKind::mesh && shapes_[s].mesh.n_triangles() > 0) meshes.push_back(s);
        boxes_.resize(shapes_.size());
        for (const std::uint32_t s : meshes) boxes_[s] = grown(shapes_[s].bounds());
        std::erase_if(meshes, [&, all = meshes](std::uint32_t s) {
            return !within(s) && std::none_of(all.begin(), all.end(), [&](std::uint32_t other) {
                return other != s && wanted(s, other) && overlap(boxes_[s], boxes_[other]);
            });
        });
        if (meshes.empty()) return std::move(out_);
        const std::uint32_t root = build_shapes(meshes);
        compare(root, root);
        add_touched();
        return std::move(out_);
    }

  private:
    struct Item {
        std::uint32_t shape_idx, triangle_idx;
        Box3f box;
    };

    bool within(std::uint32_t shape) const { return query_.resting || query_.group[shape] == SeamQuery::deforms; }
    bool wanted(std::uint32_t a, std::uint32_t b) const { return is_wanted(query_, a, b); }
    static bool overlap(const Box3f& a, const Box3f& b) { return boxes_overlap(a, b); }
    static Box3f grown(Box3f box) {
        float size = 0;
        for (int c = 0; c < 3; ++c) size = std::max({size, std::abs(box.lo[c]), std::abs(box.hi[c])});
        box.grow(float(rounding) * size);
        return box;
    }
    static int longest_axis(const Box3f& box) {
        const Vector3f d = box.hi - box.lo;
        return d.x >= d.y && d.x >= d.z ? 0 : d.y >= d.z ? 1 : 2;
    }
    static float middle(const Box3f& box, int axis) { return box.lo[axis] + box.hi[axis]; }

    /// Returns the node over shapes, which are reordered.
    std::uint32_t build_shapes(std::span<std::uint32_t> shapes) {
        if (shapes.size() == 1) return build_mesh(shapes[0]);
        Box3f box;
        for (const std::uint32_t s : shapes) box.add(boxes_[s]);
        const int axis = longest_axis(box);
        const std::size_t half = shapes.size() / 2;
        std::nth_element(shapes.begin(), shapes.begin() + std::ptrdiff_t(half), shapes.end(),
                         [&](std::uint32_t i, std::uint32_t j) {
                             return std::pair(middle(boxes_[i], axis), i) < std::pair(middle(boxes_[j], axis), j);
                         });
        return join(build_shapes(shapes.first(half)), build_shapes(shapes.subspan(half)));
    }
    std::uint32_t build_mesh(std::uint32_t shape_idx) {
        const Mesh& mesh = shapes_[shape_idx].mesh;
        // Triangles that reach no other shape are left out.
        std::vector<Box3f> others;
        if (!within(shape_idx))
            for (std::uint32_t s = 0; s < shapes_.size(); ++s)
                if (s != shape_idx && shapes_[s].kind == ShapeKind::mesh && wanted(s, shape_idx) &&
                    overlap(boxes_[s], boxes_[shape_idx]))
                    others.push_back(boxes_[s]);
        const std::size_t first = items_.size();
        for (std::uint32_t t = 0; t < mesh.n_triangles(); ++t) {
            Box3f box;
            for (std::size_t k = 0; k < 3; ++k) box.add(mesh.positions[mesh.indices[3 * std::size_t(t) + k]]);
            box = grown(box);
            constexpr std::size_t few = 16;
            if (!within(shape_idx) && others.size() <= few &&
                std::none_of(others.begin(), others.end(), [&](const Box3f& other) { return overlap(box, other); }))
                continue;
            items_.push_back({shape_idx, t, box});
        }
        return build_triangles(first, items_.size(), shape_idx);
    }
    std::uint32_t build_triangles(std::size_t begin, std::size_t end, std::uint32_t shape_idx) {
        constexpr std::size_t leaf = 4;
        Box3f box;
        for (std::size_t i = begin; i < end; ++i) box.add(items_[i].box);
        if (end - begin <= leaf) {
            nodes_.push_back(
                {box, std::uint32_t(begin), std::uint32_t(end - begin), 0, 0, shape_idx, query_.group[shape_idx]});
            return std::uint32_t(nodes_.size() - 1);
        }
        const int axis = longest_axis(box);
        const std::size_t half = begin + (end - begin) / 2;
        std::nth_element(items_.begin() + std::ptrdiff_t(begin), items_.begin() + std::ptrdiff_t(half),
                         items_.begin() + std::ptrdiff_t(end), [axis](const Item& i, const Item& j) {
                             return std::pair(middle(i.box, axis), i.triangle_idx) <
                                    std::pair(middle(j.box, axis), j.triangle_idx);
                         });
        const std::uint32_t left = build_triangles(begin, half, shape_idx);
        return join(left, build_triangles(half, end, shape_idx));
    }
    std::uint32_t join(std::uint32_t left, std::uint32_t right) {
        const Node &a = nodes_[left], &b = nodes_[right];
        Node node;
        node.box = a.box;
        node.box.add(b.box);
        node.left = left, node.right = right;
        node.shape = a.shape == b.shape ? a.shape : mixed;
        node.group = a.group == b.group ? a.group : mixed;
        nodes_.push_back(node);
        return std::uint32_t(nodes_.size() - 1);
    }
    bool is_leaf(const Node& node) const { return node.left == node.right; }

    /// Whether two nodes can hold a wanted pair.
    bool may_pair(const Node& a, const Node& b) const {
        if (query_.resting) return true;
        if (a.group == mixed || b.group == mixed || a.group == SeamQuery::deforms) return true;
        return a.group != b.group;
    }
    void compare(std::uint32_t i, std::uint32_t j) {
        if (!out_.complete) return;
        if (++out_.n_tests > query_.most_tests) {
            out_.complete = false;
            return;
        }
        const Node &a = nodes_[i], &b = nodes_[j];
        if (!overlap(a.box, b.box) || !may_pair(a, b)) return;
        if (is_leaf(a) && is_leaf(b)) {
            for (std::uint32_t k = a.first; k < a.first + a.n; ++k)
                for (std::uint32_t l = i == j ? k + 1 : b.first; l < b.first + b.n; ++l) test(items_[k], items_[l]);
        } else if (i == j) {
            compare(a.left, a.left);
            compare(a.left, a.right);
            compare(a.right, a.right);
        } else if (is_leaf(b) || (!is_leaf(a) && half_area(a.box) > half_area(b.box))) {
            compare(a.left, j);
            compare(a.right, j);
        } else {
            compare(i, b.left);
            compare(i, b.right);
        }
    }
    static float half_area(const Box3f& box) {
        const Vector3f d = box.hi - box.lo;
        return d.x * d.y + d.y * d.z + d.z * d.x;
    }

    void test(const Item& i, const Item& j) {
        if (!overlap(i.box, j.box)) return;
        ++out_.n_tests;
        if (i.shape_idx == j.shape_idx ? !within(i.shape_idx) || share_a_corner(i, j)
                                       : !wanted(i.shape_idx, j.shape_idx))
            return;
        const Triangle a(shapes_[i.shape_idx].mesh, i.triangle_idx), b(shapes_[j.shape_idx].mesh, j.triangle_idx);
        const double error = std::max(a.error, b.error);
        const Vec across = cross(a.n, b.n);
        const double sine = length(across);
        if (!(sine > least_sine)) return;
        const Cut of_a = cut(a, b, error);
        if (of_a.kind == Cut::Kind::none) return;
        const Cut of_b = cut(b, a, error);
        if (of_b.kind == Cut::Kind::none) return;
        if (of_a.kind == Cut::Kind::edge && of_b.kind == Cut::Kind::edge) return;

        // The parts of both triangles on the common line.
        const Vec t = across / sine;
        const Pt origin = of_a.chord[0];
        double low = -INFINITY, high = INFINITY;
        for (const Cut* part : {&of_a, &of_b}) {
            const auto [from, to] = std::minmax({dot(t, part->chord[0] - origin), dot(t, part->chord[1] - origin)});
            low = std::max(low, from), high = std::min(high, to);
        }
        if (!(high - low > 4 * error)) return;
        // Points within the chord of the triangle that is cut properly.
        const Cut& proper = of_a.kind == Cut::Kind::proper ? of_a : of_b;
        const double first = dot(t, proper.chord[0] - origin), last = dot(t, proper.chord[1] - origin);
        const auto at = [&](double x) {
            return proper.chord[0] + (proper.chord[1] - proper.chord[0]) * ((x - first) / (last - first));
        };
        Seam seam;
        seam.a = Point3f(at(low)), seam.b = Point3f(at(high));
        seam.faces = {Seam::Face{i.shape_idx, i.triangle_idx, a.n}, Seam::Face{j.shape_idx, j.triangle_idx, b.n}};
        if (of_a.kind == Cut::Kind::edge)
            touch(of_a, i, j, seam);
        else if (of_b.kind == Cut::Kind::edge)
            touch(of_b, j, i, seam);
        else
            out_.seams.push_back(seam);
    }
    bool share_a_corner(const Item& i, const Item& j) const {
        const Mesh& mesh = shapes_[i.shape_idx].mesh;
        for (std::size_t k = 0; k < 3; ++k)
            for (std::size_t l = 0; l < 3; ++l)
                if (mesh.positions[mesh.indices[3 * std::size_t(i.triangle_idx) + k]] ==
                    mesh.positions[mesh.indices[3 * std::size_t(j.triangle_idx) + l]])
                    return true;
        return false;
    }
    void touch(const Cut& of_edge, const Item& edge, const Item& other, const Seam& seam) {
        const Mesh& mesh = shapes_[edge.shape_idx].mesh;
        std::array<std::array<float, 3>, 2> ends;
        for (std::size_t k = 0; k < 2; ++k) {
            const Point3f& p =
                mesh.positions[mesh.indices[3 * std::size_t(edge.triangle_idx) + std::size_t(of_edge.corners[k])]];
            ends[k] = {p.x, p.y, p.z};
        }
        if (ends[1] < ends[0]) std::swap(ends[0], ends[1]);
        // The side by the other triangle's normal, which is the same for both triangles at the edge.
        touches_.push_back({{edge.shape_idx, other.shape_idx, other.triangle_idx},
                            {ends[0][0], ends[0][1], ends[0][2], ends[1][0], ends[1][1], ends[1][2]},
                            of_edge.side,
                            seam});
    }
    void add_touched() {
        std::stable_sort(touches_.begin(), touches_.end(),
                         [](const Touch& i, const Touch& j) { return i.key() < j.key(); });
        for (std::size_t begin = 0, end; begin < touches_.size(); begin = end) {
            bool sides[2] = {false, false};
            for (end = begin; end < touches_.size() && touches_[end].key() == touches_[begin].key(); ++end)
                sides[touches_[end].side > 0] = true;
            if (sides[0] && sides[1]) out_.seams.push_back(touches_[begin].seam);
        }
    }

    std::span<const Shape> shapes_;
    const SeamQuery& query_;
    std::vector<Box3f> boxes_;  // [shape]
    std::vector<Item> items_;
    std::vector<Node> nodes_;
    std::vector<Touch> touches_;
    SeamSet out_;
};

/// Distance of a point from a triangle.
double distance(const Pt& from, const Triangle& t) {
    bool above = true;
    double nearest = INFINITY;
    for (std::size_t k = 0; k < 3; ++k) {
        const Pt& a = t.p[k];
        const Vec e = t.p[(k + 1) % 3] - a, w = from - a;
        above = above && dot(t.n, cross(e, w)) >= 0;
        const double len2 = length2(e), s = len2 > 0 ? std::clamp(dot(e, w) / len2, 0.0, 1.0) : 0;
        nearest = std::min(nearest, length(w - e * s));
    }
    return above ? std::abs(dot(t.n, from - t.p[0])) : nearest;
}

/// Whether a sphere cuts a triangle.
bool cuts(const Shape& sphere, const Triangle& t) {
    const Pt center(sphere.round.center);
    const double radius = sphere.round.radius, error = std::max(t.error, seam_rounding(center));
    double farthest = 0;
    for (const Pt& corner : t.p) farthest = std::max(farthest, length(corner - center));
    return farthest > radius + error && distance(center, t) < radius - error;
}

/// Triangles of a mesh, or of a polygon within a disk.
std::size_t n_triangles(const Shape& shape) {
    constexpr std::size_t fan = 32;
    return shape.kind == ShapeKind::disk ? fan : shape.mesh.n_triangles();
}
Triangle triangle_of(const Shape& shape, std::size_t i) {
    if (shape.kind == ShapeKind::mesh) return Triangle(shape.mesh, std::uint32_t(i));
    const RimEdge rim{shape.round.center, shape.round.u_axis, shape.round.v_axis, 0};
    const double step = 2 * pi_double / double(n_triangles(shape));
    // Turned off the axes, along which disks like to cut.
    const double first = step * (double(i) + 0.37);
    return Triangle({Pt(rim.center), rim.point(first), rim.point(first + step)});
}

bool cut_each_other(const Shape& a, const Shape& b, std::uint64_t& n_tests, std::uint64_t most_tests) {
    if (a.kind == ShapeKind::sphere && b.kind == ShapeKind::sphere) {
        const double d = length(Pt(a.round.center) - Pt(b.round.center)), ra = a.round.radius, rb = b.round.radius;
        return d < (ra + rb) * (1 - rounding) && d > std::abs(ra - rb) + (ra + rb) * rounding;
    }
    if (b.kind == ShapeKind::sphere) return cut_each_other(b, a, n_tests, most_tests);
    for (std::size_t i = 0; i < n_triangles(b) && n_tests < most_tests; ++i) {
        const Triangle t = triangle_of(b, i);
        if (a.kind == ShapeKind::sphere) {
            ++n_tests;
            if (cuts(a, t)) return true;
            continue;
        }
        for (std::size_t j = 0; j < n_triangles(a) && n_tests < most_tests; ++j) {
            ++n_tests;
            const Triangle u = triangle_of(a, j);
            const double error = std::max(t.error, u.error), sine = length(cross(t.n, u.n));
            if (!(sine > least_sine)) continue;
            const Cut of_t = cut(t, u, error), of_u = cut(u, t, error);
            if (of_t.kind != Cut::Kind::proper || of_u.kind != Cut::Kind::proper) continue;
            const Vec along = cross(t.n, u.n) / sine;
            const auto part = [&](const Cut& c) {
                return std::minmax({dot(along, c.chord[0] - t.p[0]), dot(along, c.chord[1] - t.p[0])});
            };
            const auto [t0, t1] = part(of_t);
            const auto [u0, u1] = part(of_u);
            if (std::min(t1, u1) - std::max(t0, u0) > 4 * error) return true;
        }
    }
    return false;
}

}  // namespace

std::vector<std::array<std::uint32_t, 2>> find_round_seams(std::span<const Shape> shapes, const SeamQuery& query,
                                                           std::size_t most) {
    std::vector<std::array<std::uint32_t, 2>> pairs;
    std::vector<Box3f> boxes;
    for (const Shape& shape : shapes) boxes.push_back(shape.bounds());
    std::uint64_t n_tests = 0;
    for (std::uint32_t i = 0; i < shapes.size(); ++i) {
        if (shapes[i].kind == ShapeKind::mesh) continue;
        for (std::uint32_t j = 0; j < shapes.size() && pairs.size() < most; ++j) {
            if (i == j || (shapes[j].kind != ShapeKind::mesh && j < i)) continue;
            if (is_wanted(query, i, j) && boxes_overlap(boxes[i], boxes[j]) &&
                cut_each_other(shapes[i], shapes[j], n_tests, query.most_tests))
                pairs.push_back({i, j});
        }
    }
    return pairs;
}

double seam_rounding(const Pt& p) {
    return rounding * std::max({std::abs(p.x), std::abs(p.y), std::abs(p.z)});
}

SeamSet find_seams(std::span<const Shape> shapes, const SeamQuery& query) {
    return Finder(shapes, query).find();
}

}  // namespace loom
