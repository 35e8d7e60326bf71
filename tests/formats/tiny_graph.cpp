#include "tests/formats/tiny_graph.h"

#include <gtest/gtest.h>
#include <stdlib.h>

#include <fstream>
#include <sstream>

#include "formats/io/error.h"
#include "formats/io/octahedral.h"
#include "formats/io/output_file.h"

namespace loom::testing {
namespace {

std::vector<Half> halves(const std::vector<float>& values) {
    std::vector<Half> out(values.size());
    halves_from_floats(values, out);
    return out;
}

std::vector<std::int16_t> up(std::size_t n) {
    std::vector<std::int16_t> out;
    for (std::size_t i = 0; i < n; ++i) {
        const auto uv = octahedral_from_unit(0, 0, 1);
        out.insert(out.end(), uv.begin(), uv.end());
    }
    return out;
}

void set_common(PathGraph& g) {
    g.provenance.stage = "loom-test";
    g.provenance.release = "0.0.0";
    g.provenance.commit = "none";
    g.provenance.command = "loom-test --seed 7";
    g.provenance.seed = 7;
    g.provenance.inputs = {{"tiny scene.xml", "0123456789abcdef"}};
    g.provenance.plan = "textures on; roulette on; no dielectrics";
    g.sensor.world_from_camera = {{{1, 0, 0, 0}, {0, 1, 0, 0}, {0, 0, 1, 5}, {0, 0, 0, 1}}};
    g.sensor.origin = {0, 0, 5};
    g.sensor.fov_x_deg = 39.3;
    g.sensor.near_clip = 0.01;
    g.sensor.far_clip = 1000;

    auto& m = g.materials;
    m.id = {"floor", "w\303\244nde"};  // not just ASCII
    m.kind = {0, 8};
    m.distribution = {1, 0};
    m.two_sided = {1, 0};
    m.nonlinear = {0, 1};
    m.sample_visible = {1, 1};
    m.textured = {0, textured_parameter::diffuse};
    m.int_ior = {1.0f, 1.5f};
    m.ext_ior = {1.0f, 1.0f};
    m.opacity = {1.0f, 0.5f};
    m.alpha = {0.1f, 0.1f, 0.2f, 0.3f};
    m.exponent = {30.0f, 30.0f};
    m.diffuse = std::vector<float>(6, 0.5f);
    m.specular = std::vector<float>(6, 1.0f);
    m.transmittance = std::vector<float>(6, 1.0f);
    m.eta_c = std::vector<float>(6, 0.0f);
    m.k_c = std::vector<float>(6, 1.0f);
    m.fdr_int = {0.0f, 0.6f};
    m.fdr_ext = {0.0f, 0.1f};
    g.emitters.id = {"lamp", "sky"};
    g.emitters.kind = {0, 4};
    g.emitters.pmf = {0.5f, 0.5f};
    g.shapes.id = {"mesh_0", "mesh_1", "lamp"};
}

}  // namespace

PathGraph tiny_graph() {
    PathGraph g;
    set_common(g);
    g.sensor.width = 2;
    g.sensor.height = 1;
    g.tracing.first_sample = 8;
    g.tracing.samples_per_pixel = 2;
    g.tracing.max_depth = 5;
    g.tracing.roulette = "albedo";
    g.paths.first_vertex = {0, 2, 2, 3, 6};
    g.paths.Le = {0, 0, 0, 1, 1, 2, 0, 0, 0, 3, 2, 1};
    g.paths.origin = std::vector<float>(12, 0.25f);

    const auto both = static_cast<std::uint16_t>(vertex_flag::attempted_nee | vertex_flag::attempted_bsdf);
    const auto on = static_cast<std::uint16_t>(both | vertex_flag::continued);
    auto& x = g.vertices;
    std::vector<float> p, wo;
    for (int j = 0; j < 6; ++j) {
        p.insert(p.end(), {0.1f * static_cast<float>(j), 0.2f, -0.3f});
        wo.insert(wo.end(), {0.6f, 0.0f, 0.8f});
    }
    x.p = p;
    x.wo = wo;
    x.ns = up(6);
    x.ng = up(6);
    x.n_side = up(6);
    x.tangent = up(6);
    x.material = {0, 1, 0, 1, 1, 0};
    x.flags = {on,
               flags_with_ending(both, Ending::escaped),
               flags_with_ending(both, Ending::roulette),
               on,
               on,
               flags_with_ending(vertex_flag::attempted_nee, Ending::max_depth)};
    x.shape = {0, 1, 2, 0, 1, 2};
    x.lobe = {1, 2, 1, 4, 1, 0};
    x.pdf_w = {0.3f, 2.5f, 0.1f, 0.5f, 0.2f, 0.0f};
    x.q = {1, 1, 0.5f, 1, 1, 1};
    x.eta = {1, 1, 1, 1.5f, 1, 1};
    x.diffuse = halves(std::vector<float>(18, 0.3f));
    x.specular = halves(std::vector<float>(18, 0.9f));
    x.transmittance = halves(std::vector<float>(18, 1.0f));
    x.alpha = halves(std::vector<float>(12, 0.1f));
    x.opacity = halves(std::vector<float>(6, 1.0f));

    auto& e = g.light_edges;
    e.vertex = {0, 0, 1, 5};
    e.technique = {0, 1, 1, 0};
    e.y = {0, 2, 0, 1, 0.1f, 2, 0, 1, 0, 1, 0, 0, 0, 2, 0, 1};
    e.n = up(4);
    e.Li = {17, 12, 4, 17, 12, 4, 1, 1, 2, 17, 12, 4};
    e.pdf_nee_w = {3.0f, 2.5f, 0.04f, 1.0f};
    e.pdf_bsdf_w = {0.2f, 0.3f, 2.5f, 0.0f};
    e.emitter = {0, 0, 1, 0};
    e.eta = {1, 1, 1, 1.5f};
    g.materials.external_transmittance = std::vector<float>(128, 0.9f);
    return g;
}

PathGraph tiny_graph_with_misses() {
    PathGraph g = tiny_graph();
    auto& m = g.misses;
    m.vertex = {1, 2, 4};
    m.technique = {0, 0, 1};
    m.y = {0, 2, 0, 1, 0.2f, 0.2f, -0.3f, 1, 0, 0.6f, 0.8f, 0};
    m.emitter = {0, 1, 0};
    return g;
}

PathGraph tiny_graph_with_own_lobes() {
    PathGraph g = tiny_graph();
    g.materials.textured = {textured_parameter::exponent | textured_parameter::index, textured_parameter::alpha};
    g.vertices.exponent = {30, 20, 10, 5, 2, 1e6f};
    g.vertices.eta_c = halves(std::vector<float>(18, 0.25f));
    g.vertices.k_c = halves(std::vector<float>(18, 3.5f));
    g.coats.material = {1, 1};
    g.coats.alpha = {0.1f, 0.5f};
    g.coats.fdr_int = {0.6f, 0.5f};
    g.coats.fdr_ext = {0.1f, 0.05f};
    g.coats.external_transmittance = std::vector<float>(128, 0.8f);
    return g;
}

PathGraph large_graph(std::uint32_t n) {
    PathGraph g;
    set_common(g);
    g.sensor.width = n;
    g.sensor.height = 1;
    g.tracing.samples_per_pixel = 1;
    std::vector<std::uint64_t> first(n + 1);
    std::vector<float> p(3 * std::size_t{n}), wo(3 * std::size_t{n});
    for (std::size_t i = 0; i < n; ++i) {
        first[i] = i;
        wo[3 * i + 2] = 1.0f;
        for (std::size_t c = 0; c < 3; ++c) p[3 * i + c] = static_cast<float>((i * 7 + c) % 1001) * 0.01f;
    }
    first[n] = n;
    g.paths.first_vertex = std::move(first);
    g.paths.Le = std::vector<float>(3 * std::size_t{n}, 0.5f);
    auto& x = g.vertices;
    x.p = std::move(p);
    x.wo = std::move(wo);
    x.ns = up(n);
    x.material = std::vector<std::uint16_t>(n, 1);
    x.shape = std::vector<std::uint32_t>(n, 2);
    x.flags = std::vector<std::uint16_t>(n, flags_with_ending(3, Ending::escaped));
    x.lobe = std::vector<std::uint8_t>(n, 1);
    x.pdf_w = std::vector<float>(n, 0.3f);
    x.diffuse = halves(std::vector<float>(3 * std::size_t{n}, 0.7f));
    return g;
}

ScratchFolder::ScratchFolder() {
    std::string name = (std::filesystem::temp_directory_path() / "loom-test-XXXXXX").native();
    if (::mkdtemp(name.data()) == nullptr) throw std::runtime_error("no scratch folder");
    folder_ = name;
}

ScratchFolder::~ScratchFolder() {
    std::error_code ignored;
    std::filesystem::remove_all(folder_, ignored);
}

int ScratchFolder::n_partial() const {
    int n = 0;
    for (const auto& entry : std::filesystem::directory_iterator(folder_))
        n += entry.path().extension() == ".partial" ? 1 : 0;
    return n;
}

std::string file_bytes(const std::filesystem::path& path) {
    std::ifstream stream(path, std::ios::binary);
    std::ostringstream bytes;
    bytes << stream.rdbuf();
    return bytes.str();
}

void write_bytes(const std::filesystem::path& path, std::string_view bytes) {
    std::ofstream(path, std::ios::binary) << bytes;
}

void read_damaged(const std::filesystem::path& file, const std::function<void(const std::filesystem::path&)>& read) {
    const std::filesystem::path other = file.parent_path() / "damaged.h5";
    const std::string bytes = file_bytes(file);
    for (std::size_t i = 0; i < bytes.size(); i += 97) {
        std::string damaged = bytes;
        damaged[i] = char(damaged[i] ^ 0x5a);
        for (const std::string_view text : {std::string_view(damaged), std::string_view(bytes).substr(0, i)}) {
            write_bytes(other, text);
            try {
                read(other);
            } catch (const InputError& error) {
                EXPECT_NE(std::string(error.what()).find("damaged.h5"), std::string::npos) << error.what();
            }
        }
    }
}

void write_nonfinite(const std::filesystem::path& path, const std::function<void()>& write) {
    EXPECT_THROW(write(), NonfiniteError);
    std::filesystem::rename(not_finite_name(path), path);
}

std::string input_error_of(const std::function<void()>& body) {
    try {
        body();
    } catch (const InputError& error) {
        return error.what();
    }
    return "nothing was thrown";
}

}  // namespace loom::testing
