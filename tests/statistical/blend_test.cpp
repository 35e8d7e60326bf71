// The blend of clusters and paths: honest, and never much worse than the better of the two.
#include <fmt/format.h>
#include <gtest/gtest.h>

#include <cmath>
#include <random>

#include "stages/core/stats/chi_square.h"
#include "stages/core/stats/moments.h"
#include "tests/statistical/path_graph_passes.h"

namespace loom {
namespace {

/// A part whose own samples are exponentially distributed around 1 and its clusters gamma distributed (mean 1, less
/// noise); `common` of the clusters' noise is that of the own samples. Every pixel alike, no emission; all light
/// direct, or all indirect, whole paths then being the square of an exponential number.
Image noise_part(std::uint32_t n, std::mt19937_64& random, double common, bool indirect = false) {
    Image image;
    image.width = image.height = n;
    image.samples = 1;
    std::vector<float> own(3 * image.n_pixels()), cluster(own.size()), path(own.size()), zero(own.size());
    std::exponential_distribution<double> exponential(1);
    std::gamma_distribution<double> gamma(8, 1.0 / 8);
    for (std::size_t i = 0; i < image.n_pixels(); ++i) {
        const double a = exponential(random), b = (1 - common) * gamma(random) + common * a,
                     p = 0.5 * sqr(exponential(random));
        for (int c = 0; c < 3; ++c)
            own[3 * i + c] = float(a), cluster[3 * i + c] = float(b), path[3 * i + c] = float(p);
    }
    image.set_layer("", "RGB", cluster);
    image.set_layer("VarMean", "RGB", zero);
    image.set_layer("Emitted", "RGB", zero);
    image.set_layer("DirectOwn", "RGB", indirect ? zero : own);
    image.set_layer("DirectCluster", "RGB", indirect ? zero : cluster);
    image.set_layer("IndirectPath", "RGB", indirect ? path : zero);
    image.set_layer("IndirectOwn", "RGB", indirect ? own : zero);
    image.set_layer("IndirectCluster", "RGB", indirect ? cluster : zero);
    return image;
}

// Weights that depend on the noise they weigh would favour dark samples, and exponential noise is dark more often than
// bright. Student's t over 32 blends of 40 x 40 pixels; a bias of 0.8 % is detected in nine of ten runs. Detected
// mutation: weights of each half applied to itself.
TEST(Blend, OfNoiseIsUnbiased) {
    std::mt19937_64 random(7);
    for (const std::size_t n_parts : {std::size_t(4), std::size_t(5), std::size_t(16)})
        for (const auto& [common, indirect] : {std::pair{0.0, false}, {0.3, false}, {0.0, true}}) {
            std::vector<double> means, weights;
            for (int run = 0; run < 32; ++run) {
                std::vector<Image> parts;
                for (std::size_t i = 0; i < n_parts; ++i) parts.push_back(noise_part(40, random, common, indirect));
                const Image blend = merge::blend_images(n_parts, [&](std::size_t i) { return parts[i]; });
                means.push_back(mean_of(blend));
                weights.push_back(mean_of(blend, indirect ? "Blend.Own" : "Blend.Direct"));
            }
            const Estimate e = estimate_of(means);
            const double alpha = sidak_alpha(9);
            std::printf("    %zu parts, %s, %.1f in common: %.5f +- %.2g, mean weight %.3f\n", n_parts,
                        indirect ? "indirect" : "direct", common, e.mean, e.se, estimate_of(weights).mean);
            EXPECT_GE(welch_p_value(e, {1, 0, INFINITY}), alpha);
            EXPECT_LE((student_critical(alpha, e.dof) + 1.28) * e.se, 0.008);
        }
}

// One path in 200 carries all light (squared error 50), so that most windows contain none of it and clusters look too
// bright there. Rare light must not be taken for bias. Detected mutations: noise of the window alone (37; 12 where only
// whole paths, 32 where only own samples are weighed so).
TEST(Blend, DoesNotTakeRareLightForBias) {
    std::mt19937_64 random(15);
    std::bernoulli_distribution found(1.0 / 200);
    double blend_error = 0, cluster_error = 0, mean = 0;
    const int runs = 8;
    for (int run = 0; run < runs; ++run) {
        std::vector<Image> parts;
        for (int i = 0; i < 4; ++i) {
            Image part = noise_part(96, random, 0, true);
            std::vector<float> rare(3 * part.n_pixels());
            for (const char* layer : {"IndirectPath", "IndirectOwn"}) {
                for (std::size_t p = 0; p < rare.size(); p += 3)
                    rare[p] = rare[p + 1] = rare[p + 2] = found(random) ? 200.0f : 0.0f;
                part.set_layer(layer, "RGB", rare);
            }
            parts.push_back(std::move(part));
        }
        const Image blend = merge::blend_images(4, [&](std::size_t i) { return parts[i]; });
        const Image cluster = merge::average_images(4, [&](std::size_t i) { return parts[i]; });
        for (std::size_t p = 0; p < blend.n_pixels(); ++p) {
            blend_error += sqr(blend.find("G")[p] - 1.0) / runs / double(blend.n_pixels());
            cluster_error += sqr(cluster.find("G")[p] - 1.0) / runs / double(blend.n_pixels());
        }
        mean += mean_of(blend) / runs;
    }
    std::printf("    squared error: blend %.4f, clusters %.4f; mean of the blend %.4f\n", blend_error, cluster_error,
                mean);
    EXPECT_LT(blend_error, 10 * cluster_error);
    EXPECT_NEAR(mean, 1, 0.01);
}

/// Result of a blend with clusters that are `bias` too bright, where one in `rare` pixels of a part is hit by all the
/// light, so that its noise is large: mean of the blend, share of pixels in which the test of bias refused it, and
/// number of these that used anything but the paths.
/// in: common  clusters have one exponential number per 4 x 4 pixels
struct Guarded {
    double mean = 0, refused = 0;
    std::size_t n_refused_for_nothing = 0;
};
Guarded guarded(double bias, int rare, std::mt19937_64& random, bool test_bias = true, bool common = false) {
    std::exponential_distribution<float> exponential(1);
    std::bernoulli_distribution found(1.0 / rare);
    std::vector<Image> parts;
    for (int i = 0; i < 4; ++i) {
        Image part = noise_part(96, random, 0, true);
        std::vector<float> path(3 * part.n_pixels()), shared = part.interleaved("IndirectCluster");
        for (std::size_t p = 0; p < path.size(); p += 3)
            path[p] = path[p + 1] = path[p + 2] = found(random) ? float(rare) : 0.0f;
        if (common) {
            std::vector<float> blocks(24 * 24);
            for (float& value : blocks) value = exponential(random);
            for (std::size_t i = 0; i < shared.size(); ++i) shared[i] = blocks[i / 3 / 96 / 4 * 24 + i / 3 % 96 / 4];
        }
        for (float& value : shared) value *= float(1 + bias);
        part.set_layer("IndirectPath", "RGB", path);
        part.set_layer("IndirectOwn", "RGB", shared);
        part.set_layer("IndirectCluster", "RGB", shared);
        parts.push_back(std::move(part));
    }
    const Image blend = merge::blend_images(
        4, [&](std::size_t i) { return parts[i]; }, nullptr, test_bias);
    Guarded g{mean_of(blend), mean_of(blend, "Blend.Distrust")};
    const auto distrust = blend.find("Blend.Distrust"), path = blend.find("Blend.Path");
    for (std::size_t p = 0; p < path.size(); ++p) g.n_refused_for_nothing += path[p] < distrust[p] - 1e-6f;
    return g;
}

// The remaining bias is at most what the test detects with certainty, 0.33 sqrt(v / f), plus a quarter, which the noise
// of the blend hides, for any bias of the clusters. Without bias, refusals are rare, even where clusters are noisy.
// Detected mutations: noise of the window alone; odds of exp(-20) or exp(-1) instead of exp(-7); ten standard errors of
// the blend or none; no test at all; refusals that change no weight.
TEST(Blend, LeavesNoBiasThatNoiseDoesNotExplain) {
    std::mt19937_64 random(21);
    double refused = 0;
    for (const int rare : {2, 10, 50, 200}) {
        const double found = 0.33 * std::sqrt(rare - 1);
        for (const double bias : {0.0, -0.5, found / 2, found, 2 * found, 28.0}) {
            const Guarded g = guarded(bias, rare, random);
            std::printf(
                "    one in %d, clusters off by %+.2f: blend by %+.3f (found for sure: %.2f), refused in %.4f\n", rare,
                bias, g.mean - 1, found, g.refused);
            EXPECT_LT(std::abs(g.mean - 1), 1.25 * found);
            if (bias == 0) {
                EXPECT_LT(g.refused, 0.002);
            }
            EXPECT_EQ(g.n_refused_for_nothing, 0u);
            refused += g.refused;
        }
    }
    EXPECT_GT(refused, 0.1);
    const double of_noise = guarded(0, 2, random, true, true).refused;
    std::printf("    noise common to 16 pixels: refused in %.4f\n", of_noise);
    EXPECT_LT(of_noise, 0.01);
    EXPECT_EQ(guarded(-0.5, 2, random, false).refused, 0);
}

/// Direct light alone: each pixel is the mean of n exponential numbers around 1, with their variance.
Image direct_noise(std::uint32_t size, int n, std::mt19937_64& random) {
    Image image;
    image.width = image.height = size;
    image.samples = std::uint64_t(n);
    std::vector<float> mean(3 * image.n_pixels()), var_mean(mean.size());
    std::exponential_distribution<double> exponential(1);
    for (std::size_t i = 0; i < image.n_pixels(); ++i) {
        Moments m;
        for (int k = 0; k < n; ++k) m.add(exponential(random));
        for (int c = 0; c < 3; ++c) mean[3 * i + c] = float(m.mean), var_mean[3 * i + c] = float(m.var_mean());
    }
    image.set_layer("", "RGB", mean);
    image.set_layer("VarMean", "RGB", var_mean);
    return image;
}

// Light of further samples is weighed by its own variance, which is small where the samples happened to be dark; the
// window limits that. Student's t over 32 blends of 40 x 40 pixels; a bias of 0.8 % is detected in nine of ten runs.
// Detected mutation: variances of single pixels instead of windows, p = 2e-12.
TEST(Blend, WithFurtherDirectLightIsUnbiasedAndTakesIt) {
    std::mt19937_64 random(11);
    std::vector<double> means, weights;
    for (int run = 0; run < 32; ++run) {
        std::vector<Image> parts;
        for (int i = 0; i < 8; ++i) parts.push_back(noise_part(40, random, 0));
        const Image direct = direct_noise(40, 64, random);
        const Image blend = merge::blend_images(
            8, [&](std::size_t i) { return parts[i]; }, &direct);
        means.push_back(mean_of(blend));
        weights.push_back(mean_of(blend, "Blend.Direct"));
    }
    const Estimate e = estimate_of(means);
    const double alpha = sidak_alpha(2);
    EXPECT_GE(welch_p_value(e, {1, 0, INFINITY}), alpha) << e.mean;
    EXPECT_LE((student_critical(alpha, e.dof) + 1.28) * e.se, 0.008);
    // Variances 1/64 of the further light, 1/32 of the clusters in four parts: two thirds and one.
    EXPECT_NEAR(estimate_of(weights).mean, 2.0 / 3, 0.05);

    // Clusters that are half too bright: the further samples are believed.
    std::vector<Image> biased;
    for (int i = 0; i < 8; ++i) {
        biased.push_back(noise_part(40, random, 0));
        std::vector<float> bright = biased.back().interleaved("DirectCluster");
        for (float& value : bright) value *= 1.5f;
        biased.back().set_layer("DirectCluster", "RGB", bright);
    }
    const Image direct = direct_noise(40, 64, random);
    const Image blend = merge::blend_images(
        8, [&](std::size_t i) { return biased[i]; }, &direct);
    EXPECT_GT(mean_of(blend, "Blend.Direct"), 0.85);
    EXPECT_NEAR(mean_of(blend), 1, 0.08);
}

/// Parts whose clusters are hopeless for direct light (variance 1 of an own sample), whose other light has variance 1
/// however it is estimated.
std::vector<Image> parts_of_unit_variance(std::size_t n_parts, double cluster_factor, bool indirect,
                                          std::mt19937_64& random) {
    std::exponential_distribution<double> exponential(1);
    std::vector<Image> parts;
    for (std::size_t i = 0; i < n_parts; ++i) {
        Image part = noise_part(64, random, 0);
        std::vector<float> direct = part.interleaved("DirectCluster"), other(direct.size()), all(direct.size(), 1.0f);
        for (float& value : direct) value *= float(cluster_factor);
        if (indirect)
            for (std::size_t p = 0; p < other.size(); p += 3)
                other[p] = other[p + 1] = other[p + 2] = float(exponential(random));
        part.set_layer("DirectCluster", "RGB", direct);
        for (const char* layer : {"IndirectPath", "IndirectOwn", "IndirectCluster"})
            part.set_layer(layer, "RGB", other);
        part.set_layer("", "RGB", all);
        parts.push_back(std::move(part));
    }
    return parts;
}

// Eight parts of one sample. The parts have own samples: with E_d(0) = 1/8 and E_i = 1/8, further samples pay where
// (1/8 + 1/m) (8 + c m) is below 1.9, least at m / 8 = sqrt(1 / c). Detected mutations: costs left out, own samples
// ignored, the variance of a sample for that of the mean.
TEST(DirectPlan, TakesAsManySamplesAsPay) {
    std::mt19937_64 random(13);
    const auto planned = [](const std::vector<Image>& parts, double cost) {
        return merge::plan_direct(
            parts.size(), [&](std::size_t i) { return parts[i]; }, cost);
    };
    const auto both = parts_of_unit_variance(8, 10, true, random);
    const merge::DirectPlan plan = planned(both, 1.0 / 16);
    std::printf("    direct %.4f, with %llu further samples %.4f, indirect %.4f\n", plan.direct,
                static_cast<unsigned long long>(plan.samples), plan.direct_with, plan.indirect);
    EXPECT_NEAR(plan.direct, 0.125 / 1.01, 0.01);
    EXPECT_NEAR(plan.indirect, 0.125 / 1.01, 0.01);
    EXPECT_NEAR(plan.direct_with, 1.0 / 32 / 1.01, 0.003);
    EXPECT_EQ(plan.samples, 32u);
    EXPECT_EQ(planned(both, 1.0 / 4).samples, 0u);
    EXPECT_EQ(planned(both, 1.0 / 256).samples, 128u);

    // Clusters that are as good as 64 samples: (8 + c m) / (64 + m) falls with m where c is below 1/8, and must fall
    // below 8 / 72, what clusters and own samples make without.
    const auto easy = parts_of_unit_variance(8, 1, false, random);
    EXPECT_EQ(planned(easy, 0.05).samples, 128u);
    EXPECT_EQ(planned(easy, 0.2).samples, 0u);
}

/// An emitter far above, small or large, and a board between it and the floor.
std::unique_ptr<Scene> shadow(double lamp_half) {
    const std::string grey = R"(<bsdf type="diffuse"><rgb name="reflectance" value="0.7"/></bsdf>)";
    return testing::load_inline(
        {R"(type="perspective"><float name="fov" value="40"/><transform name="to_world"><lookat origin="1.5, -1.5, 1.5" target="0, 0, 0" up="0, 0, 1"/></transform>)",
         R"(<shape type="rectangle"><transform name="to_world"><scale x="2" y="2"/></transform>)" + grey + R"(</shape>
<shape type="rectangle"><transform name="to_world"><scale x="0.4" y="0.4"/><translate x="-0.3" y="0.3" z="0.3"/></transform><bsdf type="twosided">)" +
             grey + "</bsdf></shape>" +
             fmt::format(
                 R"(<shape type="rectangle"><transform name="to_world"><scale x="{0}" y="{0}"/><rotate x="1" angle="180"/>
<translate z="4"/></transform><bsdf type="diffuse"><rgb name="reflectance" value="0"/></bsdf><emitter type="area"><rgb name="radiance" value="{1}"/></emitter></shape>)",
                 lamp_half, 10 / (lamp_half * lamp_half)),
         32, 24, 5});
}

