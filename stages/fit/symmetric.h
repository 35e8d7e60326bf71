#pragma once
// Small symmetric matrices, row-major, n x n.

#include <optional>
#include <span>
#include <vector>

namespace loom::fit {

using Matrix = std::vector<double>;

/// Returns the solution of a x = b; none where `a` is not positive definite.
std::optional<std::vector<double>> solve(const Matrix& a, std::span<const double> b);
/// Returns the inverse; none where `a` is not positive definite.
std::optional<Matrix> inverse(const Matrix& a, std::size_t n);
/// Returns x^T a y.
double product(const Matrix& a, std::span<const double> x, std::span<const double> y);
/// Returns a b a, of symmetric matrices.
Matrix sandwich(const Matrix& a, const Matrix& b, std::size_t n);

}  // namespace loom::fit
