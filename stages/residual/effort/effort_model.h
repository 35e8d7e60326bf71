#pragma once
// Predicts from a pilot the variance of a distribution of effort.

#include <cstdint>
#include <vector>

#include "stages/residual/dynamic/path_pairs.h"

namespace loom::residual {

/// Contribution of one path to one pixel, with its weights in the pilot.
struct PilotPart {
    float v[3];
    float w[max_families];  // shares of its density by family, path tracing last; they sum to 1
    bool at_first;          // as in Part
};

/// The pilot's samples of one family.
class PilotSamples {
  public:
    /// Contributions of one sample to one pixel.
    struct Group {
        std::uint32_t pixel, begin, end;
    };
    /// in: found, pixels  contributions of a sample and their pixels; emptied
    void end_sample(std::vector<PilotPart>& found, std::vector<std::uint32_t>& pixels);
    void append(const PilotSamples& other);
    const std::vector<Group>& groups() const { return groups_; }
    const PilotPart& part(std::uint32_t i) const { return parts_[i]; }

  private:
    std::vector<PilotPart> parts_;
    std::vector<Group> groups_;
    std::vector<std::uint32_t> order_;
};

/// Samples of all families. Path tracing is last and recorded for some pixels only; samples of one pixel are
/// consecutive.
struct Pilot {
    std::vector<PilotSamples> families;
    std::vector<double> cost;     // C_k; for path tracing over all pixels
    std::uint64_t per_pixel = 2;  // camera paths of a recorded pixel
    double camera_scale = 1;      // pixels of the image over recorded pixels
    std::size_t n() const { return families.size(); }
};

/// Samples of each family over those of the pilot: x_k.
using Factors = std::vector<double>;

struct Objective {
    double M = 0;
    double of_cameras = 0;      // part of M from camera paths
    std::vector<double> slope;  // dM/dx_k
};

/// Returns the sum over pixels of the variance with x_k n0_k samples, mean over channels:
///     M(x) = sum_k x_k sum_{i in k} sum_pixels | sum_parts v / sum_l x_l w_l |^2
/// for camera paths about the mean of the pixel's samples. Pairs whose two paths cancel in one pixel are thus
/// recognised, which densities alone cannot show. M is homogeneous of degree -1.
/// in: first_to_camera  as SampleCounts
Objective variance_of(const Pilot& pilot, bool first_to_camera, const Factors& x);

/// Estimates the variance of camera paths alone from the samples of all families, without cancellation in pairs:
///     sum of v^2 / (x w_camera).
/// For an edit that hardly any camera path of a pilot hits: the missed contributions have variance too.
double camera_variance_by_all(const Pilot& pilot, double x_camera);

/// A distribution of the effort, and its predicted variance.
struct Spending {
    Factors x;
    bool first_to_camera = false;
    double M = 0;
};

/// Minimises M at sum_k x_k C_k = B. At the minimum -dM/dx_k / C_k is the same for all families. The iteration
///     x_k <- x_k sqrt(-dM/dx_k / (lambda C_k)),  lambda = M / B
/// converges to it. Families below 1/200 of the effort are dropped.
/// in: budget    B
///     map_gain  factor by which an effort map reduces the variance of camera paths
///     least_cameras  smallest share of the budget for camera paths, against contributions that the pilot missed
Spending best_spending(const Pilot& pilot, bool first_to_camera, double budget, double map_gain,
                       double least_cameras = 0);

}  // namespace loom::residual
