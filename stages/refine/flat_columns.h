#pragma once
// A flat diffuse cluster as columns of lanes: all its vertices are Lambertian and share one normal n. The cosine of a
// direction w is then equal at all of them, and the pooled estimate has rank one:
//
//   f_j cos / rho = albedo_j cos / pi / (cos / pi sum_k q_k) = albedo_j / sum_k q_k       for w above the surface
//
// Only the distance to near lights remains to be evaluated per vertex and edge.

#include <cstdint>

#include "stages/core/clusters/cluster_columns.h"
#include "stages/core/math/vector.h"

namespace loom::refine {

struct FlatColumns {
    int n = 0;
    Normal3f normal;  // on the side of wo
    alignas(64) LaneColumn px, py, pz;
    LaneColumn survival;  // probability that the ray of a BSDF sample is traced; 0 where none was attempted
    LaneColumn nee;       // 1 where next-event estimation was attempted and the albedo is not zero, else 0
    // Gathered: reflected light of a white vertex.
    LaneColumn white_r, white_g, white_b;
};

/// A batch of a cluster's light edges to lights of one kind.
struct FlatLights {
    static constexpr int capacity = 4 * lane_block;
    using EdgeColumn = float[capacity];

    int n = 0;
    // The light point, and the vertex that found it.
    alignas(64) EdgeColumn y_x, y_y, y_z, from_x, from_y, from_z;
    std::uint32_t normal[capacity];  // of an area light, as on disk: two octahedral int16, u low
    EdgeColumn Li_r, Li_g, Li_b;
    EdgeColumn pdf_nee;  // sr^-1 at the vertex that found it
    // Density of the technique that found it, of the other technique, and the divisor of the sample.
    EdgeColumn pdf, other_pdf, density;
    // Result: own estimate of that vertex for albedo 1 and radiance 1.
    EdgeColumn own;
    // Intermediate values.
    EdgeColumn n_x, n_y, n_z, pdf_shared;
    alignas(64) float reflected[capacity * max_lanes];
};

// Both process the edges of `e`. They add to white_* the light that each lane reflects with densities pooled over the
// cluster, and set e.own.                       equations: core/clusters/cluster_edges.h
#define LOOM_FLAT_KERNELS                                          \
    /* Measure of the light's area, by all lanes' own distance. */ \
    void gather_area_lights(FlatColumns& c, FlatLights& e);        \
    /* Point lights and spots: no density but their own. */        \
    void gather_point_lights(FlatColumns& c, FlatLights& e);

namespace v2 {
LOOM_FLAT_KERNELS
}
namespace v3 {
LOOM_FLAT_KERNELS
}
namespace v4 {
LOOM_FLAT_KERNELS
}

/// Kernels of the highest x86-64 level of this processor.
struct FlatKernels {
    decltype(&v2::gather_area_lights) area, point;
};
const FlatKernels& flat_kernels();

}  // namespace loom::refine
