#pragma once
// gradient: derivatives of a weighted sum of a histogram by any number of parameters, from one backward sweep.
//
//   loss = sum over pixels, bins and channels of weight H,   gradient = d loss / d parameter
//
// Beside named parameters it holds what every parameter is contracted from: the gradient by the motion of each shape,
// the numbers of each material, and the vertices and texels that were wanted.

#include <array>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include "formats/io/field.h"
#include "formats/io/mapped_file.h"
#include "formats/io/output_file.h"
#include "formats/io/provenance.h"

namespace loom {

/// Numbers of a material's row: diffuse, specular, transmittance, eta_c, k_c (rgb each), then alpha_u, alpha_v, eta,
/// opacity, exponent, int_ior.
inline constexpr std::size_t n_material_numbers = 21;
/// Numbers of a gradient by an affine velocity field.
inline constexpr std::size_t n_affine_numbers = 12;

struct Gradient {
    static constexpr FormatId format{"gradient", 1, 0};

    std::string graph;  // content hash of the path graph, as in Provenance::inputs
    double loss = 0;    // sum of weight times bin

    struct Parameters {
        std::vector<std::string> name, unit;
        Column<double> value, gradient;
    } parameters;

    struct Shapes {
        Column<double> wrench, normals;
    } shapes;

    struct Materials {
        Column<double> numbers;
    } materials;

    struct Emitters {
        Column<double> wrench, radiance;
    } emitters;

    struct Camera {
        std::array<double, n_affine_numbers> wrench{};
        double lens = 0;
    } camera;

    struct Vertices {
        std::vector<std::string> name;
        Column<std::uint64_t> first;
        Column<double> gradient;
    } vertices;

    struct Texels {
        std::vector<std::string> name;
        Column<std::uint32_t> width, height;
        Column<std::uint64_t> first;
        Column<double> gradient;
    } texels;

    Provenance provenance;
    std::shared_ptr<const MappedFile> storage;

    /// Returns the first violated invariant beyond types, lengths and finite floats; empty: none.
    std::string problem() const;

    template <class Self, class Visitor>
    static void fields(Self& g, Visitor& v);
};

/// needs:   columns that share an axis have the same length
void write_gradient(const Gradient& gradient, const std::filesystem::path& path, Sync sync = Sync::yes);
/// Reads, maps and checks the whole file.
/// throws:  InputError naming the file and the dataset
Gradient read_gradient(const std::filesystem::path& path);

template <class Self, class Visitor>
void Gradient::fields(Self& g, Visitor& v) {
    constexpr std::string_view affine = "loss per unit of velocity";
    v.value("graph/hash", g.graph, "", "1", "content hash (XXH64, 16 hexadecimal digits) of the path graph");
    v.value("loss", g.loss, "", "loss", "sum over pixels, bins and channels of weight times histogram");

    auto& p = g.parameters;
    v.names("parameters/name", p.name, "parameter", "name as given by --wrt, with its component");
    v.names("parameters/unit", p.unit, "parameter", "unit of one step of the parameter");
    v.field("parameters/value", p.value, 1, "parameter", "parameters/unit",
            "value at which the gradient holds; 0 for motions, which start from the scene as it is");
    v.field("parameters/gradient", p.gradient, 1, "parameter", "loss per parameters/unit", "derivative of the loss",
            Finite::counted);

    v.field(
        "shapes/wrench", g.shapes.wrench, n_affine_numbers, "shape", affine,
        "gradient by a velocity field M x + o of the shape: 9 numbers by M, row-major, then 3 by o; 0 for shapes that "
        "no parameter moves",
        Finite::counted);
    v.field("shapes/normals", g.shapes.normals, 9, "shape", affine,
            "gradient by a turn M of its shading normals, positions fixed; 0 where no parameter turns them",
            Finite::counted);
    v.field("materials/gradient", g.materials.numbers, n_material_numbers, "material", "loss",
            "gradient by diffuse, specular, transmittance, eta_c, k_c (rgb each), alpha_u, alpha_v, eta, opacity, "
            "exponent, int_ior; 0 where no parameter changes the number",
            Finite::counted);
    v.field("emitters/wrench", g.emitters.wrench, n_affine_numbers, "emitter", affine,
            "of emitters without area; those with area move with their shape", Finite::counted);
    v.field("emitters/radiance", g.emitters.radiance, 3, "emitter", "loss m^2 sr W^-1",
            "gradient by radiance, intensity or irradiance; by its factor where that is textured", Finite::counted);
    v.value("camera/wrench", g.camera.wrench, "affine", affine, "of the sensor's pose");
    v.value("camera/lens", g.camera.lens, "", "loss",
            "by the relative change of the tangent of half the field of view");

    auto& x = g.vertices;
    v.optional_names("vertices/name", x.name, "mesh", "--wrt shape:ID/vertices");
    v.optional("vertices/first", x.first, 1, "mesh+1", "1", "first row of each mesh, and the number of all rows");
    v.optional("vertices/gradient", x.gradient, 3, "vertex", "loss m^-1",
               "by the position of each vertex; copies of one position each hold the gradient of moving them together",
               Finite::counted);

    auto& t = g.texels;
    v.optional_names("texels/name", t.name, "image", "--wrt bsdf:ID/reflectance/texels");
    v.optional("texels/width", t.width, 1, "image", "1", "pixels of a row");
    v.optional("texels/height", t.height, 1, "image", "1", "rows, from the top");
    v.optional("texels/first", t.first, 1, "image+1", "1", "first row of each image, and the number of all rows");
    v.optional("texels/gradient", t.gradient, 3, "texel", "loss",
               "by the linear value of each channel of each pixel; of a grey image: the sum counts", Finite::counted);
}

}  // namespace loom
