// Reverse mode of loom-derive: the backward sweep equals the contraction of the forward derivatives with the weights, on
// the same paths, for every kind of parameter.
// Detected mutations: growth of areas lost; slides over normals or textures lost; change of a refracted ray by the index
// lost; length by the index of a medium lost; turn of the shading frame lost; distance to a
// point light lost; the segment before the first hit counted although the film leaves it out; texels weighted equally;
// the centre or the size of a basis motion lost.

#include "stages/derive/reverse.h"

#include <gtest/gtest.h>

#include <random>

#include "formats/io/error.h"
#include "stages/core/description/description.h"
#include "stages/core/graph/own_samples.h"
#include "stages/derive/boundary.h"
#include "stages/derive/interior.h"
#include "stages/derive/reverse_boundary.h"
#include "tests/traced_graph.h"

namespace loom::derive {
namespace {

using testing::scratch_file;

/// A scene with its parameters and a graph of it.
struct Case {
    std::unique_ptr<Scene> scene;
    std::optional<SceneTangents> tangents;
    WantedParts wanted;
    PathGraph graph;
};

constexpr int film_width = 7, film_height = 5, n_bins = 11;

/// in:      names  --wrt
Case make_case(const std::filesystem::path& file, const Defines& defines, const std::vector<std::string>& names,
               std::uint64_t spp) {
    Case c;
    const SceneDescription description = read_scene(file, defines, "");
    c.scene = build_scene(description);
    c.tangents.emplace(find_tangents(*c.scene, description, file, defines, "", without_parts(names)));
    c.wanted = find_parts(*c.scene, names, *c.tangents);
    OptionalColumns columns;
    columns.primitives = columns.media = true;
    c.graph = testing::trace_graph(*c.scene, testing::path_options(*c.scene, 7), spp, 0, columns);
    EXPECT_EQ(missing_columns(c.graph, *c.scene, *c.tangents), "");
    return c;
}
/// in:      body   sensor type and parameters without film, BSDFs, shapes, emitters
///          names  --wrt
Case make_case(const std::string& sensor, const std::string& body, const std::vector<std::string>& names,
               std::uint64_t spp, int max_depth = 6) {
    const auto file = scratch_file(".xml");
    std::ofstream(file) << fmt::format(
        R"(<scene version="3.0.0"><integrator type="path"><integer name="max_depth" value="{}"/></integrator>
<sensor {}<film type="hdrfilm"><integer name="width" value="{}"/><integer name="height" value="{}"/><rfilter type="box"/></film></sensor>
{}
</scene>)",
        max_depth, sensor, film_width, film_height, body);
    Case c = make_case(file, {}, names, spp);
    std::filesystem::remove(file);
    return c;
}

struct Response {
    const char* pulse;
    double length = 0, gate = 1;  // gate: in bins
    bool from_camera = true;
};

/// Random weights, of which a few are 0.
TransientCube weights(const Response& response, double start, double end, std::uint32_t height = film_height) {
    TransientCube cube;
    cube.film = {film_width, height, 1};
    cube.time.n_bins = n_bins;
    cube.time.start_opl = start;
    cube.time.bin_width_opl = (end - start) / n_bins;
    cube.time.gate_opl = response.gate * cube.time.bin_width_opl;
    cube.response.pulse = response.pulse;
    cube.response.length_opl = response.length;
    cube.response.tail_opl = 0.4;
    cube.response.period_opl = 3.1;
    cube.time.camera_segment = response.from_camera;
    std::mt19937 random(3);
    std::uniform_real_distribution<float> uniform(-1, 1);
    std::vector<float> values(3 * n_bins * film_width * height);
    for (float& x : values) x = uniform(random) > 0.8f ? 0.0f : uniform(random);
    cube.radiance = std::move(values);
    return cube;
}

/// Contraction of the forward derivatives, and the sum of the absolute values of its terms.
struct Forward {
    std::vector<double> gradient, size;
    double loss = 0;
};
Forward contract_forward(const Case& c, const SceneTangents& tangents, const Adjoint& adjoint) {
    const PathGraph& g = c.graph;
    const std::size_t n = tangents.n();
    Forward f{std::vector<double>(n), std::vector<double>(n)};
    const InteriorWalker walker(g, *c.scene, tangents);
    const GraphReader reader(g);
    const OpticalLengths lengths(g, adjoint.timing());
    const double inv_n = 1 / double(g.tracing.samples_per_pixel);
    std::vector<double> opl(g.n_light_edges()), seen(g.n_paths());
    std::size_t edge = 0;
    for (std::size_t path = 0; path < g.n_paths(); ++path) {
        walk_edges_in_time(
            reader, lengths, path, edge,
            [&](const Spectrum& Le, double t) {
                seen[path] = t;
                LightWeight a;
                if (adjoint.at(path % g.n_pixels(), t, a))
                    for (int k = 0; k < 3; ++k) f.loss += inv_n * double(Le[k]) * a.value[k];
            },
            [&](std::size_t k, const Spectrum& L, double t) {
                opl[k] = t;
                LightWeight a;
                if (adjoint.at(path % g.n_pixels(), t, a))
                    for (int c3 = 0; c3 < 3; ++c3) f.loss += inv_n * double(L[c3]) * a.value[c3];
            });
    }
    edge = 0;
    for (std::size_t path = 0; path < g.n_paths(); ++path) {
        std::vector<double> first(n);  // change of the segment that does not count
        const auto add = [&](const InteriorWalker::ExactRow& row, double t) {
            LightWeight a;
            if (!adjoint.at(path % g.n_pixels(), t, a)) return;
            for (std::size_t p = 0; p < n; ++p)
                for (int k = 0; k < 3; ++k) {
                    const double x = inv_n * row.dL[p][k] * a.value[k],
                                 y = inv_n * row.L[k] * (row.dopl[p] - first[p]) * a.slope[k];
                    f.gradient[p] += x + y;
                    f.size[p] += std::abs(x) + std::abs(y);
                }
        };
        walker.walk_exactly(
            path, edge, [&](const auto& row) { add(row, opl[row.row]); },
            [&](const auto& row) {
                if (!adjoint.timing().camera_segment) first.assign(row.dopl.begin(), row.dopl.end());
                add(row, seen[row.row]);
            });
    }
    return f;
}

/// A gradient by the backward sweep.
Gradient sweep(const Case& c, const Adjoint& adjoint, int threads = 0) {
    app::Report report;
    report.set_quiet(true);
    GradientSums sums(*c.scene);
    std::vector<double> by_vertex, by_texel;
    sweep_paths(c.graph, *c.scene, *c.tangents, c.wanted, adjoint, threads, report, sums, by_vertex, by_texel);
    return gradient_of(*c.tangents, c.wanted, sums, std::move(by_vertex), std::move(by_texel));
}

constexpr Response responses[] = {{"delta"},         {"box", 0.7}, {"gaussian", 0.3, 1.5},
                                  {"expgauss", 0.2}, {"sine"},     {"gaussian", 0.4, 1, false}};

/// Expects equal gradients for every response. Parameters are expected to matter: a gradient of 0 tests nothing.
void expect_duality(const Case& c, double start, double end) {
    for (const Response& response : responses) {
        const Adjoint adjoint(weights(response, start, end, c.graph.sensor.height), c.graph, "weights");
        const Forward forward = contract_forward(c, *c.tangents, adjoint);
        const Gradient backward = sweep(c, adjoint);
        EXPECT_NEAR(backward.loss, forward.loss, 1e-6 * std::abs(forward.loss) + 1e-9);
        std::size_t n_zero = 0;
        const double largest = *std::max_element(forward.size.begin(), forward.size.end());
        for (std::size_t p = 0; p < c.tangents->n(); ++p) {
            n_zero += std::size_t(forward.size[p] == 0);
            EXPECT_NEAR(backward.parameters.gradient[p], forward.gradient[p], 1e-10 * forward.size[p] + 1e-14 * largest)
                << c.tangents->parameters[p].name << ", " << response.pulse << ": off by "
                << (backward.parameters.gradient[p] - forward.gradient[p]) / forward.size[p];
        }
        // A shift of a flat mirror within its plane changes nothing.
        EXPECT_LE(4 * n_zero, c.tangents->n());
    }
}

constexpr const char* pinhole =
    R"(type="perspective"><float name="fov" value="50"/><transform name="to_world"><lookat origin="0.3,-4,2.2" target="0,0,0.7" up="0,0,1"/></transform>)";

/// A floor, a lamp, walls of several materials and other lights.
constexpr const char* room = R"(
<bsdf type="diffuse" id="white"><rgb name="reflectance" value="0.7,0.6,0.5"/></bsdf>
<bsdf type="roughconductor" id="metal"><float name="alpha" value="0.3"/><rgb name="eta" value="0.2,0.9,1.1"/><rgb name="k" value="3,2.4,2.2"/></bsdf>
<bsdf type="roughplastic" id="paint"><float name="alpha" value="0.25"/><rgb name="diffuse_reflectance" value="0.1,0.3,0.6"/></bsdf>
<bsdf type="roughdielectric" id="frost"><float name="alpha" value="0.3"/><float name="int_ior" value="1.5"/></bsdf>
<bsdf type="dielectric" id="glass"><float name="int_ior" value="1.4"/></bsdf>
<bsdf type="conductor" id="silver"><rgb name="eta" value="0.2,0.9,1.1"/><rgb name="k" value="3,2.4,2.2"/></bsdf>
<bsdf type="mask" id="gauze"><float name="opacity" value="0.4"/><bsdf type="diffuse"><rgb name="reflectance" value="0.5"/></bsdf></bsdf>
<bsdf type="phong" id="phong"><float name="exponent" value="8"/><rgb name="specular_reflectance" value="0.4"/><rgb name="diffuse_reflectance" value="0.3"/></bsdf>
<shape type="rectangle" id="floor"><transform name="to_world"><scale value="3"/></transform><ref id="white"/></shape>
<shape type="rectangle" id="back"><transform name="to_world"><rotate x="1" angle="90"/><scale value="2"/><translate x="0" y="2" z="1"/></transform><ref id="metal"/></shape>
<shape type="rectangle" id="left"><transform name="to_world"><rotate y="1" angle="80"/><scale value="1.5"/><translate x="-2" y="0" z="1"/></transform><ref id="paint"/></shape>
<shape type="rectangle" id="right"><transform name="to_world"><rotate y="1" angle="-70"/><scale value="1.2"/><translate x="2" y="0.4" z="1"/></transform><ref id="phong"/></shape>
<shape type="rectangle" id="veil"><transform name="to_world"><rotate x="1" angle="70"/><scale value="0.6"/><translate x="0.2" y="-1.4" z="1"/></transform><ref id="gauze"/></shape>
<shape type="sphere" id="ball"><point name="center" x="-0.7" y="0.2" z="0.6"/><float name="radius" value="0.5"/><ref id="glass"/></shape>
<shape type="sphere" id="frosted"><point name="center" x="0.7" y="0.6" z="0.5"/><float name="radius" value="0.45"/><ref id="frost"/></shape>
<shape type="rectangle" id="mirror"><transform name="to_world"><rotate y="1" angle="-50"/><scale value="0.5"/><translate x="1.2" y="-0.8" z="0.5"/></transform><ref id="silver"/></shape>
<shape type="rectangle" id="lamp"><transform name="to_world"><rotate x="1" angle="180"/><scale value="0.6"/><translate x="0.1" y="0" z="2.8"/></transform><ref id="white"/><emitter type="area"><rgb name="radiance" value="5,4,0"/></emitter></shape>
<shape type="sphere" id="bulb"><point name="center" x="-1.2" y="-0.9" z="0.5"/><float name="radius" value="0.15"/><ref id="white"/><emitter type="area"><rgb name="radiance" value="6,6,8"/></emitter></shape>
<emitter type="point" id="point"><point name="position" x="1" y="-1" z="2"/><rgb name="intensity" value="2,0,3"/></emitter>
<emitter type="spot" id="spot"><transform name="to_world"><lookat origin="-1,-1,2.5" target="0.2,0.1,0" up="0,1,0"/></transform><rgb name="intensity" value="6"/><float name="cutoff_angle" value="35"/></emitter>
)";

