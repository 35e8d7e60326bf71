#include "stages/residual/control/controlled.h"

#include <algorithm>
#include <cmath>
#include <string>

#include "stages/residual/control/blur.h"
#include "stages/residual/control/seen_emission.h"

namespace loom::residual {
namespace {

constexpr const char* rgb[] = {"R", "G", "B"};

}  // namespace

double best_control_weight(double of_image, double of_old, double of_both) {
    // Weights beyond are noise: where an emitter was almost off, a new image is better.
    constexpr double most = 64;
    const double of_pairs = of_image + of_old;
    return of_pairs > 0 ? clamp(of_both / of_pairs, 0.0, most) : 1;
}

ControlSums::ControlSums(std::vector<Spectrum> weights, bool fits_, bool needs_all)
    : alpha(std::move(weights)), fits(fits_), slots_(alpha.size(), none) {
    std::uint32_t n = 0;
    for (std::size_t p = 0; p < alpha.size(); ++p)
        if (fits || needs_all || !(alpha[p] == Spectrum(1))) slots_[p] = n++;
    pairs_.resize(n);
}

void ControlSums::fit(const Sensor& sensor, std::uint64_t old_samples) {
    const std::size_t n_pixels = alpha.size();
    for (int c = 0; c < 3; ++c) {
        // alpha is a ratio of means over pixels, both / all; its error shows in the scatter of both - alpha all.
        std::vector<double> both(n_pixels), all(n_pixels), both_both(n_pixels), both_all(n_pixels), all_all(n_pixels);
        for (std::size_t p = 0; p < n_pixels; ++p) {
            if (slots_[p] == none) continue;
            const PairMoments& pair = pairs_[slots_[p]][std::size_t(c)];
            if (pair.n < 2 || !std::isfinite(pair.of_before + pair.of_both)) continue;
            const double of_mean = double(pair.n) * double(pair.n - 1);
            // Where first hits differ the pairs have less in common, which the weight says already.
            both[p] = pair.of_both / of_mean;
            const double of_image = double(pair.n) / double(std::max<std::uint64_t>(old_samples, 1));
            all[p] = double(alpha[p][c]) * (1 + of_image) * pair.of_before / of_mean;
            both_both[p] = sqr(both[p]), both_all[p] = both[p] * all[p], all_all[p] = sqr(all[p]);
        }
        for (std::vector<double>* values : {&both, &all, &both_both, &both_all, &all_all})
            *values = blurred(sensor, *values, true);
        for (std::size_t p = 0; p < n_pixels; ++p) {
            if (!(all[p] > 0)) continue;
            const double best = best_control_weight(0, all[p], both[p]);
            const double scatter = both_both[p] - 2 * best * both_all[p] + sqr(best) * all_all[p],
                         error2 = scatter / (blur_pixels * sqr(all[p]));
            // As much of the way from 1 as is no noise.
            const double off = best - 1, known = off != 0 ? std::max(1 - error2 / sqr(off), 0.0) : 0;
            alpha[p][c] *= float(1 + known * off);
        }
    }
}

ControlledPicture controlled_picture(const Image& old_picture, const Image& residual, const ControlSums& control,
                                     const SeenEmission* seen) {
    ControlledPicture out{residual, 1, 0, INFINITY, 0};
    double before = 0, after = 0;
    for (int c = 0; c < 3; ++c) {
        const std::string var_mean = std::string("VarMean.") + rgb[c];
        const auto L_old = old_picture.find(rgb[c]), V = old_picture.find(var_mean);
        const auto L = out.image.add(rgb[c]), var = out.image.add(var_mean),
                   weight = out.image.add(std::string(weight_layer) + "." + rgb[c]);
        for (std::size_t p = 0; p < L.size(); ++p) {
            const double alpha = control.alpha[p][c];
            const auto* const pairs = control.pairs(p);
            const PairMoments* const pair =
                pairs && (*pairs)[std::size_t(c)].n > 0 ? &(*pairs)[std::size_t(c)] : nullptr;
            double mean = pair ? pair->mean(alpha) : double(L[p]),
                   of_pairs = pair ? pair->var_mean(alpha) : double(var[p]);
            if (pair && seen && seen->has(p)) {
                const PairMoments& emission = seen->of(p)[std::size_t(c)];
                mean += emission.mean(alpha), of_pairs += emission.var_mean(alpha);
            }
            L[p] = float(alpha * L_old[p] + mean);
            weight[p] = float(alpha);
            var[p] = float(sqr(alpha) * V[p] + of_pairs);
            before += V[p];
            after += sqr(alpha) * V[p];
            out.var_mean += of_pairs / (3 * double(L.size()));
            out.least = std::min(out.least, alpha);
            out.most = std::max(out.most, alpha);
        }
    }
    if (before > 0) out.old_variance = after / before;
    return out;
}

}  // namespace loom::residual
