// The denoisers, on images whose clean version is known.

#include "stages/denoise/denoise.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <filesystem>
#include <random>

#include "formats/io/error.h"
#include "stages/core/stats/chi_square.h"
#include "stages/core/stats/student.h"
#include "stages/denoise/filter.h"
#include "stages/denoise/filter_levels.h"
#include "stages/denoise/oidn.h"

namespace loom::denoise {
namespace {

/// An image made of functions of the pixel, with normal noise of known variance.
struct Scene {
    int width, height;
    std::array<std::vector<float>, 3> clean, noisy, var_mean, albedo, normal;
    std::vector<float> depth;

    Scene(int w, int h) : width(w), height(h) {
        const std::size_t n = std::size_t(w) * std::size_t(h);
        for (auto* layer : {&clean, &noisy, &var_mean, &albedo, &normal})
            for (auto& channel : *layer) channel.resize(n);
        std::fill(normal[2].begin(), normal[2].end(), 1.0f);
        depth.assign(n, 2.0f);
    }
    std::size_t n() const { return clean[0].size(); }
    std::size_t at(int x, int y) const { return std::size_t(y * width + x); }

    template <class Value>
    static void set(const Scene& s, std::array<std::vector<float>, 3>& layer, Value&& value) {
        for (int c = 0; c < 3; ++c)
            for (int y = 0; y < s.height; ++y)
                for (int x = 0; x < s.width; ++x) layer[c][s.at(x, y)] = value(c, x, y);
    }
    void add_noise(float sigma, unsigned seed) {
        std::mt19937 random(seed);
        std::normal_distribution<float> normal_noise;
        for (int c = 0; c < 3; ++c) {
            for (std::size_t i = 0; i < n(); ++i) noisy[c][i] = clean[c][i] + sigma * normal_noise(random);
            std::fill(var_mean[c].begin(), var_mean[c].end(), sigma * sigma);
        }
    }
    Layers layers() const {
        Layers layers;
        layers.width = std::uint32_t(width);
        layers.height = std::uint32_t(height);
        for (int c = 0; c < 3; ++c) {
            layers.color[c] = noisy[c];
            layers.var_mean[c] = var_mean[c];
            layers.albedo[c] = albedo[c];
            layers.normal[c] = normal[c];
        }
        layers.depth = depth;
        return layers;
    }
};

double mean_square_error(const std::vector<float> (&color)[3], const Scene& scene) {
    double sum = 0;
    for (int c = 0; c < 3; ++c)
        for (std::size_t i = 0; i < scene.n(); ++i) sum += std::pow(double(color[c][i]) - double(scene.clean[c][i]), 2);
    return sum / double(3 * scene.n());
}

bool same_bytes(const Filtered& a, const Filtered& b) {
    for (int c = 0; c < 3; ++c)
        if (a.color[c].size() != b.color[c].size() ||
            std::memcmp(a.color[c].data(), b.color[c].data(), a.color[c].size() * sizeof(float)) != 0)
            return false;
    return true;
}

/// Texture, an edge in the normal, a slope of depth, a shadow that no feature contains.
Scene busy_scene(int width, int height) {
    Scene s(width, height);
    std::mt19937 random(3);
    std::uniform_real_distribution<float> texture(0.2f, 0.8f);
    for (auto& channel : s.albedo)
        for (float& a : channel) a = texture(random);
    for (int y = 0; y < height; ++y) {
        for (int x = 0; x < width; ++x) {
            const bool side = x > width / 2;
            s.normal[0][s.at(x, y)] = side ? 1.0f : 0.0f;
            s.normal[2][s.at(x, y)] = side ? 0.0f : 1.0f;
            s.depth[s.at(x, y)] = 2 + 0.02f * float(y);
        }
    }
    Scene::set(s, s.clean, [&](int c, int x, int y) {
        return s.albedo[c][s.at(x, y)] * (x > width / 2 ? 2.0f : 0.7f) * (y > height / 2 ? 1.0f : 0.4f);
    });
    return s;
}

// A filter that weighs bright and dark pixels differently, or that takes its noise estimate for signal, is biased. One
// that keeps more than the noise of its ten terms in 225 pixels fits noise.
TEST(Filter, constant_stays_and_noise_goes) {
    constexpr int replicates = 16;
    const float color[3] = {1, 2, 0.5f};
    std::vector<double> means[3];
    double error = 0, noise = 0;
    for (unsigned seed = 0; seed < replicates; ++seed) {
        Scene s(48, 40);
        Scene::set(s, s.clean, [&](int c, int, int) { return color[c]; });
        s.add_noise(0.1f, seed);
        const Filtered clean = filter(s.layers(), {}, 0);
        error += mean_square_error(clean.color, s);
        noise += 0.1 * 0.1;
        for (int c = 0; c < 3; ++c) {
            double sum = 0;
            for (const float x : clean.color[c]) sum += double(x);
            means[c].push_back(sum / double(s.n()));
        }
    }
    EXPECT_GT(noise / error, 40);
    const double alpha = sidak_alpha(3);
    for (int c = 0; c < 3; ++c) {
        const Estimate mean = estimate_of(means[c]);
        EXPECT_GT(student_p_value((mean.mean - double(color[c])) / mean.se, mean.dof), alpha) << c << ": " << mean.mean;
        // A bias of 1 % would be detected in nine of ten runs.
        EXPECT_LT((student_critical(alpha, mean.dof) + 1.28) * mean.se, 0.01 * double(color[c]));
    }
}

// A blur over the window would leave about half of an edge's contrast in the columns beside it.
TEST(Filter, edges_of_albedo_and_normal_stay) {
    for (const bool of_albedo : {true, false}) {
        Scene s(48, 48);
        Scene::set(s, s.albedo, [&](int, int x, int) { return of_albedo && x >= 24 ? 0.8f : 0.2f; });
        Scene::set(s, s.normal, [&](int c, int x, int) { return c == (!of_albedo && x >= 24 ? 0 : 2) ? 1.0f : 0.0f; });
        Scene::set(s, s.clean, [&](int, int x, int) { return x >= 24 ? 0.8f : 0.2f; });
        s.add_noise(0.1f, 5);
        const Filtered clean = filter(s.layers(), {}, 0);
        for (int c = 0; c < 3; ++c) {
            double left = 0, right = 0;
            for (int y = 0; y < 48; ++y) {
                left += double(clean.color[c][s.at(23, y)]) / 48;
                right += double(clean.color[c][s.at(24, y)]) / 48;
            }
            EXPECT_NEAR(right - left, 0.6, 0.06) << (of_albedo ? "albedo" : "normal") << " " << c;
        }
    }
}

// Independent texels: any averaging of pixels without the albedo removes their contrast.
TEST(Filter, texture_survives) {
    Scene s = busy_scene(64, 48);
    s.add_noise(0.1f, 6);
    const Filtered clean = filter(s.layers(), {}, 0);
    EXPECT_LT(mean_square_error(clean.color, s), 0.1 * 0.1 / 5);
    for (int c = 0; c < 3; ++c) {
        // Slope of the result over the clean texture in the lit corner, where E = 2.
        double n = 0, x1 = 0, y1 = 0, xx = 0, xy = 0;
        for (int y = 26; y < 48; ++y) {
            for (int x = 36; x < 64; ++x) {
                const double a = double(s.clean[c][s.at(x, y)]), b = double(clean.color[c][s.at(x, y)]);
                n += 1, x1 += a, y1 += b, xx += a * a, xy += a * b;
            }
        }
        EXPECT_NEAR((n * xy - x1 * y1) / (n * xx - x1 * x1), 1, 0.05) << c;
    }
}

TEST(Filter, negative_picture_is_the_negative) {
    Scene s = busy_scene(70, 35);
    Scene::set(s, s.clean, [&](int c, int x, int y) { return (x + 2 * y) % 19 < 9 ? 0.3f * float(c) : -0.5f; });
    s.add_noise(0.4f, 7);
    const Filtered positive = filter(s.layers(), {}, 0);
    for (auto& channel : s.noisy)
        for (float& x : channel) x = -x;
    Filtered negative = filter(s.layers(), {}, 0);
    for (auto& channel : negative.color)
        for (float& x : channel) x = -x;
    EXPECT_TRUE(same_bytes(positive, negative));
    EXPECT_EQ(positive.n_outliers, negative.n_outliers);
}

// A difference is zero, without variance, where nothing differs; features may depend on each other but for rounding. (With
// rounding in place of pivots below it, one of 3,456 pixels of a frame of teapot was NaN; these mixtures were not.)
TEST(Filter, zeros_stay_zero_whatever_the_features) {
    std::mt19937 random(5);
    std::uniform_real_distribution<float> uniform(-1, 1);
    for (int k = 0; k < 400; ++k) {
        Scene s(16, 16);
        // Mixtures of few quantities.
        const int n_free = 1 + k % 5;
        std::array<std::array<float, 5>, 7> mix;
        for (auto& of_feature : mix)
            for (float& x : of_feature) x = uniform(random);
        const float blur = k % 2 ? 0 : std::pow(10.0f, -3 - float(k % 7));
        for (std::size_t i = 0; i < s.n(); ++i) {
            std::array<float, 7> f{};
            for (int free = 0; free < n_free; ++free) {
                const float value = k % 3 ? uniform(random) : std::round(2 * uniform(random));
                for (std::size_t m = 0; m < 7; ++m) f[m] += mix[m][std::size_t(free)] * value;
            }
            for (float& x : f) x += blur * uniform(random);
            for (std::size_t c = 0; c < 3; ++c) s.albedo[c][i] = 0.5f + 0.1f * f[c], s.normal[c][i] = 0.2f * f[3 + c];
            s.depth[i] = std::exp(3 + 0.1f * f[6]);
        }
        s.add_noise(0, 1);
        const Filtered clean = filter(s.layers(), {}, 1);
        for (int c = 0; c < 3; ++c)
            for (const float x : clean.color[c]) ASSERT_EQ(x, 0) << k;
    }
}

// Within what single precision leaves of a least-squares fit to a texture.
TEST(Filter, exact_picture_is_returned) {
    Scene s = busy_scene(40, 30);
    s.add_noise(0, 1);
    const Filtered clean = filter(s.layers(), {}, 0);
    for (int c = 0; c < 3; ++c)
        for (std::size_t i = 0; i < s.n(); ++i) EXPECT_NEAR(clean.color[c][i], s.clean[c][i], 2e-5f) << c << " " << i;
}

TEST(Filter, threads_do_not_matter) {
    Scene s = busy_scene(100, 70);
    s.add_noise(0.2f, 8);
    const Filtered one = filter(s.layers(), {}, 1);
    EXPECT_TRUE(same_bytes(one, filter(s.layers(), {}, 2)));
}

TEST(Filter, scale_does_not_matter) {
    Scene s = busy_scene(40, 30);
    s.add_noise(0.2f, 9);
    const Filtered plain = filter(s.layers(), {}, 0);
    for (int c = 0; c < 3; ++c) {
        for (float& x : s.noisy[c]) x = std::ldexp(x, 60);
        for (float& x : s.var_mean[c]) x = std::ldexp(x, 120);
    }
    Filtered large = filter(s.layers(), {}, 0);
    for (auto& channel : large.color)
        for (float& x : channel) x = std::ldexp(x, -60);
    EXPECT_TRUE(same_bytes(plain, large));
}

TEST(Filter, levels_give_the_same_bytes) {
    Scene s = busy_scene(filter_patch_width + 40, filter_tile_height + 30);
    s.add_noise(0.2f, 10);
    FilterTile tile{};
    const std::vector<float> inside(s.n(), 1.0f);
    for (int c = 0; c < 3; ++c) {
        tile.color[c] = tile.guide[c] = s.noisy[c].data();
        tile.variance[c] = tile.guide_variance[c] = s.var_mean[c].data();
        tile.feature[c] = s.albedo[c].data();
        tile.feature[3 + c] = s.normal[c].data();
    }
    tile.feature[6] = s.depth.data();
    tile.inside = inside.data();
    tile.stride = s.width;
    tile.window_radius = 5;
    tile.patch_radius = 2;
    tile.k_squared = 0.25f;
    tile.ridge = 0.3f;
    tile.pixel_scale = 0.05f;
    tile.x = tile.y = 8;
    tile.height = filter_tile_height;
    std::vector<float> weights(filter_weights_size(tile.window_radius));
    tile.weights = weights.data();
    const auto sums_of = [&](void (*level)(const FilterTile&)) {
        std::vector<float> sums(4 * s.n());
        for (std::size_t k = 0; k < 4; ++k) tile.sums[k] = sums.data() + k * s.n();
        level(tile);
        return sums;
    };
    const std::vector<float> v2 = sums_of(v2::filter_tile);
    EXPECT_GT(*std::max_element(v2.begin(), v2.end()), 1);
    if (__builtin_cpu_supports("x86-64-v3")) {
        EXPECT_TRUE(v2 == sums_of(v3::filter_tile));
    }
    if (__builtin_cpu_supports("x86-64-v4")) {
        EXPECT_TRUE(v2 == sums_of(v4::filter_tile));
    }
}

TEST(Filter, layers_may_be_missing) {
    Scene s = busy_scene(40, 30);
    s.add_noise(0.1f, 11);
    for (int without = 0; without < 16; ++without) {
        Layers layers = s.layers();
        for (int c = 0; c < 3; ++c) {
            if (without & 1) layers.var_mean[c] = {};
            if (without & 2) layers.albedo[c] = {};
            if (without & 4) layers.normal[c] = {};
        }
        if (without & 8) layers.depth = {};
        const Filtered clean = filter(layers, {}, 0);
        // Without albedo the texture is all that there is to see, and must not be made worse than the noise by much.
        EXPECT_LT(mean_square_error(clean.color, s), (without & 2 ? 4 : 1) * 0.1 * 0.1) << without;
    }
}

TEST(Filter, sizes_of_all_kinds) {
    for (const auto& [width, height] : {std::pair{1, 1}, {1, 40}, {130, 1}, {64, 16}, {65, 17}, {63, 33}}) {
        Scene s(width, height);
        Scene::set(s, s.clean, [](int c, int, int) { return 1.0f + float(c); });
        s.add_noise(0.1f, 12);
        const Filtered clean = filter(s.layers(), {}, 0);
        for (int c = 0; c < 3; ++c)
            for (const float x : clean.color[c]) EXPECT_NEAR(x, 1.0f + float(c), 0.45f) << width << " x " << height;
    }
}

// Pixels that are mostly black with a rare bright one, as a hard scene at few samples: least squares alone undershoots.
TEST(Filter, nothing_negative_and_outliers_are_bounded) {
    Scene s = busy_scene(64, 48);
    std::mt19937 random(13);
    std::uniform_real_distribution<float> uniform;
    for (std::size_t i = 0; i < s.n(); ++i) {
        const bool hit = uniform(random) < 0.1f;
        for (int c = 0; c < 3; ++c) {
            s.noisy[c][i] = hit ? 10 * s.clean[c][i] : 0;
            s.var_mean[c][i] = s.noisy[c][i] * s.noisy[c][i];
        }
    }
    const std::size_t firefly = s.at(20, 20);
    for (int c = 0; c < 3; ++c) {
        s.noisy[c][firefly] = 1e4f;
        s.var_mean[c][firefly] = 1e8f;
    }
    const Filtered clean = filter(s.layers(), {}, 0);
    EXPECT_GE(clean.n_outliers, 1u);
    for (int c = 0; c < 3; ++c) {
        for (const float x : clean.color[c]) {
            EXPECT_GE(x, 0);
            EXPECT_LT(x, 30);
        }
    }
}

/// Reference implementation of the filter's formulas, in double, one pixel after the other; no outliers.
std::array<std::vector<double>, 3> plain_filter(const Scene& s, const FilterParameters& P) {
    const auto inside = [&](int x, int y) { return x >= 0 && y >= 0 && x < s.width && y < s.height; };
    const auto clamped = [&](int x, int y) {
        return s.at(std::clamp(x, 0, s.width - 1), std::clamp(y, 0, s.height - 1));
    };
    const auto features = [&](int x, int y) {
        std::array<double, n_features> f;
        for (int c = 0; c < 3; ++c) {
            f[c] = double(P.albedo_scale * s.albedo[c][s.at(x, y)]);
            f[3 + c] = double(P.normal_scale * s.normal[c][s.at(x, y)]);
        }
        f[6] = double(P.depth_scale) * std::log(double(s.depth[s.at(x, y)]));
        f[7] = double(P.pixel_scale) * x;
        f[8] = double(P.pixel_scale) * y;
        return f;
    };
    const auto weight = [&](int qx, int qy, int px, int py) {
        double sum = 0;
        for (int j = -P.patch_radius; j <= P.patch_radius; ++j) {
            for (int i = -P.patch_radius; i <= P.patch_radius; ++i) {
                for (int c = 0; c < 3; ++c) {
                    const std::size_t p = clamped(px + i, py + j), q = clamped(qx + i, qy + j);
                    const double ap = double(std::max(s.albedo[c][p], P.dark_albedo));
                    const double aq = double(std::max(s.albedo[c][q], P.dark_albedo));
                    const double vp = double(s.var_mean[c][p]) / (ap * ap), vq = double(s.var_mean[c][q]) / (aq * aq);
                    const double d = double(s.noisy[c][p]) / ap - double(s.noisy[c][q]) / aq;
                    sum += (d * d - vq - std::min(vp, vq)) / (double(P.k * P.k) * (vp + vq));
                }
            }
        }
        const double t = std::max(0.0, sum / (3 * std::pow(2 * P.patch_radius + 1, 2)));
        return std::pow(std::max(0.0, 1 - t / 8), 8);
    };
    std::array<std::vector<double>, 3> out;
    for (auto& channel : out) channel.resize(s.n());
    std::vector<double> total(s.n());
    for (int qy = 0; qy < s.height; ++qy) {
        for (int qx = 0; qx < s.width; ++qx) {
            const int r = P.window_radius;
            double a[n_terms][n_terms] = {}, b[n_terms][3] = {}, noise = 0, power = 0;
            const auto fq = features(qx, qy);
            const auto for_window = [&](auto&& body) {
                for (int py = qy - r; py <= qy + r; ++py) {
                    for (int px = qx - r; px <= qx + r; ++px) {
                        if (!inside(px, py)) continue;
                        double g[n_terms] = {1};
                        const auto fp = features(px, py);
                        for (int f = 0; f < n_features; ++f) g[f + 1] = fp[f] - fq[f];
                        body(s.at(px, py), weight(qx, qy, px, py), g);
                    }
                }
            };
            for_window([&](std::size_t p, double w, const double* g) {
                for (int j = 0; j < n_terms; ++j) {
                    for (int k = 0; k < n_terms; ++k) a[j][k] += w * g[j] * g[k];
                    for (int c = 0; c < 3; ++c) b[j][c] += w * g[j] * double(s.noisy[c][p]);
                }
                for (int c = 0; c < 3; ++c) {
                    noise += w * double(s.var_mean[c][p]);
                    power += w * std::pow(double(s.noisy[c][p]), 2);
                }
            });
            for (int j = 1; j < n_terms; ++j) a[j][j] += double(P.ridge) * noise / power + 1e-6 * a[0][0];
            for (int j = 0; j < n_terms; ++j) {  // Gauss elimination; A is positive definite
                for (int i = 0; i < n_terms; ++i) {
                    if (i == j) continue;
                    const double factor = a[i][j] / a[j][j];
                    for (int k = j; k < n_terms; ++k) a[i][k] -= factor * a[j][k];
                    for (int c = 0; c < 3; ++c) b[i][c] -= factor * b[j][c];
                }
            }
            for_window([&](std::size_t p, double w, const double* g) {
                total[p] += w;
                for (int c = 0; c < 3; ++c)
                    for (int j = 0; j < n_terms; ++j) out[c][p] += w * g[j] * b[j][c] / a[j][j];
            });
        }
    }
    for (int c = 0; c < 3; ++c) {
        for (int y = 0; y < s.height; ++y) {
            for (int x = 0; x < s.width; ++x) {
                double low = INFINITY, high = -INFINITY;
                for (int j = y - 2; j <= y + 2; ++j) {
                    for (int i = x - 2; i <= x + 2; ++i) {
                        if (!inside(i, j)) continue;
                        low = std::min(low, double(s.noisy[c][s.at(i, j)]));
                        high = std::max(high, double(s.noisy[c][s.at(i, j)]));
                    }
                }
                out[c][s.at(x, y)] = std::clamp(out[c][s.at(x, y)] / total[s.at(x, y)], low, high);
            }
        }
    }
    return out;
}

TEST(Filter, plain_twin_agrees) {
    Scene s = busy_scene(30, 22);
    s.add_noise(0.25f, 14);
    FilterParameters parameters;
    parameters.outlier_limit = 0;
    const Filtered fast = filter(s.layers(), parameters, 0);
    const auto plain = plain_filter(s, parameters);
    for (int c = 0; c < 3; ++c)
        for (std::size_t i = 0; i < s.n(); ++i)
            EXPECT_NEAR(double(fast.color[c][i]), plain[c][i], 1e-3) << c << " " << i;
}

Image image_of(const Scene& s) {
    Image image;
    image.width = std::uint32_t(s.width);
    image.height = std::uint32_t(s.height);
    image.samples = 4;
    for (int c = 0; c < 3; ++c) {
        image.channels.push_back({std::string(1, "RGB"[c]), s.noisy[c]});
        image.channels.push_back({std::string("VarMean.") + "RGB"[c], s.var_mean[c]});
        image.channels.push_back({std::string("Albedo.") + "RGB"[c], s.albedo[c]});
    }
    return image;
}

TEST(Prepare, what_is_not_finite_comes_from_neighbours) {
    Scene s(8, 6);
    Scene::set(s, s.noisy, [](int c, int x, int) { return float(c + x); });
    s.noisy[0][s.at(3, 2)] = NAN;
    s.noisy[1][s.at(3, 2)] = INFINITY;
    s.noisy[2][s.at(0, 0)] = -INFINITY;
    s.albedo[1][s.at(5, 5)] = NAN;
    s.var_mean[0][s.at(1, 1)] = -1;
    const Prepared prepared = prepare(image_of(s));
    EXPECT_EQ(prepared.n_bad_pixels, 2u);
    EXPECT_EQ(prepared.n_bad_values, 1u);
    EXPECT_FLOAT_EQ(prepared.layers.color[0][s.at(3, 2)], 3);
    EXPECT_FLOAT_EQ(prepared.layers.color[1][s.at(3, 2)], 4);
    EXPECT_FLOAT_EQ(prepared.layers.color[2][0], (2 + 3 + 3) / 3.0f);
    EXPECT_EQ(prepared.layers.color[0][s.at(4, 2)], 4);
    EXPECT_EQ(prepared.layers.albedo[1][s.at(5, 5)], 0);
    EXPECT_EQ(prepared.layers.var_mean[0][s.at(1, 1)], 0);
    EXPECT_TRUE(prepared.layers.normal[0].empty());
    EXPECT_TRUE(prepared.layers.depth.empty());

    Image one_sample = image_of(s);
    one_sample.samples = 1;
    EXPECT_TRUE(prepare(one_sample).layers.var_mean[0].empty());
}

TEST(Prepare, an_island_of_one_finite_pixel_is_enough) {
    Scene s(40, 30);
    for (auto& channel : s.noisy) {
        std::fill(channel.begin(), channel.end(), NAN);
        channel[s.at(39, 29)] = 2;
    }
    const Prepared prepared = prepare(image_of(s));
    EXPECT_EQ(prepared.n_bad_pixels, s.n() - 1);
    for (const float x : prepared.layers.color[1]) EXPECT_EQ(x, 2);
    s.noisy[2][s.at(39, 29)] = NAN;
    EXPECT_THROW(prepare(image_of(s)), InputError);
}

// The old image has no weight on the left, and the difference no noise: what is denoised as a whole ends a window's radius to
// the right. Detected mutation: the share by the pixel's own weight alone, which leaves the outline of a light that moved away.
TEST(OldPart, is_left_out_around_what_it_does_not_know) {
    constexpr std::uint32_t width = 64, height = 24, border = 24;
    Image base, image;
    for (Image* one : {&base, &image}) {
        one->width = width, one->height = height;
        for (const char* channel : {"R", "G", "B", "VarMean.R", "VarMean.G", "VarMean.B"}) one->add(channel);
        for (const char* channel : {"VarMean.R", "VarMean.G", "VarMean.B"}) std::ranges::fill(one->add(channel), 0.01f);
    }
    base.samples = image.samples = 64;
    image.ledger.resize(2);
    image.ledger[1].samples = 8;
    for (const char* channel : {"Weight.R", "Weight.G", "Weight.B"}) {
        const auto weight = image.add(channel);
        for (std::size_t i = 0; i < weight.size(); ++i) weight[i] = i % width < border ? 0.0f : 1.0f;
    }
    const OldPart part = old_part_of(image, base);
    const auto share = [&](std::uint32_t x) { return part.share_of_sum[10 * width + x]; };
    const auto radius = std::uint32_t(FilterParameters{}.window_radius);
    EXPECT_EQ(share(0), 1);
    EXPECT_EQ(share(border - 1), 1);
    EXPECT_GT(share(border), 0.9f);
    EXPECT_GT(share(border + 1), share(border + 2));
    EXPECT_GT(share(border + radius - 1), 0);
    EXPECT_LT(share(border + 2 * radius), 1e-3f);
}

TEST(Oidn, a_wrong_place_is_an_error) {
    std::string missing;
    EXPECT_THROW(Oidn::load("/no/such/folder", missing), InputError);
    EXPECT_THROW(Oidn::load(LOOM_SOURCE_DIR, missing), InputError);
}

TEST(Oidn, takes_noise_and_keeps_signs) {
    const std::filesystem::path beside = std::filesystem::path(LOOM_BIN_DIR).parent_path() / "oidn";
    std::string missing;
    const auto oidn =
        Oidn::load(std::filesystem::exists(beside / "libOpenImageDenoise.so.2") ? beside.string() : "", missing);
    if (!oidn) GTEST_SKIP() << "no Open Image Denoise (`make oidn` fetches it): " << missing;
    EXPECT_EQ(oidn->version().substr(0, 2), "2.");
    Scene s(96, 64);
    Scene::set(s, s.albedo, [](int, int, int y) { return y < 32 ? 0.8f : 0.3f; });
    Scene::set(s, s.clean, [](int, int x, int y) { return (x < 48 ? 1.0f : -1.0f) * (y < 32 ? 0.8f : 0.3f); });
    s.add_noise(0.2f, 15);
    std::vector<float> one[3], two[3];
    oidn->denoise(s.layers(), 1, one);
    oidn->denoise(s.layers(), 2, two);
    EXPECT_LT(mean_square_error(one, s), 0.2 * 0.2 / 5);
    for (int c = 0; c < 3; ++c) EXPECT_TRUE(one[c] == two[c]) << c;
    Layers bare = s.layers();
    for (int c = 0; c < 3; ++c) bare.albedo[c] = {};
    oidn->denoise(bare, 0, one);
    EXPECT_LT(mean_square_error(one, s), 0.2 * 0.2 / 5);
}

}  // namespace
}  // namespace loom::denoise
