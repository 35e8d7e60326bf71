#pragma once
// Console output of a running stage: log lines and progress on stderr, answers on stdout. Nothing else in a stage
// prints.

#include <fmt/format.h>

#include <atomic>
#include <chrono>
#include <cstdint>
#include <memory>
#include <mutex>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "formats/io/cost.h"
#include "formats/io/provenance.h"

namespace spdlog {
class logger;
}

namespace loom::app {

class Report;

/// Resources used by a stage since its Report was constructed.
struct Usage {
    double wall_s = 0;
    double cpu_s = 0;                     // all threads, user and system
    std::uint64_t peak_memory_bytes = 0;  // largest resident set of the process
};
Usage usage_since(std::chrono::steady_clock::time_point start, double cpu_start_s);

/// Progress of one piece of work with an estimate of the remaining time. add() is thread-safe. On a terminal one line
/// is rewritten, elsewhere a line is printed at each tenth.
class Progress {
  public:
    Progress(Report& report, std::string what, std::uint64_t total);
    ~Progress();
    Progress(const Progress&) = delete;
    Progress& operator=(const Progress&) = delete;

    /// Counts n more of `total` as done.
    void add(std::uint64_t n = 1) {
        const std::uint64_t done = done_.fetch_add(n, std::memory_order_relaxed) + n;
        if (done >= next_.load(std::memory_order_relaxed)) show(done);
    }
    std::uint64_t done() const { return done_.load(std::memory_order_relaxed); }

  private:
    void show(std::uint64_t done);

    Report& report_;
    std::string what_;
    std::uint64_t total_;
    std::chrono::steady_clock::time_point start_;
    std::atomic<std::uint64_t> done_{0};
    std::atomic<std::uint64_t> next_;
};

/// The only output channel of a stage; thread-safe.
class Report {
  public:
    /// in:      name  the program's name in log lines, for example "loom-trace"
    explicit Report(std::string name = "loom");

    const std::string& name() const { return name_; }
    /// Returns the resolved options, defaults included, as the output's `command` attribute. It has no path, output
    /// name or number of threads, so that equal inputs give equal bytes. Outside of a Command it is the program's name.
    const std::string& command() const { return command_; }
    void set_command(std::string command) { command_ = std::move(command); }
    /// Silences info, progress and done; warnings, errors and answers are still printed.
    void set_quiet(bool quiet) { quiet_ = quiet; }
    bool quiet() const { return quiet_; }

    template <class... Args>
    void info(fmt::format_string<Args...> text, Args&&... args) {
        if (!quiet_) log_line(Level::info, fmt::format(text, std::forward<Args>(args)...));
    }
    template <class... Args>
    void warn(fmt::format_string<Args...> text, Args&&... args) {
        warnings_.fetch_add(1, std::memory_order_relaxed);
        log_line(Level::warning, fmt::format(text, std::forward<Args>(args)...));
    }
    template <class... Args>
    void error(fmt::format_string<Args...> text, Args&&... args) {
        log_line(Level::error, fmt::format(text, std::forward<Args>(args)...));
    }
    /// Prints a requested result on stdout, unchanged.
    /// throws:  std::runtime_error when it cannot be written, as does flush_answers()
    void answer(std::string_view text);
    /// Flushes all answers to the system. Must be called before a stage ends with success.
    void flush_answers();
    /// Prints the closing line. The caller gives counts and what was dropped; seconds, peak memory and the number of
    /// warnings are added.
    template <class... Args>
    void done(fmt::format_string<Args...> counts, Args&&... args) {
        if (!quiet_) close(fmt::format(counts, std::forward<Args>(args)...));
    }

    std::uint64_t warnings() const { return warnings_.load(std::memory_order_relaxed); }
    Usage usage() const { return usage_since(start_, cpu_start_s_); }
    /// Returns the cost of the stage so far; the caller adds rays, samples, load_s and sources (see write_cost_of()).
    Cost cost(std::string plan = {}) const;
    /// Returns the provenance of an output of this stage.
    Provenance provenance(std::uint64_t seed, std::vector<InputId> inputs, std::string plan) const;

  private:
    friend class Progress;
    enum class Level { info, warning, error };

    void log_line(Level level, const std::string& text);
    void close(const std::string& counts);
    void rewrite_line(const std::string& text);  // terminal only; an empty text clears the line

    std::string name_, command_;
    bool quiet_ = false;
    bool terminal_;
    bool line_open_ = false;
    std::mutex mutex_;  // guards the terminal line
    std::shared_ptr<spdlog::logger> logger_;
    std::atomic<std::uint64_t> warnings_{0};
    std::chrono::steady_clock::time_point start_;
    double cpu_start_s_;
};

/// Formats a duration: "850 ms", "12.3 s", "4 min 05 s", "2 h 10 min".
std::string duration_text(double seconds);
/// Formats a size: "512 B", "3.4 MiB".
std::string bytes_text(std::uint64_t bytes);

}  // namespace loom::app