TEST(Reverse, EveryKindOfParameterOfARoom) {
    const Case c =
        make_case(pinhole, room,
                  {"shape:floor/pose", "shape:back/pose", "shape:left/scale", "shape:veil/pose", "shape:ball/pose",
                   "shape:ball/scale", "shape:frosted/pose", "shape:frosted/scale", "shape:mirror/pose",
                   "shape:lamp/pose", "shape:lamp/scale", "shape:bulb/pose", "shape:left/normals"},
                  200);
    ASSERT_LE(c.tangents->n(), std::size_t(max_parameters));
    expect_duality(c, 2.5, 14);
}

TEST(Reverse, CameraLightsAndMaterialsOfARoom) {
    const Case c = make_case(pinhole, room,
                             {"sensor/pose",
                              "emitter:point/pose",
                              "emitter:spot/pose",
                              "emitter:point/intensity",
                              "shape:lamp/radiance",
                              "shape:bulb/radiance",
                              "bsdf:white/reflectance/rgb",
                              "bsdf:metal/alpha",
                              "bsdf:metal/eta/rgb",
                              "bsdf:metal/k",
                              "bsdf:paint/alpha",
                              "bsdf:paint/diffuse_reflectance",
                              "bsdf:frost/alpha",
                              "bsdf:frost/int_ior",
                              "bsdf:glass/int_ior",
                              "bsdf:silver/eta",
                              "bsdf:silver/specular_reflectance",
                              "bsdf:gauze/opacity",
                              "bsdf:phong/exponent",
                              "bsdf:phong/specular_reflectance",
                              "shape:right/pose"},
                             200);
    ASSERT_LE(c.tangents->n(), std::size_t(max_parameters));
    expect_duality(c, 2.5, 14);
}

