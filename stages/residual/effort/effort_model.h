#pragma once
// What variance a spending of effort leaves, told by the samples of a pilot.

#include <cstdint>
#include <vector>

#include "stages/residual/dynamic/path_pairs.h"

namespace loom::residual {

/// What one path adds to one pixel, with the weights that it has in the pilot.
struct PilotPart {
    float v[3];
    float w[max_families];  // shares of its density by family, path tracing the last; their sum is 1
    bool at_first;          // as Part
};

/// The samples that a pilot has taken of one family.
class PilotSamples {
  public:
    /// Parts of one sample in one pixel.
    struct Group {
        std::uint32_t pixel, begin, end;
    };
    /// in: found, pixels  parts of a sample and where they go; emptied
    void end_sample(std::vector<PilotPart>& found, std::vector<std::uint32_t>& pixels);
    void append(const PilotSamples& other);
    const std::vector<Group>& groups() const { return groups_; }
    const PilotPart& part(std::uint32_t i) const { return parts_[i]; }

  private:
    std::vector<PilotPart> parts_;
    std::vector<Group> groups_;
    std::vector<std::uint32_t> order_;
};

/// Samples of all families, path tracing's the last and of some pixels alone, those of a pixel in a row.
struct Pilot {
    std::vector<PilotSamples> families;
    std::vector<double> cost;     // C_k, of path tracing for all pixels
    std::uint64_t per_pixel = 2;  // camera paths of a recorded pixel
    double camera_scale = 1;      // pixels of the picture over the recorded ones
    std::size_t n() const { return families.size(); }
};

/// Samples of each family over those of the pilot: x_k.
using Factors = std::vector<double>;

struct Objective {
    double M = 0;
    double of_cameras = 0;      // part of M
    std::vector<double> slope;  // dM/dx_k
};

/// Sum over pixels of the variance with x_k n0_k samples, mean over channels:
///     M(x) = sum_k x_k sum_{i in k} sum_pixels | sum_parts v / sum_l x_l w_l |^2
/// of camera paths about the mean of the pixel's samples. So pairs whose two paths cancel in one pixel are seen as
/// such, which densities alone do not say. M is homogeneous of degree -1.
/// in: first_to_camera  as SampleCounts
Objective variance_of(const Pilot& pilot, bool first_to_camera, const Factors& x);

/// What camera paths alone would have, told by the samples of all families, without what cancels in pairs:
///     sum of v^2 / (x w_camera).
/// For an edit that hardly any camera path of a pilot meets: what it has missed is not without variance.
double camera_variance_by_all(const Pilot& pilot, double x_camera);

/// A way to spend the effort, and the variance that it leaves.
struct Spending {
    Factors x;
    bool first_to_camera = false;
    double M = 0;
};

/// The least M at sum_k x_k C_k = B. There -dM/dx_k / C_k is the same for all families, to which
///     x_k <- x_k sqrt(-dM/dx_k / (lambda C_k)),  lambda = M / B
/// leads. Families that come to less than a two hundredth of the effort are left out.
/// in: budget    B
///     map_gain  how many times less variance camera paths have when they are spread by a map
///     least_cameras  share of the budget that camera paths keep, against what no sample of the pilot has seen
Spending best_spending(const Pilot& pilot, bool first_to_camera, double budget, double map_gain,
                       double least_cameras = 0);

}  // namespace loom::residual
