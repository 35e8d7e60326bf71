// Segments against boxes, compiled once per x86-64 level (LOOM_LEVEL is v2, v3 or v4).
#include "stages/core/tracing/segment_levels.h"

namespace loom::LOOM_LEVEL {

__attribute__((flatten)) void find_met(SegmentColumns& segments, std::size_t n, const Box3f* boxes,
                                       std::size_t n_boxes) {
    const float *const __restrict__ ox = segments.o[0].data(), *const __restrict__ oy = segments.o[1].data(), *const __restrict__ oz = segments.o[2].data();
    const float *const __restrict__ ix = segments.inv_d[0].data(), *const __restrict__ iy = segments.inv_d[1].data(),
                *const __restrict__ iz = segments.inv_d[2].data();
    const float* const __restrict__ first = segments.t_min.data(), * const __restrict__ last = segments.t_max.data();
    std::uint8_t* const __restrict__ met = segments.met.data();
    for (std::size_t i = 0; i < n; ++i) met[i] = 0;
    for (std::size_t b = 0; b < n_boxes; ++b) {
        const float lx = boxes[b].lo.x, ly = boxes[b].lo.y, lz = boxes[b].lo.z, hx = boxes[b].hi.x, hy = boxes[b].hi.y,
                    hz = boxes[b].hi.z;
        for (std::size_t i = 0; i < n; ++i) {
            const float ax = (lx - ox[i]) * ix[i], bx = (hx - ox[i]) * ix[i];
            const float ay = (ly - oy[i]) * iy[i], by = (hy - oy[i]) * iy[i];
            const float az = (lz - oz[i]) * iz[i], bz = (hz - oz[i]) * iz[i];
            float near = first[i], far = last[i];
            const float nx = ax < bx ? ax : bx, fx = ax < bx ? bx : ax;
            const float ny = ay < by ? ay : by, fy = ay < by ? by : ay;
            const float nz = az < bz ? az : bz, fz = az < bz ? bz : az;
            near = nx > near ? nx : near;
            near = ny > near ? ny : near;
            near = nz > near ? nz : near;
            far = fx < far ? fx : far;
            far = fy < far ? fy : far;
            far = fz < far ? fz : far;
            met[i] |= std::uint8_t(near <= far);
        }
    }
}

}  // namespace loom::LOOM_LEVEL
