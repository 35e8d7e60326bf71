#pragma once
// Never worse than path tracing: light that clusters share is nearly free of noise but may be blurred; light of the
// path alone is noisy and exact in the mean. The blend takes of each what makes the least expected error.

#include <cstdint>
#include <functional>

#include "formats/image.h"

namespace loom::merge {

/// Fewest parts that can say how noisy they are, half by half.
inline constexpr std::size_t min_blend_parts = 4;

/// Whether an image has the layers that a blend needs.
bool has_estimates(const Image& image);

/// Mean of the parts, in which direct and indirect light are each blended pixel by pixel from two estimates A, B:
///   x = B + t (A - B),   t = (b^2 - cov(B, A - B)) / (b^2 + var(A - B))   within [0, 1]
/// with b^2 = mean(A - B)^2 - var(A - B) the squared bias of B less a multiple of its standard error; all of
/// luminance, over a window around the pixel; noise of indirect light counts as at least that of a far wider one, which
/// knows of rarer paths. First own samples (A) against the cluster (B); for indirect light then whole paths (A), the
/// only estimate without any bias, against that blend (B), with a wider window. The weights of even
/// parts are applied to odd ones and the other way round: a weight that knew the noise of what it weighs would favour
/// dark samples.
/// in:      part   reads part i; called twice for each, so that memory does not grow with their number
///          direct  emission and direct light of independent samples, with VarMean: then A for direct light in place of
///                  the parts' own samples, since many such samples cost as much as few whole paths   PG figure 10
///          test_bias  false for differences of images: the test bounds the noise of light, which is not negative
/// needs:   at least min_blend_parts parts of one size with estimates
/// out:     R, G, B with VarMean over parts; layers that all parts have, without the estimates; Blend.Direct,
///          Blend.Own and Blend.Path, the mean weights t, and Blend.Distrust, the share of the parts in which a test of
///          bias refused the blend of direct or of indirect light
Image blend_images(std::size_t n_parts, const std::function<Image(std::size_t)>& part, const Image* direct = nullptr,
                   bool test_bias = true);

/// How many samples of direct light alone the parts' blend should be given.
struct DirectPlan {
    std::uint64_t samples = 0;           // per pixel; 0: they do not pay
    double direct = 0, direct_with = 0;  // expected relMSE of direct light without them and with them
    double indirect = 0;                 // of all other light
};

/// m that makes error times cost least, of m = 0 or n / 4, n / 2, n, ... 16 n for parts of n samples in all:
///   (E_i + E_d(m)) (n + c m),   E_d(m) = (b^2 + w) (v / m) / (b^2 + w + v / m),   E_d(0) as the parts' own samples
///   blend
/// with v the variance of a direct sample and w that of the clusters' mean, b^2 its squared bias, all of luminance
/// relative to brightness, measured between parts over windows, the 0.1 % worst pixels left out. Where the clusters'
/// part is nil this is m / n = sqrt(V_d C_i / (V_i C_d)).                                    PG figure 10
/// Samples must promise a twentieth: their error and their cost are estimates.
/// in:      part       reads part i
///          cost       c, of a sample of direct light over that of a sample of the parts
/// needs:   at least min_blend_parts parts of one size with estimates
DirectPlan plan_direct(std::size_t n_parts, const std::function<Image(std::size_t)>& part, double cost);

/// Mean of the parts' own pictures; VarMean is that between parts, since samples within one are not independent.
/// needs, in, out: as blend_images, of two parts or more; no weights
Image average_images(std::size_t n_parts, const std::function<Image(std::size_t)>& part);

}  // namespace loom::merge