/// Writes a mesh as OBJ: a bumpy patch of n x n cells with texture coordinates and, smooth, with normals.
std::filesystem::path patch(int n, bool smooth) {
    const auto file = scratch_file(".obj");
    std::ofstream out(file);
    const auto height = [](double x, double y) { return 0.2 * std::sin(2 * x) * std::cos(3 * y); };
    for (int i = 0; i <= n; ++i)
        for (int j = 0; j <= n; ++j) {
            const double x = 2.0 * i / n - 1, y = 2.0 * j / n - 1;
            out << fmt::format("v {} {} {}\nvt {} {}\n", x, y, height(x, y), 0.5 + 0.5 * x, 0.5 + 0.5 * y);
            const double dx = 0.4 * std::cos(2 * x) * std::cos(3 * y), dy = -0.6 * std::sin(2 * x) * std::sin(3 * y);
            const double len = std::sqrt(1 + dx * dx + dy * dy);
            out << fmt::format("vn {} {} {}\n", -dx / len, -dy / len, 1 / len);
        }
    const auto corner = [&](int i, int j) {
        const int k = i * (n + 1) + j + 1;
        return smooth ? fmt::format("{0}/{0}/{0}", k) : fmt::format("{0}/{0}", k);
    };
    for (int i = 0; i < n; ++i)
        for (int j = 0; j < n; ++j)
            out << fmt::format("f {0} {1} {2}\nf {0} {2} {3}\n", corner(i, j), corner(i + 1, j), corner(i + 1, j + 1),
                               corner(i, j + 1));
    return file;
}

