#include "stages/residual/control/controlled.h"

#include <algorithm>
#include <cmath>
#include <string>

namespace loom::residual {

ControlledPicture controlled_picture(const Image& old_picture, const Image& residual, const ControlSums& control) {
    ControlledPicture out{residual, 1, 0, INFINITY, 0};
    constexpr const char* rgb[] = {"R", "G", "B"};
    double before = 0, after = 0;
    for (int c = 0; c < 3; ++c) {
        const std::string var_mean = std::string("VarMean.") + rgb[c];
        const auto L_old = old_picture.find(rgb[c]), V = old_picture.find(var_mean);
        const auto L = out.image.add(rgb[c]);
        for (std::size_t p = 0; p < L.size(); ++p)
            L[p] = float(double(control.alpha[p][c]) * L_old[p] + control.mean[p][c]);
        const auto var = out.image.add(var_mean);
        for (std::size_t p = 0; p < var.size(); ++p) {
            const double alpha = control.alpha[p][c];
            var[p] = float(sqr(alpha) * V[p] + control.var_mean[p][c]);
            before += V[p];
            after += sqr(alpha) * V[p];
            out.var_mean += double(control.var_mean[p][c]) / (3 * double(var.size()));
            out.least = std::min(out.least, alpha);
            out.most = std::max(out.most, alpha);
        }
    }
    if (before > 0) out.old_variance = after / before;
    return out;
}

}  // namespace loom::residual
