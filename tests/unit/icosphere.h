#pragma once
#include <map>
#include <utility>

#include "stages/core/assets/mesh.h"

namespace loom::test {

/// Sphere of 20 * 4^levels triangles and 30 * 4^levels edges, normals outwards.
inline Mesh icosphere(int levels, const Point3f& center, float radius) {
    Mesh mesh;
    const float g = 1.61803399f;
    for (const Vector3f& v : {Vector3f{-1, g, 0},
                              {1, g, 0},
                              {-1, -g, 0},
                              {1, -g, 0},
                              {0, -1, g},
                              {0, 1, g},
                              {0, -1, -g},
                              {0, 1, -g},
                              {g, 0, -1},
                              {g, 0, 1},
                              {-g, 0, -1},
                              {-g, 0, 1}})
        mesh.positions.push_back(Point3f(v / length(v)));
    mesh.indices = {0, 11, 5, 0, 5, 1, 0, 1, 7, 0, 7, 10, 0, 10, 11, 1, 5, 9, 5, 11, 4,  11, 10, 2,  10, 7, 6, 7, 1, 8,
                    3, 9,  4, 3, 4, 2, 3, 2, 6, 3, 6, 8,  3, 8,  9,  4, 9, 5, 2, 4,  11, 6,  2,  10, 8,  6, 7, 9, 8, 1};
    for (int level = 0; level < levels; ++level) {
        std::map<std::pair<std::uint32_t, std::uint32_t>, std::uint32_t> middles;
        const auto middle = [&](std::uint32_t i, std::uint32_t j) {
            const auto [at, is_new] = middles.try_emplace(std::minmax(i, j), std::uint32_t(mesh.positions.size()));
            if (is_new) {
                const Vector3f sum = Vector3f(mesh.positions[i]) + Vector3f(mesh.positions[j]);
                mesh.positions.push_back(Point3f(normalize(sum)));
            }
            return at->second;
        };
        std::vector<std::uint32_t> finer;
        for (std::size_t t = 0; t < mesh.indices.size(); t += 3) {
            const std::uint32_t a = mesh.indices[t], b = mesh.indices[t + 1], c = mesh.indices[t + 2];
            const std::uint32_t ab = middle(a, b), bc = middle(b, c), ca = middle(c, a);
            finer.insert(finer.end(), {a, ab, ca, b, bc, ab, c, ca, bc, ab, bc, ca});
        }
        mesh.indices = finer;
    }
    for (Point3f& p : mesh.positions) p = center + Vector3f(p) * radius;
    return mesh;
}

}  // namespace loom::test