/// A patch under a lamp and a point light; its BSDF is `bsdf`.
std::string patch_scene(const std::filesystem::path& mesh, const std::string& bsdf) {
    return fmt::format(R"({}
<shape type="obj" id="patch"><string name="filename" value="{}"/><transform name="to_world"><scale value="1.5"/></transform><ref id="skin"/></shape>
<shape type="rectangle" id="wall"><transform name="to_world"><rotate x="1" angle="90"/><scale value="2"/><translate x="0" y="2" z="1"/></transform><bsdf type="diffuse"><rgb name="reflectance" value="0.6"/></bsdf></shape>
<shape type="rectangle" id="lamp"><transform name="to_world"><rotate x="1" angle="180"/><scale value="0.6"/><translate x="0.1" y="0" z="2.8"/></transform><bsdf type="diffuse"/><emitter type="area"><rgb name="radiance" value="5,4,3"/></emitter></shape>
<emitter type="point" id="point"><point name="position" x="1" y="-1" z="2"/><rgb name="intensity" value="2,1,3"/></emitter>)",
                       bsdf, mesh.string());
}

std::filesystem::path noise_image(int n) {
    const auto file = scratch_file(".pfm");
    std::ofstream out(file, std::ios::binary);
    out << fmt::format("PF\n{0} {0}\n-1\n", n);
    std::mt19937 random(5);
    std::uniform_real_distribution<float> uniform(0.1f, 0.9f);
    for (int i = 0; i < 3 * n * n; ++i) {
        const float x = uniform(random);
        out.write(reinterpret_cast<const char*>(&x), sizeof x);
    }
    return file;
}

