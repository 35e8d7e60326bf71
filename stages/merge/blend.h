#pragma once
// Blend of biased and unbiased estimates, never worse than path tracing. Light shared by clusters is nearly free of
// noise but may be blurred; light of the path alone is noisy but unbiased. The blend weighs them for the least expected
// error.

#include <cstdint>
#include <functional>

#include "formats/image.h"

namespace loom::merge {

/// Smallest number of parts from which noise can be estimated in two halves.
inline constexpr std::size_t min_blend_parts = 4;

/// Whether an image has the layers that a blend needs.
bool has_estimates(const Image& image);

/// Returns the mean of the parts, in which direct and indirect light are each blended pixel by pixel from two estimates
/// A, B:
///   x = B + t (A - B),   t = (b^2 - cov(B, A - B)) / (b^2 + var(A - B))   within [0, 1]
/// with b^2 = mean(A - B)^2 - var(A - B) the squared bias of B less a multiple of its standard error. All are of
/// luminance, over a window around the pixel. Noise of indirect light counts as at least that of a far wider window,
/// which contains rarer paths.
/// First own samples (A) are blended with the cluster (B). For indirect light, whole paths (A), the only unbiased
/// estimate, are then blended with that result (B), with a wider window. Weights from even parts are applied to odd
/// parts and vice versa: a weight that depended on the noise of its own samples would favour dark samples.
/// in:      part   reads part i; called twice for each, so that memory does not grow with their number
///          direct  emission and direct light of independent samples, with VarMean. It replaces the parts' own samples
///          as A for direct light, since many such samples cost as much as few whole paths   PG figure 10
///          test_bias  false for differences of images: the test bounds the noise of light, which is not negative
/// needs:   at least min_blend_parts parts of one size with estimates
/// out:     R, G, B with VarMean over parts; layers that all parts have, without the estimates; Blend.Direct, Blend.Own
///          and Blend.Path, the mean weights t; Blend.Distrust, the share of the parts in which a test of bias refused
///          the blend of direct or indirect light
Image blend_images(std::size_t n_parts, const std::function<Image(std::size_t)>& part, const Image* direct = nullptr,
                   bool test_bias = true);

/// Recommended number of direct-light samples to add to the blend.
struct DirectPlan {
    std::uint64_t samples = 0;           // per pixel; 0: more samples do not reduce the cost
    double direct = 0, direct_with = 0;  // expected relMSE of direct light without and with them
    double indirect = 0;                 // expected relMSE of all other light
};

/// Finds the m that minimises error times cost, among m = 0 or n / 4, n / 2, n, ... 16 n for parts of n samples in all:
///   (E_i + E_d(m)) (n + c m),   E_d(m) = (b^2 + w) (v / m) / (b^2 + w + v / m),   E_d(0) from the blend of own samples
/// with v the variance of a direct sample, w that of the clusters' mean and b^2 its squared bias. All are of luminance
/// relative to brightness, measured between parts over windows, without the worst 0.1 % of the pixels. Where the
/// clusters' share is zero, m / n = sqrt(V_d C_i / (V_i C_d)).                                    PG figure 10
/// The samples must promise a gain of a twentieth, because their error and cost are estimates.
/// in:      part       reads part i
///          cost       c, cost of a direct-light sample over that of a sample of the parts
/// needs:   at least min_blend_parts parts of one size with estimates
DirectPlan plan_direct(std::size_t n_parts, const std::function<Image(std::size_t)>& part, double cost);

/// Returns the mean of the parts' own images; VarMean is that between parts, since samples within one are not
/// independent.
/// needs, in, out: as blend_images, of two parts or more; no weights
Image average_images(std::size_t n_parts, const std::function<Image(std::size_t)>& part);

}  // namespace loom::merge
