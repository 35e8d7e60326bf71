#include "stages/derive/reverse_boundary.h"

#include <fmt/format.h>

#include <algorithm>

#include "stages/core/app/report.h"
#include "stages/derive/boundary.h"
#include "stages/derive/interior.h"

namespace loom::derive {

using Vec = Vector3<double>;

MotionBasis::MotionBasis(const Scene& scene, const SceneTangents& tangents, const WantedParts& wanted)
    : wanted_(wanted) {
    Block columns;
    const auto add_affine = [&](Of of, std::uint32_t index, const Vec& centre, double size, int n) {
        for (int k = 0; k < n; ++k) columns.push_back({of, index, k, 0, centre, size});
    };
    const auto extent = [&](std::uint32_t s) {
        const Box3f box = scene.shapes[s].bounds();
        const Vec half = Vec(box.hi - box.lo) * 0.5;
        return std::pair(Vec(box.lo) + half, std::max(length(half), 1e-6));
    };
    for (std::uint32_t s = 0; s < scene.shapes.size(); ++s) {
        const auto [centre, size] = extent(s);
        if (!tangents.shapes[s].empty()) add_affine(Of::shape, s, centre, size, 12);
        if (!tangents.shading_normals[s].empty()) add_affine(Of::normals, s, {}, 1, 9);
    }
    const auto& camera = scene.sensor.world_from_camera;
    const Vec eye{camera[3], camera[7], camera[11]};
    for (std::uint32_t e = 0; e < scene.emitters.size(); ++e)
        if (!tangents.emitters[e].empty()) add_affine(Of::emitter, e, Vec(scene.emitters[e].position), 1, 12);
    if (!tangents.camera.empty()) add_affine(Of::camera, 0, eye, 1, 12);
    if (!tangents.lens.empty()) columns.push_back({Of::lens, 0, 0});
    for (std::uint32_t m = 0; m < wanted.meshes.size(); ++m) {
        const WantedParts::Mesh& mesh = wanted.meshes[m];
        Block vertices;
        for (std::uint32_t i = 0; i < mesh.same.size(); ++i)
            for (int axis = 0; axis < 3 && mesh.same[i] == i; ++axis) vertices.push_back({Of::vertex, m, axis, i});
        if (columns.size() + vertices.size() > max_columns) {
            left_out_ += fmt::format("{}{}", left_out_.empty() ? "" : ", ", mesh.name);
            continue;
        }
        columns.insert(columns.end(), vertices.begin(), vertices.end());
    }
    n_columns_ = columns.size();
    for (std::size_t i = 0; i < columns.size(); i += max_parameters)
        blocks_.emplace_back(columns.begin() + std::ptrdiff_t(i),
                             columns.begin() + std::ptrdiff_t(std::min(i + max_parameters, columns.size())));
}

AffineVelocity MotionBasis::field(const ColumnOf& c) {
    AffineVelocity v;
    if (c.number >= 9) {
        v.offset[c.number - 9] = 1;
        return v;
    }
    v.linear[std::size_t(c.number)] = 1 / c.size;
    v.offset = -v.turned(c.centre);
    return v;
}

SceneTangents MotionBasis::tangents_of(const Block& block, const Scene& scene) const {
    SceneTangents t(scene);
    for (std::uint32_t p = 0; p < block.size(); ++p) {
        const ColumnOf& c = block[p];
        t.parameters.push_back({fmt::format("{}", p), "1", 0});
        switch (c.of) {
            case Of::shape:
                t.shapes[c.index].push_back({p, field(c)});
                break;
            case Of::normals:
                t.shading_normals[c.index].push_back({p, field(c)});
                break;
            case Of::emitter:
                t.emitters[c.index].push_back({p, field(c)});
                break;
            case Of::camera:
                t.camera.push_back({p, field(c)});
                break;
            case Of::lens:
                t.lens.push_back({p, 1});
                break;
            case Of::vertex: {
                const WantedParts::Mesh& mesh = wanted_.meshes[c.index];
                auto& vertices = t.vertices[mesh.shape_idx];
                vertices.resize(mesh.same.size());
                Vec unit;
                unit[c.number] = 1;
                for (std::size_t i = 0; i < mesh.same.size(); ++i)
                    if (mesh.same[i] == c.vertex) vertices[i].push_back({p, unit});
                break;
            }
        }
    }
    return t;
}

void MotionBasis::add(const Block& block, const std::vector<double>& gradient, GradientSums& sums,
                      std::vector<double>& by_vertex) const {
    for (std::size_t p = 0; p < block.size(); ++p) {
        const ColumnOf& c = block[p];
        const double by = gradient[p];
        if (c.of == Of::lens) {
            sums.lens += by;
            continue;
        }
        if (c.of == Of::vertex) {
            const WantedParts::Mesh& mesh = wanted_.meshes[c.index];
            by_vertex[3 * (mesh.first + c.vertex) + std::size_t(c.number)] += by;
            continue;
        }
        AffineGradient& to = c.of == Of::shape     ? sums.shapes[c.index]
                             : c.of == Of::normals ? sums.normals[c.index]
                             : c.of == Of::emitter ? sums.emitters[c.index]
                                                   : sums.camera;
        if (c.number < 9) {
            to.linear[std::size_t(c.number)] += by * c.size;
        } else {
            // A linear field about the origin moves the centre, too.
            const int row = c.number - 9;
            to.offset[row] += by;
            for (int k = 0; k < 3; ++k) to.linear[std::size_t(3 * row + k)] += by * c.centre[k];
        }
    }
}

void MotionBasis::add_boundary(const PathGraph& graph, const Scene& scene, const std::vector<std::string>& off,
                               const BoundaryOptions& options, app::Report& report, GradientSums& sums,
                               std::vector<double>& by_vertex, DeriveCounts& counts) const {
    for (const Block& block : blocks_) {
        const SceneTangents tangents = tangents_of(block, scene);
        const Parts parts = required_parts(scene, graph, tangents, off);
        if (!parts.any_boundary()) continue;
        BoundaryScene s(graph, scene, tangents, options);
        std::vector<std::uint64_t> samples;
        const std::vector<BoundaryRows> rows = sample_boundary(s, parts, report, samples, counts);
        std::vector<double> gradient(block.size());
        for (const BoundaryRows& part : rows)
            for (std::size_t p = 0; p < part.gradient.size(); ++p) gradient[p] += part.gradient[p];
        add(block, gradient, sums, by_vertex);
    }
}

}  // namespace loom::derive