std::string textured_skin(const std::filesystem::path& image) {
    return fmt::format(
        R"(<bsdf type="diffuse" id="skin"><texture type="bitmap" name="reflectance"><string name="filename" value="{}"/><boolean name="raw" value="true"/></texture></bsdf>)",
        image.string());
}

TEST(Reverse, SlidesOverSmoothNormalsAndTextures) {
    const auto mesh = patch(6, true), image = noise_image(8);
    const Case c = make_case(pinhole, patch_scene(mesh, textured_skin(image)),
                             {"shape:patch/pose", "shape:patch/scale", "sensor/pose", "shape:lamp/pose",
                              "shape:patch/normals", "emitter:point/pose"},
                             200);
    expect_duality(c, 2.5, 10);
    const auto flat = patch(6, false);
    const Case rough = make_case(
        pinhole, patch_scene(flat, R"(<bsdf type="roughplastic" id="skin"><float name="alpha" value="0.2"/></bsdf>)"),
        {"shape:patch/pose", "sensor/pose", "bsdf:skin/alpha", "bsdf:skin/int_ior"}, 200);
    expect_duality(rough, 2.5, 10);
    for (const auto& file : {mesh, image, flat}) std::filesystem::remove(file);
}

TEST(Reverse, LaserSpotsOfAnNlosCapture) {
    const std::filesystem::path file = std::filesystem::path(LOOM_SOURCE_DIR) / "scenes/nlos.xml";
    for (const char* capture : {"single", "confocal"}) {
        const Case c = make_case(
            file, {{"res", "7"}, {"capture", capture}},
            {"shape:lower/pose", "shape:ball/pose", "bsdf:white/reflectance/rgb", "bsdf:orange/reflectance"}, 100);
        expect_duality(c, 1, 4);
    }
}

TEST(Reverse, HundredVerticesEqualForwardInBlocks) {
    for (const bool smooth : {false, true}) {
        const auto mesh = patch(6, smooth);  // 49 positions, 147 columns
        const std::string body =
            patch_scene(mesh, R"(<bsdf type="roughconductor" id="skin"><float name="alpha" value="0.3"/></bsdf>)");
        const Case c = make_case(pinhole, body, {"shape:patch/vertices"}, 100);
        const Adjoint adjoint(weights(responses[2], 2.5, 10), c.graph, "weights");
        const Gradient backward = sweep(c, adjoint);
        const WantedParts::Mesh& wanted = c.wanted.meshes.at(0);
        std::filesystem::remove(mesh);
        const std::size_t n = wanted.same.size();
        double largest = 0;
        for (std::size_t first = 0; first < n; first += 20) {
            SceneTangents tangents(*c.scene);
            auto& effects = tangents.vertices[wanted.shape_idx];
            effects.resize(n);
            for (std::size_t i = first; i < std::min(first + 20, n); ++i)
                for (int axis = 0; axis < 3; ++axis) {
                    Vector3<double> unit;
                    unit[axis] = 1;
                    tangents.parameters.push_back({fmt::format("{}.{}", i, axis), "m", 0});
                    const auto p = std::uint32_t(tangents.n() - 1);
                    for (std::size_t k = 0; k < n; ++k)
                        if (wanted.same[k] == wanted.same[i]) effects[k].push_back({p, unit});
                }
            const Forward forward = contract_forward(c, tangents, adjoint);
            for (std::size_t p = 0; p < tangents.n(); ++p) {
                largest = std::max(largest, std::abs(forward.gradient[p]));
                EXPECT_NEAR(backward.vertices.gradient[3 * first + p], forward.gradient[p], 1e-10 * forward.size[p])
                    << tangents.parameters[p].name;
            }
        }
        EXPECT_GT(largest, 0);
    }
}

