#pragma once
// How a scene depends on parameters, to first order: velocities of shapes, camera and emitters, and derivatives of
// materials and radiances, each per unit of a parameter.

#include <array>
#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include "stages/core/description/description.h"
#include "stages/core/scene/scene.h"

namespace loom::derive {

/// Velocity field of an affine motion x -> A(theta) x, at the parameter's present value.
///   v(x) = linear x + offset,  linear = A' A^-1
struct AffineVelocity {
    std::array<double, 9> linear{};  // row-major, 1 per unit of the parameter
    Vector3<double> offset;          // m per unit of the parameter

    Vector3<double> at(const Point3<double>& x) const { return turned(Vector3<double>(x)) + offset; }
    /// linear v: change of a vector between two material points.
    Vector3<double> turned(const Vector3<double>& v) const {
        const auto& l = linear;
        return {l[0] * v.x + l[1] * v.y + l[2] * v.z, l[3] * v.x + l[4] * v.y + l[5] * v.z,
                l[6] * v.x + l[7] * v.y + l[8] * v.z};
    }
    /// Change of a unit normal n: the tangential part of -linear^T n.
    Vector3<double> of_normal(const Vector3<double>& n) const {
        const auto& l = linear;
        const Vector3<double> pulled{l[0] * n.x + l[3] * n.y + l[6] * n.z, l[1] * n.x + l[4] * n.y + l[7] * n.z,
                                     l[2] * n.x + l[5] * n.y + l[8] * n.z};
        return n * dot(n, pulled) - pulled;
    }
    /// Relative growth of an area with unit normal n.
    double area_growth(const Vector3<double>& n) const { return linear[0] + linear[4] + linear[8] - dot(n, turned(n)); }
    bool is_zero() const;
};

/// Derivatives of the parameters of a material.
struct MaterialTangent {
    Rgb<double> diffuse, specular, transmittance;
    double alpha_u = 0, alpha_v = 0, eta = 0, opacity = 0, exponent = 0;
    Rgb<double> eta_c, k_c;
    double int_ior = 0;  // absolute index inside, for times of flight

    bool is_zero() const;
    bool scatters() const;  // whether any value of the BSDF changes
    MaterialTangent& operator+=(const MaterialTangent& o);
    MaterialTangent operator*(double s) const;
    /// Calls f with each member.
    template <class Self, class F>
    static void each(Self& t, F&& f) {
        for (auto* colour : {&t.diffuse, &t.specular, &t.transmittance, &t.eta_c, &t.k_c})
            for (int c = 0; c < 3; ++c) f((*colour)[c]);
        for (auto* number : {&t.alpha_u, &t.alpha_v, &t.eta, &t.opacity, &t.exponent, &t.int_ior}) f(*number);
    }
};

/// An effect of one parameter.
template <class Effect>
struct Of {
    std::uint32_t parameter_idx;
    Effect effect;
};
template <class Effect>
using Effects = std::vector<Of<Effect>>;

struct Parameter {
    std::string name, unit;
    double value = 0;
};

/// Effects of all parameters, by what they act on.
struct SceneTangents {
    std::vector<Parameter> parameters;
    std::vector<Effects<AffineVelocity>> shapes;  // [shape]
    std::vector<std::vector<Effects<Vector3<double>>>>
        vertices;                                          // [shape][vertex of its mesh]; empty: none moves alone
    std::vector<Effects<AffineVelocity>> shading_normals;  // [shape]: they turn, positions stay
    std::vector<Effects<MaterialTangent>> materials;       // [material]
    std::vector<Effects<AffineVelocity>> emitters;         // [emitter] without area: position and axes
    std::vector<Effects<Rgb<double>>> radiance;            // [emitter]: of Emitter::radiance; envmap: of its scale
    Effects<AffineVelocity> camera;
    Effects<double> lens;  // relative change of the field of view's tangent

    explicit SceneTangents(const Scene& scene)
        : shapes(scene.shapes.size()),
          vertices(scene.shapes.size()),
          shading_normals(scene.shapes.size()),
          materials(scene.materials.size()),
          emitters(scene.emitters.size()),
          radiance(scene.emitters.size()) {}

    std::size_t n() const { return parameters.size(); }
    bool moves(std::uint32_t shape) const { return !shapes[shape].empty() || !vertices[shape].empty(); }
    bool any_shape_moves() const;
    bool camera_moves() const { return !camera.empty() || !lens.empty(); }
    /// Whether any position of the scene changes.
    bool geometry() const;
};

/// Sets names, units and values of the parameters in a file that keeps them.
template <class Columns>
void describe_parameters(const SceneTangents& tangents, Columns& columns) {
    std::vector<double> values;
    for (const Parameter& parameter : tangents.parameters) {
        columns.name.push_back(parameter.name);
        columns.unit.push_back(parameter.unit);
        values.push_back(parameter.value);
    }
    columns.value = std::move(values);
}

/// Finds the effects of parameters.
/// in:      scene, description  the scene as it is
///          file, defines, sensor  to read it again with other values of a $parameter
///          names  each a $parameter of the scene file, or a named part:
///                 shape:ID/pose, shape:ID/scale, shape:ID/normals, shape:ID/vertices, shape:ID/bsdf/PARAMETER,
///                 shape:ID/radiance, bsdf:ID/PARAMETER, emitter:ID/pose, emitter:ID/radiance, sensor/pose
/// throws:  InputError, with the location in the file where the scene depends on the parameter in another way
SceneTangents find_tangents(const Scene& scene, const SceneDescription& description, const std::filesystem::path& file,
                            const Defines& defines, const std::string& sensor, const std::vector<std::string>& names);

}  // namespace loom::derive
