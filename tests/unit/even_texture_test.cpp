// A constant texture must give the result of the constant, for every parameter of every BSDF and emitter that may be
// textured: at the tracer's hit and at the vertex of a path graph, evaluated alone and in a cluster. Detected
// mutations: tables of a rough plastic from the default alpha, phong darkened by its constants alone, a vertex that
// lost its exponent or index in the graph.

#include <OpenImageIO/imageio.h>
#include <fmt/format.h>

#include "stages/core/clusters/cluster_shading.h"
#include "stages/core/description/schema.h"
#include "stages/core/sampling/sampler.h"
#include "stages/core/sampling/warp.h"
#include "stages/core/scene/build.h"
#include "tests/traced_graph.h"
#include "tests/unit/scene_folder.h"

namespace loom {
namespace {

class EvenTextures : public SceneFolder {
  protected:
    /// An image of one colour; grey ones have one channel.
    void even_image(const std::string& name, const Spectrum& value) {
        const bool grey = value.r == value.g && value.g == value.b;
        const OIIO::ImageSpec spec(4, 2, grey ? 1 : 3, OIIO::TypeDesc::FLOAT);
        std::vector<float> texels;
        for (int i = 0; i < 8; ++i) texels.insert(texels.end(), &value.r, &value.r + (grey ? 1 : 3));
        auto out = OIIO::ImageOutput::create(path(name).string());
        ASSERT_TRUE(out->open(path(name).string(), spec) && out->write_image(OIIO::TypeDesc::FLOAT, texels.data()));
        out->close();
    }
    enum class Way { constant, image, raw_constant };
    std::string parameter(const Parameter& p, const Spectrum& colour, Way way) {
        const Spectrum value = p.kind == ValueKind::number ? Spectrum(colour.r) : colour;
        const std::string number =
            fmt::format("<float name='{}' value='{}'/>", way == Way::constant ? p.name : "value", value.r);
        const std::string rgb = fmt::format("<rgb name='{}' value='{}, {}, {}'/>",
                                            way == Way::constant ? p.name : "value", value.r, value.g, value.b);
        const std::string& constant = p.kind == ValueKind::number ? number : rgb;
        if (way == Way::constant) return constant;
        if (way == Way::raw_constant)
            return fmt::format("<texture type='rawconstant' name='{}'>{}</texture>", p.name, constant);
        const std::string file = fmt::format("{}-{}-{}.exr", value.r, value.g, value.b);
        even_image(file, value);
        return fmt::format(
            "<texture type='bitmap' name='{}'><string name='filename' value='{}'/><boolean name='raw' "
            "value='true'/></texture>",
            p.name, file);
    }
    std::unique_ptr<Scene> scene_of(const std::string& bsdf) {
        return load_scene(
            write("scene.xml",
                  "<scene version='3.0.0'><integrator type='path'><integer name='max_depth' value='2'/></integrator>"
                  "<sensor type='perspective'><float name='fov' value='20'/><transform name='to_world'><lookat "
                  "origin='1,2,3' "
                  "target='0,0,0' up='0,0,1'/></transform><film type='hdrfilm'><integer name='width' value='2'/>"
                  "<integer name='height' value='2'/><rfilter type='box'/></film></sensor>"
                  "<emitter type='constant'/><shape type='rectangle'><transform name='to_world'><scale "
                  "value='9'/></transform>" +
                      bsdf + "</shape></scene>"));
    }
    static void expect_near(float value, float expected, float tolerance, const char* what) {
        EXPECT_NEAR(value, expected, tolerance * std::abs(expected) + 1e-7f) << what;
    }
    /// The BSDF of the first hit: as the tracer has it, as the graph has it, and in a cluster.
    void expect_same_bsdf(const Scene& scene, const Scene& expected_scene, float tolerance) {
        const PathGraph graph = testing::trace_graph(scene, testing::path_options(scene, 1), 1);
        const PathGraph expected_graph =
            testing::trace_graph(expected_scene, testing::path_options(expected_scene, 1), 1);
        ASSERT_GT(graph.n_vertices(), 0u);
        const GraphReader reader(graph), expected_reader(expected_graph);
        const auto cluster = std::make_unique<ClusterShading>(reader);
        cluster->load(std::vector<std::uint32_t>{0});
        const ShadingPoint at = reader.vertex(0), expected = expected_reader.vertex(0);
        const Ray ray{at.p + at.wo, -at.wo};
        const Bsdf<float> traced = scene.bsdf(scene.surface(ray, scene.intersect(ray)));
        const auto compare = [&](const Spectrum& value, const Spectrum& right, const char* what) {
            for (int c = 0; c < 3; ++c) expect_near(value[c], right[c], tolerance, what);
        };
        compare(albedo(at.bsdf, at.wo_local), albedo(expected.bsdf, expected.wo_local), "albedo");
        for (const Lobe lobe : {Lobe::delta_reflection, Lobe::delta_transmission, Lobe::null}) {
            compare(delta_value(at.bsdf, at.wo_local, lobe), delta_value(expected.bsdf, expected.wo_local, lobe),
                    "delta value");
            expect_near(delta_pmf(at.bsdf, at.wo_local, lobe), delta_pmf(expected.bsdf, expected.wo_local, lobe),
                        tolerance, "delta pmf");
        }
        for (int i = 0; i < 24; ++i) {
            const Vector3f wi = sample_uniform_sphere(Sampler(SamplerKind::independent, 3, 0, i).pair(0));
            const BsdfValue<float> right = f_cos_pdf(expected, at.frame.to_world(wi)),
                                   value = f_cos_pdf(at, at.frame.to_world(wi));
            compare(value.f_cos, right.f_cos, "f_cos of the graph");
            expect_near(value.pdf_w, right.pdf_w, tolerance, "density of the graph");
            const BsdfValue<float> hit = f_cos_pdf(traced, at.wo_local, at.frame.to_local(at.frame.to_world(wi)));
            compare(hit.f_cos, value.f_cos, "f_cos of the hit");
            cluster->light_direction(at.frame.to_world(wi));
            for (int c = 0; c < 3; ++c) expect_near(cluster->f(c)[0], value.f_cos[c], 2e-6f, "f_cos in a cluster");
        }
    }
};

TEST_F(EvenTextures, GiveWhatTheConstantsGive) {
    struct Case {
        Spectrum value;
        float tolerance;
    };
    // Halves hold the first exactly. 0.75 and a default make more than 1: such a sum of lobes is darkened.
    const Case cases[] = {{Spectrum(0.5f), 2e-6f}, {Spectrum(0.75f), 1e-3f}, {{0.25f, 0.5f, 0.375f}, 1e-3f}};
    int compared = 0;
    for (const std::string& type : plugin_names(Category::bsdf, true)) {
        const PluginSchema& plugin = *find_plugin(Category::bsdf, type);
        std::vector<Parameter> textured;
        for (const Parameter& p : plugin.parameters)
            if ((p.flags & flag::textured) && !(p.flags & flag::legacy)) textured.push_back(p);
        if (textured.empty()) continue;
        const std::string inner = plugin.rule(Category::bsdf) ? "<bsdf type='diffuse'/>" : "";
        const auto bsdf = [&](const std::string& parameters) {
            return "<bsdf type='" + type + "'>" + parameters + inner + "</bsdf>";
        };
        for (const Case& c : cases)
            for (const Way way : {Way::image, Way::raw_constant}) {
                std::string all_constant, all_textured;
                for (const Parameter& p : textured) {
                    SCOPED_TRACE(fmt::format("{}: {} {}, {}", type, p.name, c.value.g,
                                             way == Way::image ? "image" : "rawconstant"));
                    const std::string constant = parameter(p, c.value, Way::constant),
                                      texture = parameter(p, c.value, way);
                    // The column of alpha has both of its values, and the other one's default, 0.1, is no half.
                    const bool one_alpha = p.name == "alpha_u" || p.name == "alpha_v";
                    expect_same_bsdf(*scene_of(bsdf(texture)), *scene_of(bsdf(constant)),
                                     one_alpha ? 4e-3f : c.tolerance);
                    all_constant += constant;
                    all_textured += texture;
                    ++compared;
                    ASSERT_FALSE(HasFailure());
                }
                SCOPED_TRACE(fmt::format("{}: all {}", type, c.value.g));
                expect_same_bsdf(*scene_of(bsdf(all_textured)), *scene_of(bsdf(all_constant)), c.tolerance);
                ASSERT_FALSE(HasFailure());
            }
    }
    EXPECT_GT(compared, 100);
}

TEST_F(EvenTextures, OfEmittersGiveWhatTheConstantsGive) {
    int compared = 0;
    for (const std::string& type : plugin_names(Category::emitter, true))
        for (const Parameter& p : find_plugin(Category::emitter, type)->parameters) {
            if (!(p.flags & flag::textured)) continue;
            SCOPED_TRACE(fmt::format("{}: {}", type, p.name));
            const auto scene = [&](Way way) {
                std::string emitter =
                    "<emitter type='" + type + "'>" + parameter(p, {0.25f, 4, 0.5f}, way) + "</emitter>";
                if (type == "area")
                    emitter = "<shape type='sphere'><point name='center' x='0' y='0' z='-3'/>" + emitter + "</shape>";
                return load_scene(write("scene.xml", text(emitter)));
            };
            const auto constant = scene(Way::constant), image = scene(Way::image), raw = scene(Way::raw_constant);
            for (int i = 0; i < 32; ++i) {
                const Point2f u = Sampler(SamplerKind::independent, 3, 0, i).pair(0);
                const Point3f from{0.2f * u.x, 0.3f * u.y - 0.2f, 2};
                const LightSample right = sample_light(*constant, from, u);
                EXPECT_FALSE(is_black(right.Li));
                for (const Scene* other : {image.get(), raw.get()}) {
                    const LightSample s = sample_light(*other, from, u);
                    EXPECT_EQ(s.pdf_w, right.pdf_w);
                    for (int c = 0; c < 3; ++c) EXPECT_NEAR(s.Li[c], right.Li[c], 1e-6f * right.Li[c]);
                }
                ++compared;
            }
        }
    EXPECT_GE(compared, 64);
}

TEST_F(EvenTextures, RawConstantsLieWhereTheConstantsMust) {
    const auto raw = [](const std::string& name, const std::string& value) {
        return "<texture type='rawconstant' name='" + name + "'><rgb name='value' value='" + value + "'/></texture>";
    };
    const auto error_with = [&](const std::string& inside) {
        const std::string error = error_of([&] { scene_of(inside); });
        return error.substr(0, error.find('\n'));
    };
    EXPECT_EQ(error_with(""), "no error");
    const std::vector<std::pair<std::string, std::string>> cases{
        {"<bsdf type='diffuse'>" + raw("reflectance", "2, 1, 1") + "</bsdf>", "'reflectance' must lie between 0 and 1"},
        {"<bsdf type='roughconductor'>" + raw("alpha", "-1, -1, -1") + "</bsdf>", "'alpha' must not be negative"},
        {"<emitter type='area'>" + raw("radiance", "1, -1, 1") + "</emitter>", "'radiance' must not be negative"}};
    for (const auto& [inside, expected] : cases)
        EXPECT_NE(error_with(inside).find(expected), std::string::npos) << error_with(inside);
}

// A texture of two values: each hit must have what the constant of its value gives, which no single table can.
TEST_F(EvenTextures, ValuesDifferFromHitToHit) {
    const auto board = [](const std::string& name, double a, double b) {
        return fmt::format(
            "<texture type='checkerboard' name='{}'><rgb name='color0' value='{}'/><rgb name='color1' "
            "value='{}'/></texture>",
            name, a, b);
    };
    for (const auto& [type, name] :
         {std::pair{"roughplastic", "alpha"}, {"phong", "exponent"}, {"roughconductor", "eta"}}) {
        const auto mixed = scene_of("<bsdf type='" + std::string(type) + "'>" + board(name, 0.125, 0.5) + "</bsdf>");
        const PathGraph graph = testing::trace_graph(*mixed, testing::path_options(*mixed, 1), 16);
        const GraphReader reader(graph);
        std::array<int, 2> found{};
        for (const double value : {0.125, 0.5}) {
            const auto even = scene_of(fmt::format("<bsdf type='{}'>{}</bsdf>", type, board(name, value, value)));
            const Vector3f wi = normalize(Vector3f{0.3f, -0.4f, 0.6f});
            for (std::uint32_t j = 0; j < graph.n_vertices(); ++j) {
                const ShadingPoint at = reader.vertex(j);
                const Ray ray{at.p + at.wo, -at.wo};
                const SurfacePoint hit = mixed->surface(ray, mixed->intersect(ray));
                const Texture& texture = mixed->textures[0];
                const float mine =
                    std::string_view(name) == "eta" ? texture.eval(hit.uv).r : texture.eval_float(hit.uv);
                if (std::abs(mine - value) > 1e-6) continue;
                ++found[value > 0.2];
                const BsdfValue<float> right = f_cos_pdf(even->bsdf(hit), at.wo_local, wi),
                                       got = f_cos_pdf(at.bsdf, at.wo_local, wi);
                for (int c = 0; c < 3; ++c) expect_near(got.f_cos[c], right.f_cos[c], 1e-3f, type);
                expect_near(got.pdf_w, right.pdf_w, 1e-3f, type);
            }
        }
        EXPECT_GT(std::min(found[0], found[1]), 5) << type;
    }
}

// Between two rows of its tables: against the quadrature at that very roughness.
TEST(RoughCoatTables, BetweenTheirRowsTheyAreCloseToTheIntegral) {
    for (const Microfacet distribution : {Microfacet::ggx, Microfacet::beckmann}) {
        BsdfModel textured;
        textured.kind = BsdfKind::rough_plastic;
        textured.distribution = distribution;
        textured.int_ior = 1.49f, textured.ext_ior = 1.000277f;
        BsdfModel constant = textured;
        prepare_coats(textured, 0.02f, 0.25f);
        for (const float alpha : {0.02f, 0.047f, 0.11f, 0.18f}) {
            constant.alpha_u = constant.alpha_v = alpha;
            prepare(constant);
            Bsdf<float> b(textured);
            b.alpha_u = b.alpha_v = alpha;
            EXPECT_NEAR(RoughPlasticFamily::diffuse_reflectance(b, &RoughCoat::fdr_int), constant.coat.fdr_int, 1e-3);
            EXPECT_NEAR(RoughPlasticFamily::diffuse_reflectance(b, &RoughCoat::fdr_ext), constant.coat.fdr_ext, 1e-3);
            for (const float cos : {0.05f, 0.1f, 0.3f, 0.6f, 1.0f})
                EXPECT_NEAR(RoughPlasticFamily::transmittance(b, cos),
                            RoughPlasticFamily::transmittance(Bsdf<float>(constant), cos), cos < 0.2f ? 5e-3 : 1e-3)
                    << alpha << " " << cos;
        }
    }
}

}  // namespace
}  // namespace loom
