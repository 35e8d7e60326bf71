#pragma once
// loom-bench: three tables. They inform; nothing about time is asserted anywhere.

#include <chrono>
#include <cstdint>
#include <string>
#include <vector>

namespace loom::app {
class Report;
}

namespace loom::bench {

struct Options {
    std::vector<std::string> scenes;  // empty: those of the project, and the shared ones where they are there
    std::uint64_t paths = 400'000;    // of one run
    int rounds = 3;
    int threads = 0;  // 0: all
    enum class Table { all, throughput, kernels, samplers } table = Table::all;
};

/// Paths per second of the bare loop, of image tracing and of graph tracing, taking turns on each scene.
void throughput(const Options& options, app::Report& report);
/// Nanoseconds of sampling and evaluating each kind of BSDF, and of a pair of random numbers.
void kernels(const Options& options, app::Report& report);
/// Mean squared error of the samplers at equal numbers of samples.
void samplers(const Options& options, app::Report& report);

/// Seconds that body() takes.
template <class Body>
double seconds_of(Body&& body) {
    const auto start = std::chrono::steady_clock::now();
    body();
    return std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
}

}  // namespace loom::bench
