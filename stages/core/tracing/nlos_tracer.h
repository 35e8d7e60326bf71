#pragma once
// Paths of an NLOS capture, separate from the path tracer so that ordinary scenes have no overhead.

#include <span>

#include "stages/core/tracing/path_tracer.h"

namespace loom {

/// Traces paths from the sensor to its point of the relay wall and on; each vertex is lit by the laser.
///   L = sum_j beta_j f cos Li,  Li of the projector itself or, with laser sampling, of the laser spot:
///   Li = f_l cos_laser E cos_l / r^2 A,  E its irradiance of a facing plane, A = 1 m^2 or that of the beam's section
/// A direction is chosen among hidden geometry or by the BSDF; its density is that of both together:
///   pdf_w = q (c p_hidden + (1 - c) p_bsdf)
/// A sampled point of hidden geometry that is occluded ends the path, so that no layer counts twice.   [Royo2022]
/// Depths count edges, including the laser's: wall, hidden surface, wall is 4 with or without laser sampling.
/// needs:   scene.nlos
/// in:      starts   PathId, or GivenRay: a ray from a surface
///          records  null: compute the radiance only
template <class Start>
void trace_nlos(const Scene& scene, const PathOptions& options, std::span<const Start> starts,
                std::span<PathResult> results, PathRecords* records);

}  // namespace loom