// Sharing wins in a diffuse room; it is biased at the edge of a sharp shadow, where path tracing has hardly any noise;
// a soft shadow is between the two. The blend may lose 5 % to the paths and 25 % to the clusters (its weights are
// estimated from eight passes each, and path tracing's share of the noise is not nil).
TEST(Blend, IsHardlyWorseThanEither) {
    struct Case {
        const char* name;
        std::unique_ptr<Scene> scene;
    };
    Case cases[] = {{"room", testing::own_scene("cornell-box.xml", 32, 24)},
                    {"sharp shadow", shadow(0.01)},
                    {"soft shadow", shadow(0.5)}};
    const int runs = full_run() ? 8 : 2;
    for (const Case& c : cases) {
        const auto reference = reference_of(*c.scene, full_run() ? 16384 : 1024);
        Errors sum;
        for (int run = 0; run < runs; ++run) {
            const Errors e = errors_of(*c.scene, 900 + 40 * std::uint64_t(run), 16, {}, reference);
            sum.blend += e.blend / runs, sum.cluster += e.cluster / runs, sum.paths += e.paths / runs;
        }
        std::printf("    %s: blend %.3e, clusters %.3e, paths %.3e\n", c.name, sum.blend, sum.cluster, sum.paths);
        EXPECT_LT(sum.blend, 1.05 * sum.paths) << c.name;
        EXPECT_LT(sum.blend, 1.25 * sum.cluster) << c.name;
        if (c.name == std::string("room")) {
            EXPECT_LT(sum.cluster, sum.paths);
        }
        if (c.name == std::string("sharp shadow")) {
            EXPECT_GT(sum.cluster, sum.paths);
        }
    }
}

// A part is one sample of its image: the blend's variance is that between parts.
TEST(Blend, ClaimsTheSpreadBetweenParts) {
    std::mt19937_64 random(9);
    double claimed = 0;
    std::vector<double> values;
    for (int run = 0; run < 64; ++run) {
        std::vector<Image> parts;
        for (int i = 0; i < 8; ++i) parts.push_back(noise_part(8, random, 0.3));
        const Image blend = merge::blend_images(8, [&](std::size_t i) { return parts[i]; });
        claimed += mean_of(blend, "VarMean.G") / 64;
        EXPECT_EQ(blend.samples, 8u);
        for (const float v : blend.find("G")) values.push_back(v);
    }
    Moments m;
    for (const double v : values) m.add(v);
    EXPECT_NEAR(claimed / m.var_sample(), 1, 0.1);
}

}  // namespace
}  // namespace loom
