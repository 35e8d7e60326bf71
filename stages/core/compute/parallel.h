#pragma once
#include <pmmintrin.h>
#include <tbb/parallel_for.h>
#include <tbb/task_arena.h>

#include <algorithm>
#include <cstdint>

namespace loom {

/// Sets denormal numbers to 0, which are slow. Embree requires it of every thread that traces.
inline void flush_small_numbers() {
    _MM_SET_FLUSH_ZERO_MODE(_MM_FLUSH_ZERO_ON);
    _MM_SET_DENORMALS_ZERO_MODE(_MM_DENORMALS_ZERO_ON);
}

/// Calls body(chunk, begin, end) for consecutive chunks of [0, n), in parallel on `threads` threads (0: all). The
/// assignment of chunks to threads is unspecified, so a body must write only to memory that its chunk owns.
template <class Body>
void parallel_chunks(std::uint64_t n, std::uint64_t chunk_size, int threads, Body&& body) {
    const std::uint64_t n_chunks = (n + chunk_size - 1) / chunk_size;
    tbb::task_arena arena(threads > 0 ? threads : tbb::task_arena::automatic);
    arena.execute([&] {
        tbb::parallel_for(std::uint64_t(0), n_chunks, [&](std::uint64_t chunk) {
            flush_small_numbers();
            const std::uint64_t begin = chunk * chunk_size;
            body(chunk, begin, std::min(begin + chunk_size, n));
        });
    });
}

}  // namespace loom
