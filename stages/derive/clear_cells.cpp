#include "stages/derive/clear_cells.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <utility>

#include "stages/core/sampling/streams.h"

namespace loom::derive {
namespace {

using Vec = Vector3<double>;
using Pt = Point3<double>;

/// The region between a cell and a light: half-spaces that hold both.
class Between {
  public:
    Between(const std::array<Pt, 8>& cell, const std::array<Pt, 4>& light) : cell_(cell), light_(light) {}

    /// Adds the half-space of a plane through two points and whichever of `third` bounds both bodies most closely.
    void add(const Pt& a, const Pt& b, std::span<const Pt> third) {
        HalfSpace best;
        double depth = -INFINITY;  // of what lies beyond the plane, not positive
        for (const Pt& c : third) {
            Vec n = cross(b - a, c - a);
            const double size = length(n);
            if (!(size > 0)) continue;
            n = n / size;
            if (dot(n, middle() - a) < 0) n = -n;
            const double beyond = least(n) - dot(n, a - Pt{});
            if (beyond > depth) depth = beyond, best = {n, -least(n)};
        }
        if (std::isfinite(depth)) half_spaces_[std::size_t(n_++)] = best;
    }
    void add(const HalfSpace& h) { half_spaces_[std::size_t(n_++)] = h; }
    std::span<const HalfSpace> half_spaces() const { return {half_spaces_.data(), std::size_t(n_)}; }

  private:
    double least(const Vec& n) const {
        double d = INFINITY;
        for (const Pt& p : cell_) d = std::min(d, dot(n, p - Pt{}));
        for (const Pt& p : light_) d = std::min(d, dot(n, p - Pt{}));
        return d;
    }
    Pt middle() const {
        const Pt of_cell = cell_[0] + (cell_[7] - cell_[0]) * 0.5, of_light = light_[0] + (light_[2] - light_[0]) * 0.5;
        return of_cell + (of_light - of_cell) * 0.5;
    }

    const std::array<Pt, 8>& cell_;
    const std::array<Pt, 4>& light_;
    std::array<HalfSpace, 10> half_spaces_;
    int n_ = 0;
};

/// The coordinates across an axis.
std::array<int, 2> across(int axis) {
    return {axis == 0 ? 1 : 0, axis == 2 ? 1 : 2};
}

constexpr double cells_per_radius = 32, thickness_of_cells = 1.0 / 64;
constexpr std::size_t most_triangles = 64;  // smaller facets are seldom met twice

}  // namespace

std::size_t ClearCells::Hash::operator()(const Cell& cell) const {
    static_assert(sizeof(Cell) == 36);
    std::array<std::uint32_t, 9> words;
    std::memcpy(words.data(), &cell, sizeof(cell));
    std::uint64_t h = 0;
    for (const std::uint32_t word : words) h = streams::numbered(h, word);
    return h;
}

ClearCells::ClearCells(const Scene& scene, const EdgeTree& edges, std::vector<RoundBounds> rounds)
    : edges_(edges),
      rounds_(std::move(rounds)),
      size_(double(scene.radius) / cells_per_radius),
      thickness_(size_ * thickness_of_cells) {
    for (const Shape& shape : scene.shapes)
        has_cells_.push_back(shape.kind == ShapeKind::mesh && shape.triangles.size() <= most_triangles &&
                             shape.mesh.normals.empty());
}

std::array<Pt, 8> ClearCells::corners_of(const Cell& cell) const {
    const auto [u, v] = across(cell.axis);
    const Vec n(cell.ng);
    std::array<Pt, 8> corners;
    for (int i = 0; i < 8; ++i) {
        Pt p;
        p[u] = (cell.place[0] + (i & 1)) * size_;
        p[v] = (cell.place[1] + (i >> 1 & 1)) * size_;
        const double along = (cell.place[2] + (i >> 2)) * thickness_;
        p[cell.axis] = (along - n[u] * p[u] - n[v] * p[v]) / n[cell.axis];
        corners[std::size_t(i)] = p;
    }
    return corners;
}

bool ClearCells::look(const Cell& cell, const std::array<Point3f, 4>& light_corners) const {
    const std::array<Pt, 8> corners = corners_of(cell);
    std::array<Pt, 4> light;
    double largest_coordinate = 0;
    for (std::size_t k = 0; k < 4; ++k) {
        light[k] = Pt(light_corners[k]);
        for (int c = 0; c < 3; ++c) largest_coordinate = std::max(largest_coordinate, std::abs(light[k][c]));
    }
    // Before the light, without what lies in its plane up to rounding.
    Vec normal = normalize(cross(light[1] - light[0], light[2] - light[0]));
    if (dot(normal, corners[0] - light[0]) < 0) normal = -normal;
    double distance = INFINITY, nearest = INFINITY;
    for (const Pt& p : corners) distance = std::min(distance, dot(normal, p - light[0]));
    for (const Pt& p : light) nearest = std::min(nearest, dot(normal, p - light[0]));
    const double rounding = Shaft::rounding_before(normal, distance, largest_coordinate);
    if (!(distance > rounding)) return false;
    Between region(corners, light);
    region.add({normal, -dot(normal, light[0] - Pt{}) - nearest - rounding});
    // Above the cell.
    const Vec ng(cell.ng);
    region.add({ng, -cell.place[2] * thickness_});
    for (std::size_t k = 0; k < 4; ++k) region.add(light[k], light[(k + 1) % 4], corners);
    constexpr std::size_t around[] = {0, 1, 3, 2, 0};
    for (std::size_t k = 0; k < 4; ++k) region.add(corners[around[k]], corners[around[k + 1]], light);

    for (const RoundBounds& round : rounds_) {
        if (round.shape_idx == cell.light_shape_idx) continue;
        const auto beyond = [&](const HalfSpace& h) {
            return dot(h.n, round.center - Pt{}) + h.offset < -round.radius;
        };
        if (std::none_of(region.half_spaces().begin(), region.half_spaces().end(), beyond)) return false;
    }
    return !edges_.any_inside(region.half_spaces(), most_visits);
}

bool ClearCells::is_clear(const Point3f& p, const Normal3f& ng, std::uint32_t shape_idx, std::uint32_t light_shape_idx,
                          const std::array<Point3f, 4>& corners) {
    if (!has_cells_[shape_idx]) return false;
    int axis = 0;
    for (int c = 1; c < 3; ++c)
        if (std::abs(ng[c]) > std::abs(ng[axis])) axis = c;
    const auto [u, v] = across(axis);
    const auto place = [](double x, double size) { return std::int32_t(std::floor(x / size)); };
    const Cell cell{
        shape_idx,
        light_shape_idx,
        ng,
        axis,
        {place(double(p[u]), size_), place(double(p[v]), size_), place(dot(Vec(ng), Pt(p) - Pt{}), thickness_)}};
    const auto [at, is_new] = known_.try_emplace(cell, false);
    if (is_new) at->second = look(cell, corners);
    return at->second;
}

}  // namespace loom::derive