// A texel's weight in the loss is linear in the texel where light meets the texture once: the sum over texels of value
// times gradient is the loss itself.
TEST(Reverse, TexelsAddUpToTheLoss) {
    const auto mesh = patch(6, true), image = noise_image(8);
    const Case c =
        make_case(pinhole, patch_scene(mesh, textured_skin(image)), {"bsdf:skin/reflectance/texels"}, 100, 2);
    // Only pixels on the patch.
    TransientCube cube = weights({"gaussian", 0.3}, 2.5, 10);
    std::vector<float> values(cube.radiance.begin(), cube.radiance.end());
    for (std::size_t pixel = 0; pixel < c.graph.n_pixels(); ++pixel) {
        bool on_patch = true;
        for (std::size_t s = 0; s < 100; ++s) {
            const auto [begin, end] = vertices_of(c.graph, s * c.graph.n_pixels() + pixel);
            on_patch &= begin < end && c.scene->shapes[c.graph.vertices.shape[begin]].id == "patch";
        }
        if (!on_patch) std::fill_n(values.begin() + std::ptrdiff_t(pixel * 3 * n_bins), 3 * n_bins, 0.0f);
    }
    cube.radiance = std::move(values);
    const Adjoint adjoint(std::move(cube), c.graph, "weights");
    const Gradient g = sweep(c, adjoint);
    ASSERT_EQ(g.texels.gradient.size(), 3u * 8 * 8);
    const Texture& texture =
        c.scene->textures[std::size_t(c.scene->materials[c.wanted.images[0].material_idx].diffuse_idx)];
    double sum = 0;
    for (int y = 0; y < 8; ++y)
        for (int x = 0; x < 8; ++x)
            for (int k = 0; k < 3; ++k)
                sum += double(texture.image->texel(x, y)[k]) * g.texels.gradient[std::size_t(3 * (8 * y + x) + k)];
    EXPECT_NE(g.loss, 0);
    EXPECT_NEAR(sum, g.loss, 2e-3 * std::abs(g.loss));  // colours are rounded to half in the graph
    for (const auto& file : {mesh, image}) std::filesystem::remove(file);
}

/// A square between lamp and floor, seen from above.
constexpr const char* shadow = R"(
<bsdf type="diffuse" id="white"><rgb name="reflectance" value="0.7,0.6,0.5"/></bsdf>
<shape type="rectangle" id="floor"><transform name="to_world"><scale value="3"/></transform><ref id="white"/></shape>
<shape type="rectangle" id="blocker"><transform name="to_world"><scale value="0.5"/><translate x="0.2" y="0.1" z="1"/></transform><ref id="white"/></shape>
<shape type="sphere" id="ball"><point name="center" x="-1" y="0.3" z="0.8"/><float name="radius" value="0.4"/><ref id="white"/></shape>
<shape type="rectangle" id="lamp"><transform name="to_world"><rotate x="1" angle="180"/><scale value="0.6"/><translate x="0.1" y="0" z="2.8"/></transform><ref id="white"/><emitter type="area"><rgb name="radiance" value="5,4,3"/></emitter></shape>
<emitter type="point" id="point"><point name="position" x="1" y="-1" z="2"/><rgb name="intensity" value="2,1,3"/></emitter>
)";
const std::vector<std::string> shadow_names{"shape:blocker/pose", "shape:blocker/scale", "shape:ball/pose",
                                            "shape:lamp/pose",    "emitter:point/pose",  "sensor/pose"};

TEST(Reverse, RefusesWeightsThatCannotBeEvaluated) {
    const Case c = make_case(pinhole, shadow, {"shape:blocker/pose"}, 1, 2);
    const auto said = [&](const std::function<void(TransientCube&)>& change) -> std::string {
        TransientCube cube = weights(responses[1], 2.5, 10);
        change(cube);
        try {
            const Adjoint adjoint(std::move(cube), c.graph, "w.h5");
        } catch (const InputError& error) {
            return error.what();
        }
        return "taken";
    };
    EXPECT_EQ(said([](TransientCube&) {}), "taken");
    EXPECT_NE(said([](TransientCube& w) { w.film.width = 5, w.film.height = 7; }).find("w.h5: is 5 x 7 pixels"),
              std::string::npos);
    const auto refused = [&](const std::function<void(TransientCube&)>& change) {
        EXPECT_TRUE(said(change).starts_with("w.h5: ")) << said(change);
    };
    refused([](TransientCube& w) { w.response.pulse = "table"; });
    refused([](TransientCube& w) { w.response.pulse.clear(); });
    refused([](TransientCube& w) { w.response.length_opl = 0; });
    refused([](TransientCube& w) { w.response.length_opl = NAN; });
    refused([](TransientCube& w) { w.response.pulse = "expgauss", w.response.tail_opl = -1; });
    refused([](TransientCube& w) { w.response.pulse = "sine", w.response.period_opl = 0; });
    refused([](TransientCube& w) { w.time.gate_opl = 0; });
    refused([](TransientCube& w) { w.time.gate_opl = INFINITY; });
    refused([](TransientCube& w) { w.time.start_opl = NAN; });
    refused([](TransientCube& w) { w.time.bin_width_opl = INFINITY; });
    refused([](TransientCube& w) {
        std::vector<float> values(w.radiance.begin(), w.radiance.end());
        values[17] = NAN;
        w.radiance = std::move(values);
    });
}

