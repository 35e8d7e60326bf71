#pragma once
// Vertices and texels by which a loss is differentiated one by one.

#include <cstdint>
#include <string>
#include <vector>

#include "stages/derive/scene_tangents.h"

namespace loom::derive {

/// Vertices and images whose numbers are wanted one by one.
struct WantedParts {
    struct Mesh {
        std::string name;
        std::uint32_t shape_idx;
        std::uint64_t first;              // row of its first vertex
        std::vector<std::uint32_t> same;  // [vertex] first vertex of that position
    };
    std::vector<Mesh> meshes;
    struct Image {
        std::string name;
        std::uint32_t material_idx;
        std::uint64_t first;
        std::uint32_t width, height;
    };
    std::vector<Image> images;

    std::uint64_t n_vertices = 0, n_texels = 0;
    std::vector<int> mesh_of, image_of;  // [shape], [material]: index, or -1
};

/// Returns a list of names (--wrt) without shape:ID/vertices and bsdf:ID/reflectance/texels.
std::vector<std::string> without_parts(const std::vector<std::string>& names);
/// Finds these parts, and marks what they move.
/// in:      names     all of --wrt
///          tangents  of the rest; out: shapes with wanted vertices count as moving
/// throws:  InputError when there is no such part
WantedParts find_parts(const Scene& scene, const std::vector<std::string>& names, SceneTangents& tangents);

}  // namespace loom::derive
