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

/// Each loader returns the file's triangles in the order of the file, polygons cut as fans, with the
/// file's own normals and texture coordinates, unchanged apart from `flip_tex_coords` (v -> 1 - v).
/// throws: InputError that names the file and the vertex, face or byte: missing, truncated, empty, index
///         out of range, number not finite
Mesh load_obj(const std::filesystem::path& file, bool flip_tex_coords = true);
Mesh load_ply(const std::filesystem::path& file, bool flip_tex_coords = false);
/// Mitsuba's compressed format, versions 3 and 4.
Mesh load_serialized(const std::filesystem::path& file, int shape_index);

/// What every loader checks of its result; `file` is how messages call it.
/// throws: InputError: empty, an index out of range, a number that is not finite
void check_mesh(const Mesh& mesh, const std::string& file);

/// Moves positions by the matrix and normals by its inverse transpose, to unit length; in double. The order
/// of the vertices stays, so that a mirrored mesh has its geometric normals turned inside, its vertex normals
/// not (as in Mitsuba).
void transform(Mesh& mesh, const Matrix4d& world_from_object);

/// Vertex normals: means of the normals of the triangles around, weighted by their angle at the vertex.
///   n = sum_t angle_t n_t / |...|                       [Thuermer1998] "Computing Vertex Normals"
void compute_normals(Mesh& mesh);

/// Drops triangles without area (they cannot be hit or emit); returns how many.
std::size_t drop_degenerate_triangles(Mesh& mesh);

/// The mesh of a shape description (obj, ply, serialized) in world space: loaded, transformed, normals
/// computed where the file has none, dropped for face_normals, turned for flip_normals. Triangles without
/// area are left out; a mesh may end with none. Safe to call from several threads.
/// out:    notes   what a person should know, one line each
/// throws: InputError, with the place in the scene file: what the loaders throw, an emitter without area
Mesh load_mesh(const Object& shape, std::vector<std::string>& notes);

}  // namespace loom
