#pragma once
// Never worse than path tracing: light that clusters share is nearly free of noise but may be blurred; light of the
// path alone is noisy and exact in the mean. The blend takes of each what makes the least expected error.

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
/// luminance, over a window around the pixel. First own samples (A) against the cluster (B); for indirect light then
/// whole paths (A), the only estimate without any bias, against that blend (B), with a wider window and a stricter
/// test. The weights of even parts are applied to odd ones and the other way round: a weight that knew the noise of
/// what it weighs would favour dark samples.
/// in:      part   reads part i; called twice for each, so that memory does not grow with their number
///          direct  emission and direct light of independent samples, with VarMean: then A for direct light in place of
///                  the parts' own samples, since many such samples cost as much as few whole paths   PG figure 10
/// needs:   at least min_blend_parts parts of one size with estimates
/// out:     R, G, B with VarMean over parts; layers that all parts have, without the estimates; Blend.Direct,
///          Blend.Own and Blend.Path, the mean weights t
Image blend_images(std::size_t n_parts, const std::function<Image(std::size_t)>& part, const Image* direct = nullptr);

/// Mean of the parts' own pictures; VarMean is that between parts, since samples within one are not independent.
/// needs, in, out: as blend_images, of two parts or more; no weights
Image average_images(std::size_t n_parts, const std::function<Image(std::size_t)>& part);

}  // namespace loom::merge
