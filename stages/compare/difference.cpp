#include "stages/compare/difference.h"

#include <cmath>
#include <vector>

#include "stages/compare/metrics.h"

namespace loom::compare {

Image difference_image(std::span<const float> x, std::span<const float> r, std::size_t width, std::size_t height,
                       const Significance& significance) {
    Image image;
    image.width = std::uint32_t(width);
    image.height = std::uint32_t(height);
    const Regions a = regions_of(x, width, height), b = regions_of(r, width, height);
    std::vector<float> plain(x.size()), relative(x.size()), tile(x.size()), z(x.size());
    for (std::size_t i = 0; i < x.size(); ++i) {
        const std::size_t c = i % 3, pixel = i / 3, region = 1 + tile_of(pixel % width, pixel / width, width, height);
        const double ref = double(r[i]);
        plain[i] = x[i] - r[i];
        relative[i] = float((double(x[i]) - ref) / std::sqrt(ref * ref + relative_floor));
        tile[i] = float(a.mean(c, region) - b.mean(c, region));
        if (significance.tests[c].empty()) continue;
        const RegionTest& test = significance.tests[c][region];
        z[i] = test.difference == 0 ? 0.0f : float(test.difference / test.se);
    }
    image.set_layer("", "RGB", plain);
    image.set_layer("Relative", "RGB", relative);
    image.set_layer("Tile", "RGB", tile);
    if (!significance.tests[0].empty()) image.set_layer("TileZ", "RGB", z);
    return image;
}

}  // namespace loom::compare
