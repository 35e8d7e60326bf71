#pragma once
#include <cstdint>
#include <vector>

#include "stages/denoise/layers.h"

namespace loom::denoise {

/// Parameters of the filter's result. The defaults minimise the relative error over the scenes of docs/denoise.md.
struct FilterParameters {
    int window_radius = 7;   // px; window around a centre pixel
    int patch_radius = 2;    // px; patches that are compared
    float k = 0.5f;          // patches differ when they are k standard deviations apart
    float ridge = 0.3f;      // strength of the prior on slopes
    float albedo_scale = 2;  // scales of the features, relative to the prior
    float normal_scale = 2;
    float depth_scale = 1;
    float pixel_scale = 0.05f;  // px^-1
    float dark_albedo = 0.2f;   // below it, patches are compared without division by the albedo
    float outlier_limit = 4;    // in standard deviations of the neighbours
};

struct Filtered {
    std::vector<float> color[3];
    std::uint64_t n_outliers = 0;  // pixels whose value was clamped
};

/// The built-in denoiser. At each pixel q a linear model of the colour over the features is fitted to the similar
/// pixels p around it. The output of a pixel is the weighted mean of the predictions of the models around it.
/// [Bitterli2016]
///   minimise over a_q, b_q   sum_p w(q,p) |c_p - a_q - b_q (f_p - f_q)|^2 + lambda_q |b_q|^2
///   out_p = sum_q w(q,p) (a_q + b_q (f_p - f_q)) / sum_q w(q,p)
///   w = (1 - t/8)^8 ~ exp(-t),  t = max(0, mean over the patches and channels of
///       ((e_p - e_q)^2 - v_q - min(v_p, v_q)) / (k^2 (v_p + v_q))),  e = c / max(albedo, dark_albedo)
///       [Rousselle2012]
///   lambda_q = ridge * mean of v / mean of c^2: the noisier, the flatter
/// c: colour; v: variance of c or e, smoothed over 3 x 3 pixels; f: albedo, normal, logarithm of the depth, column and
/// row.
/// Texture, and edges smoothed by the pixel filter, are linear in f; c is therefore not divided by the albedo. The
/// guide e is divided, because texels of one surface must count as similar.
/// Before: a pixel's bound is its neighbours' mean plus `outlier_limit` of their standard deviations. A pixel above
/// it is scaled down to it when its own standard deviation exceeds a quarter of its value.
/// After: a value is clamped to the range of the 5 x 5 values around it, so that none is negative where no input is.
/// needs:   finite values; layers.var_mean not negative, or empty: it is then estimated from each 5 x 5 pixels
/// out:     the same bytes for any number of threads (0: all); filter(-c) = -filter(c) to the bit
/// differs: from [Bitterli2016]: no half buffers, so features are used unfiltered and there is one bandwidth k; the
///          prior on slopes and the features of position are additions
Filtered filter(const Layers& layers, const FilterParameters& parameters, int threads);

}  // namespace loom::denoise
