#include "stages/denoise/filter.h"

#include <tbb/parallel_for.h>
#include <tbb/task_arena.h>

#include <algorithm>
#include <atomic>
#include <cmath>
#include <span>
#include <stdexcept>

#include "stages/denoise/filter_levels.h"

namespace loom::denoise {
namespace {

using Column = std::vector<float>;

/// Pixels of the image; rows are processed in parallel.
class Picture {
  public:
    Picture(const Layers& layers, const FilterParameters& p, int threads)
        : width_(int(layers.width)),
          height_(int(layers.height)),
          border_(p.window_radius + p.patch_radius),
          stride_((tiles_across() - 1) * filter_tile_width + filter_patch_width + 2 * border_),
          arena_(threads > 0 ? threads : tbb::task_arena::automatic) {}

    int width() const { return width_; }
    int height() const { return height_; }
    int border() const { return border_; }
    std::ptrdiff_t stride() const { return stride_; }
    int tiles_across() const { return (width_ + filter_tile_width - 1) / filter_tile_width; }
    int bands() const { return (height_ + filter_tile_height - 1) / filter_tile_height; }
    std::size_t n_pixels() const { return std::size_t(width_) * std::size_t(height_); }
    std::size_t at(int x, int y) const { return std::size_t(y) * std::size_t(width_) + std::size_t(x); }

    template <class Body>
    void parallel(int n, Body&& body) {
        arena_.execute([&] { tbb::parallel_for(0, n, body); });
    }
    /// Makes a column from value(x, y) of every pixel.
    template <class Value>
    Column column(Value&& value) {
        Column out(n_pixels());
        parallel(height_, [&](int y) {
            for (int x = 0; x < width_; ++x) out[at(x, y)] = value(x, y);
        });
        return out;
    }
    /// Calls visit(i, is_centre) for the pixels of the square around (x, y) inside the image.
    template <class Visit>
    void square(int x, int y, int radius, Visit&& visit) const {
        for (int j = std::max(0, y - radius); j <= std::min(height_ - 1, y + radius); ++j)
            for (int i = std::max(0, x - radius); i <= std::min(width_ - 1, x + radius); ++i)
                visit(at(i, j), i == x && j == y);
    }
    /// Makes a bordered column from value(i) of every pixel; the edge is repeated in the border.
    template <class Value>
    Column bordered(Value&& value) {
        const int rows = height_ + 2 * border_;
        Column out(std::size_t(rows) * std::size_t(stride_));
        parallel(rows, [&](int row) {
            const int y = std::clamp(row - border_, 0, height_ - 1);
            for (int x = 0; x < stride_; ++x)
                out[std::size_t(row * stride_ + x)] = value(at(std::clamp(x - border_, 0, width_ - 1), y));
        });
        return out;
    }

