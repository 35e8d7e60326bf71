#pragma once
#include <cstdint>
#include <vector>

#include "stages/denoise/layers.h"

namespace loom::denoise {

/// What the filter's result depends on. The defaults are those of the least relative error over the scenes of
/// docs/denoise.md.
struct FilterParameters {
    int window_radius = 7;   // px; pixels that a centre looks at
    int patch_radius = 2;    // px; what is compared of them
    float k = 0.5f;          // patches differ when they are k standard deviations apart
    float ridge = 0.3f;      // strength of the prior on slopes
    float albedo_scale = 2;  // of the features, against the prior
    float normal_scale = 2;
    float depth_scale = 1;
    float pixel_scale = 0.05f;  // px^-1
    float dark_albedo = 0.2f;   // below it, texture is not divided out of what patches are compared by
    float outlier_limit = 4;    // standard deviations of the neighbours
};

struct Filtered {
    std::vector<float> color[3];
    std::uint64_t n_outliers = 0;  // pixels whose value was bounded
};

/// The built-in denoiser. At each pixel q a linear model of the colour over the features is fitted to the pixels p
/// around
/// it that look alike; each pixel takes the weighted mean of what the models around it predict.      [Bitterli2016]
///   minimise over a_q, b_q   sum_p w(q,p) |c_p - a_q - b_q (f_p - f_q)|^2 + lambda_q |b_q|^2
///   out_p = sum_q w(q,p) (a_q + b_q (f_p - f_q)) / sum_q w(q,p)
///   w = (1 - t/8)^8 ~ exp(-t),  t = max(0, mean over the patches and channels of
///       ((e_p - e_q)^2 - v_q - min(v_p, v_q)) / (k^2 (v_p + v_q))),  e = c / max(albedo, dark_albedo)
///       [Rousselle2012]
///   lambda_q = ridge * mean of v / mean of c^2: the noisier, the flatter
/// c: colour; v: variance of c or e, smoothed over 3 x 3 pixels; f: albedo, normal, logarithm of the depth, column and
/// row. Texture, and edges smoothed by the pixel filter, are linear in f, so that c is not divided by the albedo; e is,
/// for texels of one surface must count as alike. Before, a pixel that exceeds its neighbours by `outlier_limit` of
/// their standard deviations, and whose own standard deviation is above a quarter of it, is scaled down to that bound;
/// after, a value is kept in the range of the 5 x 5 values around it, so that none is negative where no input is.
/// needs:   finite values; layers.var_mean not negative, or none: then it is estimated from each 5 x 5 pixels
/// out:     the same bytes for any number of threads (0: all); filter(-c) = -filter(c) to the bit
/// differs: from [Bitterli2016]: no half buffers, so features are taken as they are and there is one bandwidth k; the
///          prior on slopes and the features of position are ours
Filtered filter(const Layers& layers, const FilterParameters& parameters, int threads);

}  // namespace loom::denoise
