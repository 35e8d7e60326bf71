// Hot loops of the built-in filter, compiled once per x86-64 level (LOOM_LEVEL is v2, v3 or v4). They call no library
// function: one that is not inlined would link into the program at the wrong level.
#include "stages/denoise/filter_levels.h"

namespace loom::LOOM_LEVEL {
namespace {

constexpr int tw = filter_tile_width, lanes = filter_lanes, ns = n_stored_features, nf = n_features, nt = n_terms;
constexpr int patch_width = filter_patch_width;

/// Sixteen columns as one vector. By itself g++ 12 vectorises the regression along its nine features, and the distances
/// not at all.
typedef float Lanes __attribute__((vector_size(4 * lanes)));
typedef float LanesAt __attribute__((vector_size(4 * lanes), aligned(4), may_alias));  // at any column offset

#define LOOM_AT(pointer) (*reinterpret_cast<const LanesAt*>(pointer))
#define LOOM_SUM_AT(pointer) (*reinterpret_cast<LanesAt*>(pointer))

inline float max_of(float a, float b) {
    return a > b ? a : b;
}

/// Returns (1 - t/8)^8, 0 from t = 8 on: exp(-t) with finite support.
inline float falloff(float t) {
    float f = max_of(0.0f, 1.0f - t * 0.125f);
    f *= f;
    f *= f;
    return f * f;
}

/// Computes the squared difference of the pixels p and q in units of its variance, minus the expectation of noise
/// alone.
void distance_row(const FilterTile& t, std::ptrdiff_t p, std::ptrdiff_t to_q, float* __restrict distance) {
    for (int i = 0; i < patch_width; i += lanes) {
        Lanes sum{};
#pragma GCC unroll 3
        for (int c = 0; c < 3; ++c) {
            const Lanes u = LOOM_AT(t.guide[c] + p + i), uq = LOOM_AT(t.guide[c] + p + to_q + i);
            const Lanes v = LOOM_AT(t.guide_variance[c] + p + i), vq = LOOM_AT(t.guide_variance[c] + p + to_q + i);
            const Lanes d = u - uq, noise = v + (v < vq ? v : vq);
            const Lanes rounding = 1e-30f + 1e-12f * (u * u + uq * uq);
            sum += (d * d - noise) / (rounding + t.k_squared * (v + vq));
        }
        LOOM_SUM_AT(distance + i) = sum;
    }
}

/// Computes weights[offset][row][x] of the centres of a tile.
void tile_weights(const FilterTile& t) {
    const int r = t.window_radius, pr = t.patch_radius, rows = t.height + 2 * pr;
    float distance[(filter_tile_height + 2 * max_patch_radius) * patch_width];
    const float norm = 1.0f / (3.0f * float((2 * pr + 1) * (2 * pr + 1)));
    float* __restrict out = t.weights;
    for (int dy = -r; dy <= r; ++dy) {
        for (int dx = -r; dx <= r; ++dx) {
            const std::ptrdiff_t to_q = dy * t.stride + dx;
            for (int row = 0; row < rows; ++row)
                distance_row(t, (t.y + row - pr) * t.stride + t.x - pr, to_q, distance + row * patch_width);
            for (int row = 0; row < t.height; ++row, out += tw) {
                float column[patch_width], sum[tw];
                for (int i = 0; i < patch_width; ++i) column[i] = distance[row * patch_width + i];
                for (int j = 1; j <= 2 * pr; ++j) {
                    const float* __restrict d = distance + (row + j) * patch_width;
                    for (int i = 0; i < patch_width; ++i) column[i] += d[i];
                }
                for (int i = 0; i < tw; ++i) sum[i] = column[i];
                for (int j = 1; j <= 2 * pr; ++j)
                    for (int i = 0; i < tw; ++i) sum[i] += column[i + j];
                const float* __restrict inside = t.inside + (t.y + row) * t.stride + t.x;
                const float* __restrict inside_q = inside + to_q;
                for (int i = 0; i < tw; ++i) out[i] = inside[i] * inside_q[i] * falloff(max_of(0.0f, sum[i] * norm));
            }
        }
    }
}

/// Computes the features of the window's pixel minus those of the centre; the position is equal for all lanes.
inline void feature_differences(const FilterTile& t, std::ptrdiff_t q, std::ptrdiff_t to_p, int dx, int dy,
                                Lanes (&g)[nf]) {
#pragma GCC unroll 16
    for (int f = 0; f < ns; ++f) g[f] = LOOM_AT(t.feature[f] + q + to_p) - LOOM_AT(t.feature[f] + q);
    g[ns] = Lanes{} + float(dx) * t.pixel_scale;
    g[ns + 1] = Lanes{} + float(dy) * t.pixel_scale;
}

/// Whether all weights are zero; weights are not negative.
inline bool all_zero(const float* __restrict w) {
    bool any = false;
    for (int l = 0; l < lanes; ++l) any |= w[l] > 0;
    return !any;
}

/// Returns the index of column j, row k <= j of a symmetric matrix.
constexpr int at(int j, int k) {
    return j * (j + 1) / 2 + k;
}

/// Factorises A = L D L^T in place (D on the diagonal), then replaces b by A^-1 b.
void solve(Lanes (&a)[nt * (nt + 1) / 2], Lanes (&b)[nt][3]) {
    const Lanes rounding = 1e-6f * a[0], left_out = 1e30f + Lanes{};
    for (int j = 0; j < nt; ++j) {
        Lanes scaled[nt];  // L_ji D_i
        for (int i = 0; i < j; ++i) {
            scaled[i] = a[at(j, i)];
            for (int k = 0; k < i; ++k) scaled[i] -= scaled[k] * a[at(i, k)];
        }
        for (int i = 0; i < j; ++i) {
            a[at(j, i)] = scaled[i] / a[at(i, i)];
            a[at(j, j)] -= scaled[i] * a[at(j, i)];
        }
        // Rounding must not give a huge slope to a feature that is constant in the window, or depends on the others: it is
        // left out. (With a small pivot the rounding errors of the others would grow by its inverse.)
        a[at(j, j)] = a[at(j, j)] > rounding ? a[at(j, j)] : left_out;
    }
    for (int c = 0; c < 3; ++c) {
        for (int j = 1; j < nt; ++j)
            for (int k = 0; k < j; ++k) b[j][c] -= a[at(j, k)] * b[k][c];
        for (int j = nt - 1; j >= 0; --j) {
            b[j][c] /= a[at(j, j)];
            for (int k = j + 1; k < nt; ++k) b[j][c] -= a[at(k, j)] * b[k][c];
        }
    }
}

/// Fits weighted least squares at `lanes` centres, and adds their predictions for their windows.
void regress(const FilterTile& t, int row, int column) {
    const int r = t.window_radius;
    const std::ptrdiff_t q = (t.y + row) * t.stride + t.x + column;
    const std::ptrdiff_t next = std::ptrdiff_t(t.height) * tw;
    const float* const first_weights = t.weights + row * tw + column;
    Lanes a[nt * (nt + 1) / 2]{}, b[nt][3]{}, noise{}, power{};

    const float* weights = first_weights;
    for (int dy = -r; dy <= r; ++dy) {
        for (int dx = -r; dx <= r; ++dx, weights += next) {
            if (all_zero(weights)) continue;
            const std::ptrdiff_t to_p = dy * t.stride + dx;
            const Lanes w = LOOM_AT(weights);
            Lanes g[nf];
            feature_differences(t, q, to_p, dx, dy, g);
            Lanes u[3];
#pragma GCC unroll 3
            for (int c = 0; c < 3; ++c) {
                u[c] = LOOM_AT(t.color[c] + q + to_p);
                noise += w * LOOM_AT(t.variance[c] + q + to_p);
                const Lanes wu = w * u[c];
                power += wu * u[c];
                b[0][c] += wu;
            }
            a[0] += w;
#pragma GCC unroll 16
            for (int f = 0; f < nf; ++f) {
                const Lanes wg = w * g[f];
                a[at(f + 1, 0)] += wg;
#pragma GCC unroll 16
                for (int e = 0; e <= f; ++e) a[at(f + 1, e + 1)] += wg * g[e];
#pragma GCC unroll 3
                for (int c = 0; c < 3; ++c) b[f + 1][c] += wg * u[c];
            }
        }
    }

    // Add a prior on slopes of the size of the colour. The remaining terms are for features that are constant in the
    // window.
    const Lanes lambda = t.ridge * (noise / (power + 1e-30f)) + 1e-6f * a[0] + 1e-30f;
    for (int f = 0; f < nf; ++f) a[at(f + 1, f + 1)] += lambda;
    a[0] += 1e-30f;
    solve(a, b);

    weights = first_weights;
    for (int dy = -r; dy <= r; ++dy) {
        for (int dx = -r; dx <= r; ++dx, weights += next) {
            if (all_zero(weights)) continue;
            const Lanes w = LOOM_AT(weights);
            Lanes g[nf];
            feature_differences(t, q, dy * t.stride + dx, dx, dy, g);
            const std::ptrdiff_t to = (row + dy + r) * t.stride + t.x + column + dx;
#pragma GCC unroll 3
            for (int c = 0; c < 3; ++c) {
                Lanes prediction = b[0][c];
#pragma GCC unroll 16
                for (int f = 0; f < nf; ++f) prediction += b[f + 1][c] * g[f];
                LOOM_SUM_AT(t.sums[c] + to) += w * prediction;
            }
            LOOM_SUM_AT(t.sums[3] + to) += w;
        }
    }
}

}  // namespace

void filter_tile(const FilterTile& t) {
    tile_weights(t);
    for (int row = 0; row < t.height; ++row)
        for (int column = 0; column < tw; column += lanes) regress(t, row, column);
}

}  // namespace loom::LOOM_LEVEL