  private:
    int width_, height_, border_;
    std::ptrdiff_t stride_;
    tbb::task_arena arena_;
};

constexpr int neighbour_radius = 2;

/// Mean and variance of one value over the pixels that are added.
struct Spread {
    float sum = 0, squares = 0;
    int n = 0;
    void add(float x) { sum += x, squares += x * x, ++n; }
    float mean() const { return n > 0 ? sum / float(n) : 0; }
    float var_sample() const { return n > 1 ? std::max(0.0f, (squares - sum * mean()) / float(n - 1)) : 0; }
};

Column variance_from_neighbours(Picture& picture, const Column& values) {
    return picture.column([&](int x, int y) {
        Spread spread;
        picture.square(x, y, neighbour_radius, [&](std::size_t i, bool) { spread.add(values[i]); });
        return spread.var_sample();
    });
}

Column smoothed(Picture& picture, const Column& values) {
    return picture.column([&](int x, int y) {
        Spread spread;
        picture.square(x, y, 1, [&](std::size_t i, bool) { spread.add(values[i]); });
        return spread.mean();
    });
}

/// Clamps pixels that are far above their neighbours and have a large variance themselves.
std::uint64_t bound_outliers(Picture& picture, float limit, Column (&color)[3], Column (&variance)[3]) {
    const Column size = picture.column([&](int x, int y) {
        const std::size_t i = picture.at(x, y);
        return std::abs(color[0][i]) + std::abs(color[1][i]) + std::abs(color[2][i]);
    });
    std::atomic<std::uint64_t> n_outliers = 0;
    picture.parallel(picture.height(), [&](int y) {
        for (int x = 0; x < picture.width(); ++x) {
            const std::size_t p = picture.at(x, y);
            const float sd = std::sqrt(variance[0][p]) + std::sqrt(variance[1][p]) + std::sqrt(variance[2][p]);
            if (!(sd > 0.25f * size[p])) continue;
            Spread others;
            picture.square(x, y, neighbour_radius, [&](std::size_t i, bool centre) {
                if (!centre) others.add(size[i]);
            });
            const float bound = others.mean() + limit * std::sqrt(others.var_sample());
            if (others.n < 2 || size[p] <= bound) continue;
            const float scale = bound / size[p];
            for (int c = 0; c < 3; ++c) {
                color[c][p] *= scale;
                variance[c][p] *= scale * scale;
            }
            n_outliers.fetch_add(1, std::memory_order_relaxed);
        }
    });
    return n_outliers;
}

/// Returns exp2(-n) that scales the mean size of the colours to about 1, so that no product overflows.
float unit_of(const Layers& layers) {
    double sum = 0;
    for (const auto& channel : layers.color)
        for (const float x : channel) sum += std::abs(double(x));
    return sum > 0 ? float(std::exp2(-std::clamp(std::ilogb(sum / double(3 * layers.n_pixels())), -120, 120))) : 1.0f;
}

/// Colours and variances by pixel, in units of the mean colour.
struct Colours {
    Column color[3], variance[3];
};

Colours colours_of(Picture& picture, const Layers& layers, float unit) {
    Colours out;
    for (int c = 0; c < 3; ++c) {
        out.color[c] = picture.column([&](int x, int y) { return unit * layers.color[c][picture.at(x, y)]; });
        out.variance[c] =
            layers.var_mean[c].empty()
                ? variance_from_neighbours(picture, out.color[c])
                : picture.column([&](int x, int y) { return unit * (unit * layers.var_mean[c][picture.at(x, y)]); });
    }
    return out;
}

/// Columns that tiles read, with a border.
struct TileColumns {
    Column color[3], variance[3], guide[3], guide_variance[3], feature[n_stored_features], inside;
};

void add_colours(Picture& picture, const Layers& layers, const Colours& colours, const FilterParameters& parameters,
                 TileColumns& out) {
    for (int c = 0; c < 3; ++c) {
        const Column& color = colours.color[c];
        const Column smooth = smoothed(picture, colours.variance[c]);
        out.color[c] = picture.bordered([&](std::size_t i) { return color[i]; });
        out.variance[c] = picture.bordered([&](std::size_t i) { return smooth[i]; });
        const auto divisor = [&](std::size_t i) {
            return layers.albedo[c].empty() ? 1.0f : std::clamp(layers.albedo[c][i], parameters.dark_albedo, 1.0f);
        };
        out.guide[c] = picture.bordered([&](std::size_t i) { return color[i] / divisor(i); });
        out.guide_variance[c] = picture.bordered([&](std::size_t i) { return smooth[i] / (divisor(i) * divisor(i)); });
    }
}

void add_features(Picture& picture, const Layers& layers, const FilterParameters& parameters, TileColumns& out) {
    const auto stored = [&](std::span<const float> layer, auto&& value) {
        return picture.bordered([&](std::size_t i) { return layer.empty() ? 0.0f : value(layer[i]); });
    };
    for (int c = 0; c < 3; ++c) {
        out.feature[c] =
            stored(layers.albedo[c], [&](float a) { return parameters.albedo_scale * std::clamp(a, 0.0f, 1.0f); });
        out.feature[3 + c] =
            stored(layers.normal[c], [&](float n) { return parameters.normal_scale * std::clamp(n, -1.0f, 1.0f); });
    }
    // Pixels without a hit are behind all others.
    const float far = layers.depth.empty() ? 0 : *std::max_element(layers.depth.begin(), layers.depth.end());
    out.feature[6] = stored(layers.depth, [&](float z) {
        return parameters.depth_scale * (z > 0 ? std::log(z) : far > 0 ? std::log(far) + 1 : 0.0f);
    });
}

Column inside_of(const Picture& picture, std::size_t size) {
    Column inside(size);
    for (int y = 0; y < picture.height(); ++y)
        std::fill_n(inside.begin() + (y + picture.border()) * picture.stride() + picture.border(), picture.width(),
                    1.0f);
    return inside;
}

/// Returns a tile without its position and outputs.
FilterTile tile_of(const TileColumns& columns, const Picture& picture, const FilterParameters& parameters) {
    FilterTile tile{};
    for (int c = 0; c < 3; ++c) {
        tile.color[c] = columns.color[c].data();
        tile.variance[c] = columns.variance[c].data();
        tile.guide[c] = columns.guide[c].data();
        tile.guide_variance[c] = columns.guide_variance[c].data();
    }
    for (int f = 0; f < n_stored_features; ++f) tile.feature[f] = columns.feature[f].data();
    tile.inside = columns.inside.data();
    tile.stride = picture.stride();
    tile.window_radius = parameters.window_radius;
    tile.patch_radius = parameters.patch_radius;
    tile.k_squared = parameters.k * parameters.k;
    tile.ridge = parameters.ridge;
    tile.pixel_scale = parameters.pixel_scale;
    return tile;
}

/// Sums of a band of tiles: R, G, B, weight, one after the other.
struct BandSums {
    BandSums(const Picture& picture, int radius_)
        : radius(radius_),
          n_rows(filter_tile_height + 2 * radius_),
          size(std::size_t(n_rows) * std::size_t(picture.stride())),
          bands(std::size_t(picture.bands())) {}

