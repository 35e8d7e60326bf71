#pragma once
#include <cstddef>

namespace loom {

/// Features of the regression: albedo R G B, normal X Y Z, depth, column, row. The last two are not stored.
constexpr int n_stored_features = 7, n_features = n_stored_features + 2, n_terms = 1 + n_features;
/// Size in pixels of a tile of centres; columns are processed `filter_lanes` at a time.
constexpr int filter_tile_width = 64, filter_tile_height = 16, filter_lanes = 16;
constexpr int max_patch_radius = 4;
/// Columns that the patches of a tile cover, in whole lanes.
constexpr int filter_patch_width =
    (filter_tile_width + 2 * max_patch_radius + filter_lanes - 1) / filter_lanes * filter_lanes;

/// Pointers into image columns (SoA) with a border, and the state of one tile of centres. Pixel (x, y) of the image is
/// at (border + y) * stride + border + x. The border is window_radius + patch_radius wide. At the right it is wider, up
/// to whole tiles and filter_patch_width.
struct FilterTile {
    const float* color[3];
    const float* variance[3];
    const float* guide[3];  // values that patches are compared by
    const float* guide_variance[3];
    const float* feature[n_stored_features];  // scaled
    const float* inside;                      // 1 in the image, 0 in the border
    std::ptrdiff_t stride;

    int window_radius, patch_radius;
    float k_squared, ridge, pixel_scale;

    int x, y, height;  // first pixel of the tile, in columns with border, and its number of rows
    float* weights;    // scratch: filter_weights_size
    float* sums[4];    // R, G, B, weight: row 0 is row y - window_radius of the columns, same stride
};

constexpr std::size_t filter_weights_size(int window_radius) {
    return std::size_t(2 * window_radius + 1) * std::size_t(2 * window_radius + 1) * filter_tile_width *
           filter_tile_height;
}

#define LOOM_DECLARE_LEVEL(level)             \
    namespace level {                         \
    void filter_tile(const FilterTile& tile); \
    }
LOOM_DECLARE_LEVEL(v2)
LOOM_DECLARE_LEVEL(v3)
LOOM_DECLARE_LEVEL(v4)
#undef LOOM_DECLARE_LEVEL

}  // namespace loom
