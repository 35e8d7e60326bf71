#include "stages/core/assets/mesh.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "formats/io/error.h"
#include "stages/core/description/description.h"

namespace loom {
namespace {

using Vector3d = Vector3<double>;

Vector3d face_vector(const Mesh& mesh, std::size_t triangle) {
    const std::uint32_t* i = &mesh.indices[3 * triangle];
    const Point3<double> a(mesh.positions[i[0]]), b(mesh.positions[i[1]]), c(mesh.positions[i[2]]);
    return cross(b - a, c - a);
}

/// Returns the angle between two unit vectors, accurate near 0 and pi where acos is not.
double unit_angle(const Vector3d& a, const Vector3d& b) {
    const double half = 0.5 * length(dot(a, b) < 0 ? a + b : b - a);
    const double angle = 2 * std::asin(std::min(half, 1.0));
    return dot(a, b) < 0 ? pi_double - angle : angle;
}

void flip_orientation(Mesh& mesh) {
    for (std::size_t i = 0; i < mesh.indices.size(); i += 3) std::swap(mesh.indices[i + 1], mesh.indices[i + 2]);
    for (Normal3f& n : mesh.normals) n = -n;
}

bool all_finite(const Point2f& p) {
    return std::isfinite(p.x) && std::isfinite(p.y);
}
using loom::all_finite;

template <class T>
void require_finite(const std::vector<T>& values, const char* what, const std::string& file, const char* where) {
    for (std::size_t i = 0; i < values.size(); ++i)
        if (!all_finite(values[i]))
            throw InputError(fmt::format("{}: {} of vertex {} is not finite{}", file, what, i, where));
}

Mesh load_file(const Object& shape) {
    const std::filesystem::path file = shape.get_path("filename");
    if (shape.plugin == "obj") return load_obj(file, shape.get_bool("flip_tex_coords", true));
    if (shape.plugin == "ply") return load_ply(file, shape.get_bool("flip_tex_coords", false));
    return load_serialized(file, shape.get_int("shape_index", 0));
}

}  // namespace

void check_mesh(const Mesh& mesh, const std::string& file) {
    if (mesh.positions.empty() || mesh.indices.empty())
        throw InputError(
            fmt::format("{}: empty mesh ({} vertices, {} triangles)", file, mesh.positions.size(), mesh.n_triangles()));
    for (std::size_t i = 0; i < mesh.indices.size(); ++i)
        if (mesh.indices[i] >= mesh.positions.size())
            throw InputError(fmt::format("{}: triangle {} refers to vertex {}, the mesh has {}", file, i / 3,
                                         mesh.indices[i], mesh.positions.size()));
    require_finite(mesh.positions, "position", file, "");
    require_finite(mesh.normals, "normal", file, "");
    require_finite(mesh.uvs, "texture coordinate", file, "");
}

void transform(Mesh& mesh, const Matrix4d& world_from_object) {
    for (Point3f& p : mesh.positions) p = Point3f(world_from_object.point(Point3<double>(p)));
    if (mesh.normals.empty()) return;
    const std::array<double, 9> m = world_from_object.normal_matrix();
    for (Normal3f& normal : mesh.normals) {
        const Normal3<double> n(normal);
        const Normal3<double> r(m[0] * n.x + m[1] * n.y + m[2] * n.z, m[3] * n.x + m[4] * n.y + m[5] * n.z,
                                m[6] * n.x + m[7] * n.y + m[8] * n.z);
        const double l = length(r);
        normal = l > 0 ? Normal3f(r / l) : Normal3f{};
    }
}

void compute_normals(Mesh& mesh) {
    std::vector<Vector3d> sums(mesh.positions.size());
    std::vector<Vector3d> any(mesh.positions.size());  // for vertices whose normals cancel
    for (std::size_t t = 0; t < mesh.n_triangles(); ++t) {
        const Vector3d face = face_vector(mesh, t);
        const double l = length(face);
        if (!(l > 0)) continue;
        const Vector3d n = face / l;
        const std::uint32_t* i = &mesh.indices[3 * t];
        for (int k = 0; k < 3; ++k) {
            const Point3<double> p(mesh.positions[i[k]]);
            const Vector3d a = normalize(Point3<double>(mesh.positions[i[(k + 1) % 3]]) - p);
            const Vector3d b = normalize(Point3<double>(mesh.positions[i[(k + 2) % 3]]) - p);
            sums[i[k]] = sums[i[k]] + n * unit_angle(a, b);
            any[i[k]] = n;
        }
    }
    mesh.normals.resize(mesh.positions.size());
    for (std::size_t v = 0; v < sums.size(); ++v) {
        constexpr double cancelled = 1e-9;
        const double l = length(sums[v]);
        const Vector3d n = l > cancelled ? sums[v] / l : length2(any[v]) > 0 ? any[v] : Vector3d(0, 0, 1);
        mesh.normals[v] = Normal3f(n);
    }
}

std::size_t drop_degenerate_triangles(Mesh& mesh) {
    std::size_t kept = 0;
    for (std::size_t t = 0; t < mesh.n_triangles(); ++t) {
        if (!(length2(face_vector(mesh, t)) > 0)) continue;
        for (std::size_t k = 0; k < 3; ++k) mesh.indices[3 * kept + k] = mesh.indices[3 * t + k];
        ++kept;
    }
    const std::size_t dropped = mesh.n_triangles() - kept;
    mesh.indices.resize(3 * kept);
    return dropped;
}

Mesh load_mesh(const Object& shape, std::vector<std::string>& notes) {
    Mesh mesh;
    try {
        mesh = load_file(shape);
    } catch (const InputError& error) {
        shape.fail("filename", error.what());
    }
    const std::string file = shape.get_path("filename").string();
    transform(mesh, shape.get_transform("to_world"));
    try {
        require_finite(mesh.positions, "position", file, " after the transform");
    } catch (const InputError& error) {
        shape.fail("to_world", error.what());
    }
    if (const std::size_t dropped = drop_degenerate_triangles(mesh)) {
        if (mesh.indices.empty() && shape.child(Category::emitter))
            shape.fail("filename",
                       fmt::format("{}: an emitter without area: all {} triangles have none", file, dropped));
        notes.push_back(fmt::format("shape '{}' ({}): {} of {} triangles have no area and were dropped", shape.id, file,
                                    dropped, dropped + mesh.n_triangles()));
    }
    if (shape.get_bool("face_normals", false)) {
        mesh.normals.clear();
    } else if (mesh.normals.empty()) {
        compute_normals(mesh);
    } else if (std::any_of(mesh.normals.begin(), mesh.normals.end(),
                           [](const Normal3f& n) { return !(dot(n, n) > 0); })) {
        Mesh computed{mesh.positions, {}, {}, mesh.indices};
        compute_normals(computed);
        std::size_t replaced = 0;
        for (std::size_t v = 0; v < mesh.normals.size(); ++v)
            if (!(dot(mesh.normals[v], mesh.normals[v]) > 0)) {
                mesh.normals[v] = computed.normals[v];
                ++replaced;
            }
        notes.push_back(
            fmt::format("shape '{}' ({}): {} vertex normals of length 0 were computed", shape.id, file, replaced));
    }
    if (shape.get_bool("flip_normals", false)) flip_orientation(mesh);
    return mesh;
}

}  // namespace loom
