#include "stages/fit/symmetric.h"

#include <cmath>

namespace loom::fit {
namespace {

/// Returns the Cholesky factor of `a`, scaled to a unit diagonal so that units of parameters do not count.
std::optional<Matrix> factor(const Matrix& a, std::size_t n, std::vector<double>& scale) {
    scale.assign(n, 0);
    for (std::size_t i = 0; i < n; ++i) {
        if (!(a[i * n + i] > 0) || !std::isfinite(a[i * n + i])) return std::nullopt;
        scale[i] = 1 / std::sqrt(a[i * n + i]);
    }
    constexpr double least_pivot = 1e-12;  // rounding of products of rows
    Matrix l(n * n, 0.0);
    for (std::size_t i = 0; i < n; ++i)
        for (std::size_t j = 0; j <= i; ++j) {
            double sum = a[i * n + j] * scale[i] * scale[j];
            for (std::size_t k = 0; k < j; ++k) sum -= l[i * n + k] * l[j * n + k];
            if (i != j) {
                l[i * n + j] = sum / l[j * n + j];
                continue;
            }
            if (!(sum > least_pivot)) return std::nullopt;
            l[i * n + i] = std::sqrt(sum);
        }
    return l;
}

}  // namespace

std::optional<std::vector<double>> solve(const Matrix& a, std::span<const double> b) {
    const std::size_t n = b.size();
    std::vector<double> scale;
    const std::optional<Matrix> l = factor(a, n, scale);
    if (!l) return std::nullopt;
    std::vector<double> x(n);
    for (std::size_t i = 0; i < n; ++i) {
        double sum = b[i] * scale[i];
        for (std::size_t k = 0; k < i; ++k) sum -= (*l)[i * n + k] * x[k];
        x[i] = sum / (*l)[i * n + i];
    }
    for (std::size_t i = n; i-- > 0;) {
        double sum = x[i];
        for (std::size_t k = i + 1; k < n; ++k) sum -= (*l)[k * n + i] * x[k];
        x[i] = sum / (*l)[i * n + i];
    }
    for (std::size_t i = 0; i < n; ++i) x[i] *= scale[i];
    return x;
}

std::optional<Matrix> inverse(const Matrix& a, std::size_t n) {
    Matrix out(n * n);
    for (std::size_t j = 0; j < n; ++j) {
        std::vector<double> unit(n, 0.0);
        unit[j] = 1;
        const auto column = solve(a, unit);
        if (!column) return std::nullopt;
        for (std::size_t i = 0; i < n; ++i) out[i * n + j] = (*column)[i];
    }
    return out;
}

double product(const Matrix& a, std::span<const double> x, std::span<const double> y) {
    double sum = 0;
    for (std::size_t i = 0; i < x.size(); ++i)
        for (std::size_t j = 0; j < y.size(); ++j) sum += x[i] * a[i * y.size() + j] * y[j];
    return sum;
}

Matrix sandwich(const Matrix& a, const Matrix& b, std::size_t n) {
    Matrix ab(n * n, 0.0), out(n * n, 0.0);
    for (std::size_t i = 0; i < n; ++i)
        for (std::size_t k = 0; k < n; ++k)
            for (std::size_t j = 0; j < n; ++j) ab[i * n + j] += a[i * n + k] * b[k * n + j];
    for (std::size_t i = 0; i < n; ++i)
        for (std::size_t k = 0; k < n; ++k)
            for (std::size_t j = 0; j < n; ++j) out[i * n + j] += ab[i * n + k] * a[k * n + j];
    return out;
}

}  // namespace loom::fit
