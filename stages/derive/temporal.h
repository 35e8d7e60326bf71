#pragma once
// The temporal boundary: light that a delta pulse moves over the borders of box bins as its arrival time changes.
//
//   d(bin k) = sum over its light of L' + phi(t_k) - phi(t_(k+1)),   phi(t) = E[L opl' delta(opl - t)]
//
// Line samples of phi.                                                  [TR section 5: "future work"; own derivation]
// One vertex x of a stored path slides over its flat polygon, all others stay. F is the integrand of the path by areas,
// opl' included, p the density of the stored path. Along an in-plane unit axis a, opl(s) = c + eta sum_i
// |x + s a - f_i| is convex in s, with the one or two neighbours f_i as foci, and takes each value at most twice, in
// closed form. Let I be the part of the line where p > 0, and h a kernel on it that integrates to 1. Then
//   E[h(x) / p(x) sum over roots z in I of F(z) / |d_a opl(z)|]
//     = integral over lines of sum over z of F(z) / |d_a opl(z)|,  because h integrates to 1 over the x of a line,
//     = phi(t).
// With several techniques, each brings its part times its MIS weight w(x): they share h, and their w sum to 1 at each x.
// So neither the density at z nor that along the line occurs, only F(z) / p(x), whose other factors the graph holds.
// Two orthogonal axes share by w_a = (d_a opl)^2 / |grad opl|^2, so that |d_a opl| in the denominator cancels.
// Needs: what decides whether a path is treated this way, and I itself, must be the same for all x of the polygon.
//   I is what the planes of the neighbours leave of the polygon (cosines are positive); where the density vanishes
//   towards such a plane, h does, too. Nothing may block light within the pyramids from both neighbours to the polygon:
//   paths that are blocked have no rows, so that neither shadow rays nor parts of I would make up for them. This is
//   proved by separating planes; what it fails for stays as it is, and the file says how much.
// x is the vertex that receives a laser spot or a point light, or the point on an area light.

#include <cstdint>

#include "formats/derivative.h"
#include "formats/path_graph.h"
#include "stages/core/app/report.h"
#include "stages/derive/surface_motion.h"

namespace loom::derive {

/// Box bins of a delta pulse: border k is at start + k width.
struct TemporalBins {
    double start = 0, width = 1;
    std::uint32_t n = 1;
    bool camera_segment = true;  // lengths count from the camera, else from the first hit
};

/// Samples phi at all borders from the paths of a graph, into derivative.temporal.
/// in, out: derivative  with its interior rows and parameters
void differentiate_temporal(const PathGraph& graph, const Scene& scene, const SceneTangents& tangents,
                            const Attached& attached, const TemporalBins& bins, int threads, app::Report& report,
                            Derivative& derivative);

}  // namespace loom::derive
