#include "stages/core/clusters/cluster_columns.h"

namespace loom {

#define LOOM_KERNELS_OF(LEVEL)                                                                                        \
    ClusterKernels {                                                                                                  \
        LEVEL::prepare_lanes, LEVEL::evaluate_direction, LEVEL::prepare_tints, LEVEL::evaluate_lobes,                 \
            LEVEL::evaluate_point, LEVEL::evaluate_delta_point, LEVEL::fix_row, LEVEL::fix_lobes, LEVEL::apply_block, \
            LEVEL::apply_plane                                                                                        \
    }

const ClusterKernels& cluster_kernels() {
    static const ClusterKernels chosen = [] {
        if (__builtin_cpu_supports("x86-64-v4")) return LOOM_KERNELS_OF(v4);
        if (__builtin_cpu_supports("x86-64-v3")) return LOOM_KERNELS_OF(v3);
        return LOOM_KERNELS_OF(v2);
    }();
    return chosen;
}

}  // namespace loom
