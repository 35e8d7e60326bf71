#pragma once
// A flat matte cluster as columns of lanes: all its vertices reflect by Lambert's law and share one normal n. The
// cosine of a direction w is then the same at each of them, and what the cluster pools is of rank one:
//
//   f_j cos / rho = albedo_j cos / pi / (cos / pi sum_k q_k) = albedo_j / sum_k q_k       for w above the surface
//
// Nothing is left to evaluate per vertex and edge but the distance to lights that are near.

#include <cstdint>

#include "stages/core/clusters/cluster_columns.h"
#include "stages/core/math/vector.h"

namespace loom::refine {

struct FlatColumns {
    int n = 0;
    Normal3f normal;  // on the side of wo
    alignas(64) LaneColumn px, py, pz;
    LaneColumn survival;  // probability that BSDF sampling goes on to trace its ray; 0 where it was not attempted
    LaneColumn nee;       // 1 where next-event estimation was attempted and there is something to reflect, else 0
    // Gathered: what a white vertex would reflect.
    LaneColumn white_r, white_g, white_b;
};

/// Light edges of a cluster to lights of one kind, some at a time.
struct FlatLights {
    static constexpr int capacity = 4 * lane_block;
    using EdgeColumn = float[capacity];

    int n = 0;
    // The light point, and the vertex that found it.
    alignas(64) EdgeColumn y_x, y_y, y_z, from_x, from_y, from_z;
    std::uint32_t normal[capacity];  // of an area light, as on disk: two octahedral int16, u low
    EdgeColumn Li_r, Li_g, Li_b;
    EdgeColumn pdf_nee;  // sr^-1 at the vertex that found it
    EdgeColumn pdf, other_pdf,
        density;  // of the technique that found it, of the other one, and what the sample is divided by
    // Answered: what that vertex makes of it by itself, were it white, and the light 1.
    EdgeColumn own;
    // In between.
    EdgeColumn n_x, n_y, n_z, pdf_shared;
    alignas(64) float reflected[capacity * max_lanes];
};

// Both take the edges of `e`, add to white_* what each lane reflects of them with densities pooled over the cluster,
// and answer e.own.                                     equations: core/clusters/cluster_edges.h
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

/// The kernels of the highest level that this processor has.
struct FlatKernels {
    decltype(&v2::gather_area_lights) area, point;
};
const FlatKernels& flat_kernels();

}  // namespace loom::refine
