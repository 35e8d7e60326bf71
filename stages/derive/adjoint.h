#pragma once
// Weights of a histogram, pre-filtered with the response of the sensor: what a unit of light contributes to the loss by
// its pixel and time of flight.                                                                   [TR section 5.2]

#include <string>

#include "formats/transient_cube.h"
#include "stages/core/graph/time_of_flight.h"
#include "stages/core/graph/time_response.h"

namespace loom::derive {

/// Loss per unit of light, and its slope in time.
struct LightWeight {
    Rgb<double> value, slope;  // slope: 1/m
};

/// A cube whose `radiance` is the derivative of a loss by each bin.
///   a(t) = sum_k weight_k S_e[k](t),   a'(t) = sum_k weight_k S_e[k]'(t)
/// Both are exact: only bins that the pulse reaches count, so that the cost is independent of the number of bins.
class Adjoint {
  public:
    /// in:      name  of the file, for errors
    /// throws:  InputError when the cube is not of the graph's film, or its response cannot be evaluated
    Adjoint(TransientCube cube, const PathGraph& graph, const std::string& name);

    const TimeResponse& response() const { return response_; }
    Timing timing() const { return {cube_.time.camera_segment != 0, {}}; }
    std::size_t bytes_per_pixel() const { return std::size_t{12} * response_.n_bins; }

    /// Sets the weight of light of a pixel by its optical path length.
    /// out:     whether it contributes; never for an infinite length
    bool at(std::size_t pixel, double opl, LightWeight& weight) const;
    /// Returns a(opl) alone, with the rule of bins for boundary rows, whose length is fixed.
    Rgb<double> value_at(std::size_t pixel, double opl) const;

  private:
    TransientCube cube_;
    TimeResponse response_;
};

/// Returns the response that a cube's header describes.
/// throws:  InputError naming the file
TimeResponse response_of(const TransientCubeHeader& header, const std::string& name);

}  // namespace loom::derive