TEST(Reverse, RefusesPartsThatDoNotExist) {
    const auto said = [&](const char* name) -> std::string {
        try {
            (void)make_case(pinhole, shadow, {name}, 1, 2);
        } catch (const InputError& error) {
            return error.what();
        }
        return "taken";
    };
    EXPECT_EQ(said("shape:blocker/vertices"), "taken");
    EXPECT_EQ(said("shape:nobody/vertices"), "--wrt shape:nobody/vertices: the scene has no shape 'nobody'");
    EXPECT_EQ(said("shape:ball/vertices"), "--wrt shape:ball/vertices: a sphere or disk has no vertices");
    EXPECT_EQ(said("shape:lamp/vertices"), "--wrt shape:lamp/vertices: vertices of an emitter cannot move alone");
    EXPECT_EQ(said("bsdf:white/reflectance/texels"),
              "--wrt bsdf:white/reflectance/texels: its reflectance is no image");
    EXPECT_EQ(said("shape:/vertices"), "--wrt shape:/vertices: the scene has no shape ''");
}

// Each family, with the same samples: rows contracted as they are made, and afterwards.
TEST(Reverse, BoundaryRowsAreContractedAsTheyAreMade) {
    const Case c = make_case(pinhole, shadow, shadow_names, 64, 4);
    const Adjoint adjoint(weights(responses[2], 2.5, 10), c.graph, "weights");
    app::Report report;
    report.set_quiet(true);
    const auto sample = [&](BoundaryFamily family, const Adjoint* by) {
        const BoundaryOptions options{1, 3, 0, Direct::automatic, Attachment::surface, by};
        const BoundaryScene s(c.graph, *c.scene, *c.tangents, options);
        std::vector<BoundaryRows> rows;
        std::vector<std::uint64_t> samples(n_boundary_families);
        const std::vector<char> all(c.scene->emitters.size(), reached_by::any);
        if (family == BoundaryFamily::primary) add_primary(s, 4000, rows, samples, report);
        if (family == BoundaryFamily::vertex_light) add_vertex_light(s, 1, all, rows, samples, report);
        if (family == BoundaryFamily::edge_light) add_edge_light(s, 1000, all, rows, samples, report);
        if (family == BoundaryFamily::indirect)
            add_indirect(s, 0.5, indirect_units(s, true, true), true, true, rows, samples, report);
        if (family == BoundaryFamily::joined_light) add_joined_light(s, 1, all, rows, samples, report);
        return rows;
    };
    const std::size_t n = c.tangents->n();
    for (int family = 0; family < n_boundary_families; ++family) {
        std::vector<double> expected(n), size(n), gradient(n);
        for (const BoundaryRows& rows : sample(BoundaryFamily(family), nullptr))
            for (std::size_t i = 0; i < rows.pixel.size(); ++i) {
                const Rgb<double> a = adjoint.value_at(rows.pixel[i], rows.opl[i]);
                for (std::size_t p = 0; p < n; ++p)
                    for (int k = 0; k < 3; ++k) {
                        const double x = a[k] * double(rows.dL[3 * (i * n + p) + std::size_t(k)]);
                        expected[p] += x, size[p] += std::abs(x);
                    }
            }
        for (const BoundaryRows& rows : sample(BoundaryFamily(family), &adjoint)) {
            EXPECT_TRUE(rows.dL.empty());
            for (std::size_t p = 0; p < rows.gradient.size(); ++p) gradient[p] += rows.gradient[p];
        }
        EXPECT_GT(*std::max_element(size.begin(), size.end()), 0) << "family " << family;
        for (std::size_t p = 0; p < n; ++p)
            EXPECT_NEAR(gradient[p], expected[p], 1e-6 * size[p] + 1e-12) << "family " << family << ", " << p;
    }
}

