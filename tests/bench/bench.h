#pragma once
// loom-bench: four tables, for information; no test asserts times.

#include <chrono>
#include <cstdint>
#include <string>
#include <vector>

namespace loom::app {
class Report;
}

namespace loom::bench {

struct Options {
    std::vector<std::string> scenes;  // empty: those of the project, and the shared ones if present
    std::uint64_t paths = 400'000;    // of one run
    int rounds = 3;
    int threads = 0;  // 0: all
    enum class Table { all, throughput, kernels, samplers, edges } table = Table::all;
};

/// Measures paths per second of the bare loop, of image tracing and of graph tracing, in turns on each scene.
void throughput(const Options& options, app::Report& report);
/// Measures nanoseconds of sampling and evaluating each kind of BSDF, and of a pair of random samples.
void kernels(const Options& options, app::Report& report);
/// Measures the mean squared error of the samplers at equal numbers of samples.
void samplers(const Options& options, app::Report& report);

/// Measures variance times CPU time of boundary samples: loom-derive's against guided edge sampling.
void edge_sampling(const Options& options, app::Report& report);

/// Returns the wall time of body() in seconds.
template <class Body>
double seconds_of(Body&& body) {
    const auto start = std::chrono::steady_clock::now();
    body();
    return std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
}

}  // namespace loom::bench
