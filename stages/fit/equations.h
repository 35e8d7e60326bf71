#pragma once
// Normal equations of a fit: from a measured cube, and two independent evaluations of the scene at the same values.

#include <array>
#include <span>
#include <vector>

#include "formats/transient_cube.h"
#include "stages/fit/symmetric.h"
#include "stages/fit/time_transform.h"

namespace loom::fit {

/// Of the values y that the loss compares (TimeTransform), with weights W = 1 / variance of the residual, smoothed over
/// neighbours, measured values m, evaluations A and B with Jacobians J_A and J_B, and J = (J_A + J_B) / 2:
///
///   loss      (m - A)^T W (m - B)                              noise of A and B taken off
///   gradient  1/2 [J_A^T W (m - B) + J_B^T W (m - A)]          its mean is J^T W (m - y): noise of a residual and of its
///                                                              own Jacobian have the same paths, and their product a mean
///   normal    1/2 [J_A^T W J_B + J_B^T W J_A]                  mean J^T W J; may be indefinite by noise
///   curvature J^T W J of the mean J                            too large by the noise of J
struct Equations {
    std::vector<double> gradient;
    Matrix normal, curvature;
    /// Of the diagonal of `normal`, at most: from the scatter of the pixels' parts, which differ without noise too.
    std::vector<double> normal_variance;
    /// Covariance of the gradient: by the noise of the measurement; and also of A and B, pixel by pixel, since bins of a pixel
    /// have paths in common.
    Matrix measured_noise, noise;
    /// Sum over pixels of (gradient of the pixel)^2, times n / (n - parameters): at a minimum the covariance of the
    /// gradient, with the noise of the Jacobians and what the model does not explain.
    Matrix scatter;
    double loss = 0;
    double loss_variance = 0;                         // by the noise of A and B
    double expected_loss = 0, expected_variance = 0;  // at the true values
    std::size_t n_values = 0;
    std::size_t n_pixels = 0;
    std::size_t n_ignored = 0;  // values with NaN or infinity in any of the cubes

    explicit Equations(std::size_t n)
        : gradient(n, 0.0),
          normal(n * n, 0.0),
          curvature(n * n, 0.0),
          normal_variance(n, 0.0),
          measured_noise(n * n, 0.0),
          noise(n * n, 0.0),
          scatter(n * n, 0.0) {}
    std::size_t n_parameters() const { return gradient.size(); }
};

/// A measurement with three equal channels counts as one channel; the evaluations' channels are then averaged.
/// needs:   cubes of one shape; evaluations with derivatives by the same parameters
Equations normal_equations(const TransientCube& measured, std::span<const TransientCube, 2> evaluated,
                           const TimeTransform& transform);

}  // namespace loom::fit