// Boundary terms by a basis of motions against those by the parameters themselves, 24 seeds each.
TEST(Reverse, BoundaryTermsOfABasisEqualThoseOfTheParameters) {
    const Case c = make_case(pinhole, shadow, shadow_names, 100, 3);
    // Smooth weights: random ones cancel the derivative.
    TransientCube cube = weights(responses[2], 2.5, 10);
    std::vector<float> values(cube.radiance.size());
    for (std::size_t i = 0; i < values.size(); ++i)
        values[i] = float(1.5 + std::sin(0.4 * double(i / 3 % n_bins) + 0.2 * double(i / (3 * n_bins) % film_width)));
    cube.radiance = std::move(values);
    const Adjoint adjoint(std::move(cube), c.graph, "weights");
    app::Report report;
    report.set_quiet(true);
    const std::size_t n = c.tangents->n();
    const Parts parts = required_parts(*c.scene, c.graph, *c.tangents, {"interior"});
    const MotionBasis basis(*c.scene, *c.tangents, c.wanted);
    EXPECT_EQ(basis.n_columns(), 5u * 12);
    constexpr int n_seeds = 24;
    std::vector<std::vector<double>> by_parameters, by_basis;
    for (std::uint64_t seed = 0; seed < n_seeds; ++seed) {
        DeriveCounts counts;
        std::vector<std::uint64_t> samples;
        std::vector<double> gradient(n), by_vertex;
        const BoundaryOptions options{2, seed, 0, Direct::automatic, Attachment::surface, &adjoint};
        BoundaryScene boundary(c.graph, *c.scene, *c.tangents, options);
        for (const BoundaryRows& rows : sample_boundary(boundary, parts, report, samples, counts))
            for (std::size_t p = 0; p < rows.gradient.size(); ++p) gradient[p] += rows.gradient[p];
        by_parameters.push_back(gradient);
        GradientSums sums(*c.scene);
        basis.add_boundary(c.graph, *c.scene, {"interior"},
                           {2, 1000 + seed, 0, Direct::automatic, Attachment::surface, &adjoint}, report, sums,
                           by_vertex, counts);
        by_basis.push_back(sums.by_parameter(*c.tangents));
    }
    double largest = 0;
    for (std::size_t p = 0; p < n; ++p) {
        const auto moments = [&](const std::vector<std::vector<double>>& all) {
            double mean = 0, var = 0;
            for (const auto& one : all) mean += one[p] / n_seeds;
            for (const auto& one : all) var += sqr(one[p] - mean) / (n_seeds - 1);
            return std::pair(mean, var / n_seeds);
        };
        const auto [a, var_a] = moments(by_parameters);
        const auto [b, var_b] = moments(by_basis);
        const double error = std::sqrt(var_a + var_b);
        // 31 parameters, 46 degrees of freedom: other seeds would fail in one of 250 runs.
        EXPECT_NEAR(a, b, 4.2 * error + 1e-12) << c.tangents->parameters[p].name << " +- " << error;
        if (error > 0) largest = std::max(largest, std::abs(a) / error);
    }
    EXPECT_GT(largest, 30);
}

TEST(Reverse, EqualBitsForAnyNumberOfThreads) {
    const auto mesh = patch(6, true), image = noise_image(8);
    const Case c =
        make_case(pinhole, patch_scene(mesh, textured_skin(image)),
                  {"shape:lamp/pose", "shape:patch/vertices", "bsdf:skin/reflectance/texels", "sensor/pose"}, 300);
    const Adjoint adjoint(weights(responses[1], 2.5, 10), c.graph, "weights");
    const Gradient one = sweep(c, adjoint, 1), four = sweep(c, adjoint, 4);
    const auto equal = [](const Column<double>& a, const Column<double>& b) {
        return a.size() == b.size() && std::equal(a.begin(), a.end(), b.begin());
    };
    EXPECT_TRUE(equal(one.parameters.gradient, four.parameters.gradient));
    EXPECT_TRUE(equal(one.vertices.gradient, four.vertices.gradient));
    EXPECT_TRUE(equal(one.texels.gradient, four.texels.gradient));
    EXPECT_EQ(one.loss, four.loss);
    for (const auto& file : {mesh, image}) std::filesystem::remove(file);
}

}  // namespace
}  // namespace loom::derive
