#pragma once
// Paths of a capture around a corner. Apart from the path tracer proper, so that ordinary scenes pay nothing for it.

#include <span>

#include "stages/core/tracing/path_tracer.h"

namespace loom {

/// Traces from the sensor to its point of the relay wall and on, each vertex lit by the laser.
///   L = sum_j beta_j f cos Li,  Li of the projector itself or, with laser sampling, of the spot that its beam lights:
///   Li = f_l cos_laser E cos_l / r^2 A,  E its irradiance of a facing plane, A = 1 m^2 or that of the beam's section
/// A direction is chosen among hidden geometry or by the BSDF, and its density is that of both together:
///   pdf_w = q (c p_hidden + (1 - c) p_bsdf)
/// A point of hidden geometry that something hides ends the path, so that no layer counts twice.   [Royo2022]
/// Depths count edges, the laser's among them: wall, hidden surface, wall is 4 whether or not lasers are sampled.
/// needs:   scene.nlos
/// in:      records  null: the radiance alone
void trace_nlos(const Scene& scene, const PathOptions& options, std::span<const PathId> ids,
                std::span<PathResult> results, PathRecords* records);

}  // namespace loom
