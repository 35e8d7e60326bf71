#include "stages/merge/two_level.h"

#include <fmt/format.h>

#include <vector>

#include "formats/io/error.h"
#include "stages/core/math/vector.h"
#include "stages/core/stats/moments.h"
#include "stages/merge/blend.h"

namespace loom::merge {

void check_two_levels(std::size_t n_corrected, std::size_t n_parts) {
    if (n_corrected >= 2 && (n_corrected == n_parts || n_corrected + 2 <= n_parts)) return;
    throw InputError(
        fmt::format("--unbiased {}: with {} parts it must be at least 2 and leave 0 or at least 2, so that each group "
                    "has a variance",
                    n_corrected, n_parts));
}

Image two_level_image(std::size_t n_parts, std::size_t n_corrected, const std::function<Image(std::size_t)>& part) {
    Image result = average_images(n_parts, part);
    const double n = double(n_parts), m = double(n_corrected), left = 1 - m / n;
    std::vector<Moments> corrected(3 * result.n_pixels()), others(corrected.size());
    for (std::size_t i = 0; i < n_parts; ++i) {
        const Image image = part(i);
        const auto own = image.interleaved("");
        if (i >= n_corrected) {
            for (std::size_t k = 0; k < own.size(); ++k) others[k].add(own[k]);
            continue;
        }
        const auto emitted = image.interleaved("Emitted"), direct = image.interleaved("DirectOwn"),
                   indirect = image.interleaved("IndirectPath");
        for (std::size_t k = 0; k < own.size(); ++k)
            corrected[k].add(double(emitted[k]) + direct[k] + indirect[k] - left * own[k]);
    }
    std::vector<float> mean(corrected.size()), var_mean(corrected.size());
    for (std::size_t k = 0; k < mean.size(); ++k) {
        mean[k] = float(corrected[k].mean + left * others[k].mean);
        var_mean[k] = float(corrected[k].var_mean() + (n_corrected < n_parts ? sqr(left) * others[k].var_mean() : 0.0));
    }
    result.set_layer("", "RGB", mean);
    result.set_layer("VarMean", "RGB", var_mean);
    return result;
}

}  // namespace loom::merge
