// Hot loops of the hash grid and the MLP, compiled once per x86-64 level (LOOM_LEVEL is v2, v3 or v4). They call no
// library function: one that is not inlined would link into the program at the wrong level.
#include <cmath>

#include "stages/core/neural/network_levels.h"

namespace loom::neural::LOOM_LEVEL {
namespace {

#if defined __AVX512F__
constexpr int width = 16;
#elif defined __AVX__
constexpr int width = 8;
#else
constexpr int width = 4;
#endif

/// One register of this level. Blocks of registers differ by level; the order of the operations on an element does not.
typedef float Vector __attribute__((vector_size(4 * width)));
typedef float VectorAt __attribute__((vector_size(4 * width), aligned(4), may_alias));
/// Lanes of a sum over the width of a layer; the same number at every level.
typedef float Lanes __attribute__((vector_size(4 * lane_block)));
typedef float LanesAt __attribute__((vector_size(4 * lane_block), aligned(4), may_alias));
typedef float Pair __attribute__((vector_size(8)));
typedef float PairAt __attribute__((vector_size(8), aligned(4), may_alias));

inline Vector at(const float* p) {
    return *reinterpret_cast<const VectorAt*>(p);
}
inline void set(float* p, Vector v) {
    *reinterpret_cast<VectorAt*>(p) = v;
}
// A macro, because a function that returns more than a register of its level has another ABI at each level.
#define LOOM_LANES_AT(pointer) (*reinterpret_cast<const LanesAt*>(pointer))

/// Computes acc[i][j] += sum_k a[i row + k step] b[k stride + j], k in order, for `rows` rows and two registers of
/// columns.
template <int rows, int registers>
[[gnu::always_inline]] inline void multiply(const float* a, std::ptrdiff_t row, std::ptrdiff_t step, const float* b,
                                            std::ptrdiff_t stride, int n, Vector (&acc)[rows][registers]) {
    for (int k = 0; k < n; ++k) {
        Vector column[registers];
#pragma GCC unroll 2
        for (int v = 0; v < registers; ++v) column[v] = at(b + k * stride + v * width);
#pragma GCC unroll 8
        for (int i = 0; i < rows; ++i) {
            const float factor = a[i * row + k * step];
#pragma GCC unroll 2
            for (int v = 0; v < registers; ++v) acc[i][v] += factor * column[v];
        }
    }
}

/// As many sums as fit into the registers of the level.
constexpr int block_rows = width == 16 ? 8 : 4, block_columns = 2 * width;
static_assert(n_hidden % block_columns == 0 && row_block % block_rows == 0 && tile_size % row_block == 0);

enum class After { nothing, relu, mask };

/// Computes the matrix product out = a b for n_rows rows of a and n_columns columns of b: out[i][j] = sum_k a[i][k]
/// b[k][j]. relu: negative values become 0. mask: values become 0 where mask[i][j], of the same layout as out, is 0.
template <After after>
[[gnu::always_inline]] inline void product(const float* a, std::ptrdiff_t a_stride, const float* b,
                                           std::ptrdiff_t b_stride, int n_rows, int n_inner, int n_columns, float* out,
                                           std::ptrdiff_t out_stride, const float* mask = nullptr) {
    for (int j = 0; j < n_columns; j += block_columns)
        for (int i = 0; i < n_rows; i += block_rows) {
            Vector acc[block_rows][2]{};
            multiply(a + i * a_stride, a_stride, 1, b + j, b_stride, n_inner, acc);
#pragma GCC unroll 8
            for (int r = 0; r < block_rows; ++r)
#pragma GCC unroll 2
                for (int v = 0; v < 2; ++v) {
                    const std::ptrdiff_t to = (i + r) * out_stride + j + v * width;
                    Vector value = acc[r][v];
                    if (after == After::relu) value = value > 0 ? value : Vector{};
                    if (after == After::mask) value = at(mask + to) > 0 ? value : Vector{};
                    set(out + to, value);
                }
        }
}

/// Computes sum[k][j] += sum_s a[s][k] b[s][j] over the samples s of a tile, in order; b has n_hidden columns.
template <int rows>
[[gnu::always_inline]] inline void add_outer(const float* a, std::ptrdiff_t a_stride, const float* b, int n_rows,
                                             float* sum) {
    for (int k = 0; k < n_rows; k += rows)
        for (int j = 0; j < n_hidden; j += block_columns) {
            Vector acc[rows][2];
#pragma GCC unroll 8
            for (int r = 0; r < rows; ++r)
#pragma GCC unroll 2
                for (int v = 0; v < 2; ++v) acc[r][v] = at(sum + (k + r) * n_hidden + j + v * width);
            multiply(a + k, 1, a_stride, b + j, n_hidden, tile_size, acc);
#pragma GCC unroll 8
            for (int r = 0; r < rows; ++r)
#pragma GCC unroll 2
                for (int v = 0; v < 2; ++v) set(sum + (k + r) * n_hidden + j + v * width, acc[r][v]);
        }
}

/// Entries and weights of the eight corners of the cells that hold `lane_block` positions.
struct Corners {
    alignas(64) std::uint32_t index[8][lane_block];
    alignas(64) float weight[8][lane_block];
};

template <bool hashed>
[[gnu::always_inline]] inline void corners_of(const GridLevel& level, const float* const position[3], int first,
                                              Corners& corners) {
    const std::uint32_t resolution = level.resolution, mask = level.n_entries - 1, side = resolution + 1;
    // The hash of a lattice point is x ^ 2654435761 y ^ 805459861 z.               [Mueller2022] eq. (4)
    constexpr std::uint32_t prime_y = 2654435761u, prime_z = 805459861u;
    const std::uint32_t step[3] = {1, hashed ? prime_y : side, hashed ? prime_z : side * side};
    alignas(64) std::uint32_t low[3][lane_block], high[3][lane_block];
    alignas(64) float part[3][lane_block];
    for (int axis = 0; axis < 3; ++axis) {
        const float* p = position[axis] + first;
        for (int l = 0; l < lane_block; ++l) {
            const float u = p[l] > 0 ? p[l] : 0.0f, x = (u < 1 ? u : 1.0f) * float(std::int32_t(resolution));
            const std::int32_t floor = std::int32_t(x), last = std::int32_t(resolution) - 1;
            const std::int32_t cell = floor < last ? floor : last;
            part[axis][l] = x - float(cell);
            low[axis][l] = std::uint32_t(cell) * step[axis];
            high[axis][l] = low[axis][l] + step[axis];
        }
    }
    for (int corner = 0; corner < 8; ++corner) {
        const std::uint32_t* ix = corner & 1 ? high[0] : low[0];
        const std::uint32_t* iy = corner & 2 ? high[1] : low[1];
        const std::uint32_t* iz = corner & 4 ? high[2] : low[2];
        for (int l = 0; l < lane_block; ++l) {
            const float wx = corner & 1 ? part[0][l] : 1 - part[0][l];
            const float wy = corner & 2 ? part[1][l] : 1 - part[1][l];
            const float wz = corner & 4 ? part[2][l] : 1 - part[2][l];
            corners.weight[corner][l] = wx * wy * wz;
            corners.index[corner][l] = hashed ? (ix[l] ^ iy[l] ^ iz[l]) & mask : ix[l] + iy[l] + iz[l];
        }
    }
}

/// Calls body(first, corners) for each block of lanes.
template <class Body>
[[gnu::always_inline]] inline void for_blocks(const GridLevel& level, const float* const position[3], int n,
                                              Body body) {
    Corners corners;
    for (int first = 0; first < n; first += lane_block) {
        if (level.hashed)
            corners_of<true>(level, position, first, corners);
        else
            corners_of<false>(level, position, first, corners);
        body(first, corners);
    }
}

[[gnu::always_inline]] inline void update_block(const AdamStep& s, int n, float* __restrict gradient,
                                                float* __restrict moment1, float* __restrict moment2,
                                                float* __restrict value) {
    const float rest1 = 1 - s.beta1, rest2 = 1 - s.beta2;
    for (int i = 0; i < n; ++i) {
        const float g = gradient[i], m = s.beta1 * moment1[i] + rest1 * g, v = s.beta2 * moment2[i] + rest2 * (g * g);
        const float change = s.rate * (m * s.correction1) / (std::sqrt(v * s.correction2) + s.epsilon);
        const bool touched = g != 0;
        moment1[i] = touched ? m : moment1[i];
        moment2[i] = touched ? v : moment2[i];
        value[i] = touched ? value[i] - change : value[i];
        gradient[i] = 0;
    }
}

}  // namespace

void encode_level(const GridLevel& level, const float* features, const float* const position[3], int n, float* out,
                  int stride) {
    for_blocks(
        level, position, n, [=](int first, const Corners& corners) __attribute__((always_inline)) {
            for (int l = 0; l < lane_block; ++l) {
                Pair sum{};
#pragma GCC unroll 8
                for (int corner = 0; corner < 8; ++corner)
                    sum += corners.weight[corner][l] *
                           *reinterpret_cast<const PairAt*>(features + 2 * std::size_t(corners.index[corner][l]));
                *reinterpret_cast<PairAt*>(out + std::ptrdiff_t(first + l) * stride) = sum;
            }
        });
}

void scatter_level(const GridLevel& level, const float* const position[3], int n, const float* d, float* gradient) {
    for_blocks(
        level, position, n, [=](int first, const Corners& corners) __attribute__((always_inline)) {
            for (int l = 0; l < lane_block; ++l) {
                const Pair by_value = *reinterpret_cast<const PairAt*>(d + 2 * (first + l));
#pragma GCC unroll 8
                for (int corner = 0; corner < 8; ++corner)
                    *reinterpret_cast<PairAt*>(gradient + 2 * std::size_t(corners.index[corner][l])) +=
                        corners.weight[corner][l] * by_value;
            }
        });
}

void mlp_forward(const MlpWeights& w, Tile& t, int n) {
    const int rows = (n + row_block - 1) / row_block * row_block;
    product<After::relu>(t.x[0], max_inputs, w.first, n_hidden, rows, w.n_inputs, n_hidden, t.h1[0], n_hidden);
    product<After::relu>(t.h1[0], n_hidden, w.second, n_hidden, rows, n_hidden, n_hidden, t.h2[0], n_hidden);
    for (int i = 0; i < rows; ++i) {
        float y[4] = {};
        for (int o = 0; o < n_outputs; ++o) {
            Lanes sum{};
#pragma GCC unroll 4
            for (int k = 0; k < n_hidden; k += lane_block)
                sum += LOOM_LANES_AT(t.h2[i] + k) * LOOM_LANES_AT(w.third + o * n_hidden + k);
            float partial[lane_block];
            *reinterpret_cast<LanesAt*>(partial) = sum;
#pragma GCC unroll 4
            for (int half = lane_block / 2; half > 0; half /= 2)
#pragma GCC unroll 8
                for (int l = 0; l < half; ++l) partial[l] += partial[l + half];
            y[o] = partial[0];
        }
        for (int o = 0; o < 4; ++o) t.y[i][o] = y[o];
    }
}

void mlp_backward(const MlpWeights& w, Tile& t, float* gradient) {
    float* const to_first = gradient;
    float* const to_second = to_first + w.n_inputs * n_hidden;
    float* const to_third = to_second + n_hidden * n_hidden;
    add_outer<n_outputs>(t.dy[0], 4, t.h2[0], n_outputs, to_third);
    product<After::mask>(t.dy[0], 4, w.third, n_hidden, tile_size, n_outputs, n_hidden, t.dh2[0], n_hidden, t.h2[0]);
    add_outer<block_rows>(t.h1[0], n_hidden, t.dh2[0], n_hidden, to_second);
    product<After::mask>(t.dh2[0], n_hidden, w.second_out, n_hidden, tile_size, n_hidden, n_hidden, t.dh1[0], n_hidden,
                         t.h1[0]);
    add_outer<block_rows>(t.x[0], max_inputs, t.dh1[0], w.n_inputs, to_first);
    // One register of columns: with 16 columns there may be no second one.
    constexpr int rows = 8;
    for (int j = 0; j < w.n_grid_columns; j += width)
        for (int i = 0; i < tile_size; i += rows) {
            Vector acc[rows][1]{};
            multiply(t.dh1[i], n_hidden, 1, w.first_grid + j, w.n_grid_columns, n_hidden, acc);
#pragma GCC unroll 8
            for (int r = 0; r < rows; ++r) set(t.dx[i + r] + j, acc[r][0]);
        }
}

void relative_loss(Tile& t, const float (*label)[n_outputs], float epsilon, float limit, float* loss) {
    for (int i = 0; i < tile_size; ++i) {
        float sum = 0;
        for (int c = 0; c < n_outputs; ++c) {
            const float y = t.y[i][c], d = y - label[i][c], inv = 1 / (y * y + epsilon), slope = 2 * d * inv;
            const float below = slope < limit ? slope : limit;
            t.dy[i][c] = below > -limit ? below : -limit;
            sum += d * d * inv;
        }
        t.dy[i][3] = 0;
        loss[i] = sum;
    }
}

void adam_update(const AdamStep& step, std::size_t n, float* gradient, float* moment1, float* moment2, float* value) {
    // Whole blocks without a gradient, as most of a grid in a scene of surfaces, are only read.
    for (std::size_t i = 0; i < n; i += lane_block) {
        const int lanes = n - i < std::size_t(lane_block) ? int(n - i) : lane_block;
        bool any = false;
        for (int l = 0; l < lanes; ++l) any |= gradient[i + std::size_t(l)] != 0;
        if (!any) continue;
        if (lanes == lane_block)
            update_block(step, lane_block, gradient + i, moment1 + i, moment2 + i, value + i);
        else
            update_block(step, lanes, gradient + i, moment1 + i, moment2 + i, value + i);
    }
}

}  // namespace loom::neural::LOOM_LEVEL
