#include "stages/core/transport/cluster_columns.h"

namespace loom {

const ClusterKernels& cluster_kernels() {
    static const ClusterKernels chosen = [] {
        if (__builtin_cpu_supports("x86-64-v4"))
            return ClusterKernels{v4::evaluate_direction, v4::evaluate_point, v4::evaluate_delta_point, v4::apply_block};
        if (__builtin_cpu_supports("x86-64-v3"))
            return ClusterKernels{v3::evaluate_direction, v3::evaluate_point, v3::evaluate_delta_point, v3::apply_block};
        return ClusterKernels{v2::evaluate_direction, v2::evaluate_point, v2::evaluate_delta_point, v2::apply_block};
    }();
    return chosen;
}

}  // namespace loom
