#pragma once
#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include "stages/core/math/matrix.h"
#include "stages/core/math/vector.h"

namespace loom {

class Object;

/// Triangles over shared vertices. The geometric normal of a triangle (a, b, c) is (b - a) x (c - a).
struct Mesh {
    std::vector<Point3f> positions;      // m
    std::vector<Normal3f> normals;       // unit, one per vertex; empty: geometric normals everywhere
    std::vector<Point2f> uvs;            // one per vertex; empty: none
    std::vector<std::uint32_t> indices;  // three per triangle

    std::size_t n_triangles() const { return indices.size() / 3; }
};

/// Loads the triangles in the order of the file. Polygons are cut as fans. Normals and texture coordinates are those of
/// the file, unchanged apart from `flip_tex_coords` (v -> 1 - v).
/// throws: InputError naming the file and the vertex, face or byte: missing, truncated, empty, index out of range,
///         number not finite
Mesh load_obj(const std::filesystem::path& file, bool flip_tex_coords = true);
Mesh load_ply(const std::filesystem::path& file, bool flip_tex_coords = false);
/// Loads Mitsuba's compressed format, versions 3 and 4.
Mesh load_serialized(const std::filesystem::path& file, int shape_index);

/// Checks the result of a loader.
/// in:     file  name of the file in messages
/// throws: InputError: empty, index out of range, number not finite
void check_mesh(const Mesh& mesh, const std::string& file);

/// Transforms positions by the matrix and normals by its inverse transpose, normalised; computed in double. The order
/// of the vertices is kept. A mirrored mesh therefore has its geometric normals reversed, but not its vertex normals
/// (as in Mitsuba).
void transform(Mesh& mesh, const Matrix4d& world_from_object);

/// Computes vertex normals: means of the normals of the adjacent triangles, weighted by their angle at the vertex.
///   n = sum_t angle_t n_t / |...|                       [Thuermer1998] "Computing Vertex Normals"
void compute_normals(Mesh& mesh);

/// Drops triangles of zero area, which cannot be hit or emit. Returns their number.
std::size_t drop_degenerate_triangles(Mesh& mesh);

/// Returns the mesh of a shape description (obj, ply, serialized) in world space. It is loaded and transformed. Normals
/// are computed where the file has none, dropped for face_normals, reversed for flip_normals. Triangles of zero area
/// are dropped; the mesh may end empty. Thread-safe.
/// out:    notes   one line per fact that the user should read
/// throws: InputError, with the location in the scene file: errors of the loaders, an emitter of zero area
Mesh load_mesh(const Object& shape, std::vector<std::string>& notes);

}  // namespace loom