    int radius, n_rows;
    std::size_t size;  // of each of the four
    std::vector<Column> bands;
};

/// Filters bands of centres. A band writes to the rows of its windows; bands overlap there and are added in order.
void filter_bands(Picture& picture, const FilterTile& whole, BandSums& sums) {
    static const auto filter_tile = __builtin_cpu_supports("x86-64-v4")   ? v4::filter_tile
                                    : __builtin_cpu_supports("x86-64-v3") ? v3::filter_tile
                                                                          : v2::filter_tile;
    picture.parallel(picture.bands(), [&](int band) {
        thread_local Column weights;
        weights.resize(filter_weights_size(sums.radius));
        Column& own = sums.bands[std::size_t(band)];
        own.resize(4 * sums.size);
        FilterTile tile = whole;
        tile.y = picture.border() + band * filter_tile_height;
        tile.height = std::min(filter_tile_height, picture.height() - band * filter_tile_height);
        tile.weights = weights.data();
        for (std::size_t k = 0; k < 4; ++k) tile.sums[k] = own.data() + k * sums.size;
        for (int t = 0; t < picture.tiles_across(); ++t) {
            tile.x = picture.border() + t * filter_tile_width;
            filter_tile(tile);
        }
    });
}

/// Adds the bands, and bounds each pixel by the colours around it.
void finish(Picture& picture, const BandSums& sums, const Colours& colours, float unit, Filtered& out) {
    for (auto& channel : out.color) channel.resize(picture.n_pixels());
    picture.parallel(picture.height(), [&](int y) {
        const int overlap = (2 * sums.radius + filter_tile_height - 1) / filter_tile_height;
        const int band_of_row = y / filter_tile_height;
        for (int x = 0; x < picture.width(); ++x) {
            float total[4] = {};
            for (int band = std::max(0, band_of_row - overlap);
                 band <= std::min(picture.bands() - 1, band_of_row + overlap); ++band) {
                const int row = y - band * filter_tile_height + sums.radius;
                if (row < 0 || row >= sums.n_rows) continue;
                const float* at = sums.bands[std::size_t(band)].data() + row * picture.stride() + picture.border() + x;
                for (std::size_t k = 0; k < 4; ++k) total[k] += at[k * sums.size];
            }
            for (int c = 0; c < 3; ++c) {
                float low = INFINITY, high = -INFINITY;
                picture.square(x, y, neighbour_radius, [&](std::size_t i, bool) {
                    low = std::min(low, colours.color[c][i]);
                    high = std::max(high, colours.color[c][i]);
                });
                // A pixel is its own centre with weight 1, so the total is not zero.
                out.color[c][picture.at(x, y)] = std::clamp(total[c] / total[3], low, high) / unit;
            }
        }
    });
}

}  // namespace

Filtered filter(const Layers& layers, const FilterParameters& parameters, int threads) {
    const int radius = parameters.window_radius;
    if (radius < 0 || parameters.patch_radius < 0 || parameters.patch_radius > max_patch_radius)
        throw std::logic_error("filter: radius out of range");
    Filtered out;
    if (layers.n_pixels() == 0) return out;
    Picture picture(layers, parameters, threads);

    // Scale the colours and bound outliers.
    const float unit = unit_of(layers);
    Colours colours = colours_of(picture, layers, unit);
    if (parameters.outlier_limit > 0)
        out.n_outliers = bound_outliers(picture, parameters.outlier_limit, colours.color, colours.variance);

    // Add borders, so that no tile tests for the edge.
    TileColumns columns;
    add_colours(picture, layers, colours, parameters, columns);
    add_features(picture, layers, parameters, columns);
    columns.inside = inside_of(picture, columns.color[0].size());

    // Filter tile by tile.
    BandSums sums(picture, radius);
    filter_bands(picture, tile_of(columns, picture, parameters), sums);
    finish(picture, sums, colours, unit, out);
    return out;
}

}  // namespace loom::denoise
