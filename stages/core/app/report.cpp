#include "stages/core/app/report.h"

#include <spdlog/logger.h>
#include <spdlog/sinks/stdout_sinks.h>
#include <sys/resource.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstdio>
#include <cstring>
#include <fstream>
#include <stdexcept>

namespace loom::app {
namespace {

double cpu_now_s() {
    rusage r{};
    getrusage(RUSAGE_SELF, &r);
    const auto seconds = [](const timeval& t) {
        return static_cast<double>(t.tv_sec) + 1e-6 * static_cast<double>(t.tv_usec);
    };
    return seconds(r.ru_utime) + seconds(r.ru_stime);
}

/// Returns VmHWM, not ru_maxrss, which survives exec: a small stage started by a large parent would report its parent's
/// memory.
std::uint64_t peak_memory_bytes() {
    std::ifstream status("/proc/self/status");
    std::string word;
    while (status >> word) {
        std::uint64_t kib = 0;
        if (word == "VmHWM:" && status >> kib) return kib * 1024;
    }
    rusage r{};
    getrusage(RUSAGE_SELF, &r);
    return static_cast<std::uint64_t>(r.ru_maxrss) * 1024;
}

[[noreturn]] void refuse_stdout() {
    throw std::runtime_error(fmt::format("cannot write to the standard output: {}", std::strerror(errno)));
}

}  // namespace

std::string duration_text(double seconds) {
    if (seconds < 1) return fmt::format("{:.0f} ms", seconds * 1e3);
    if (seconds < 60) return fmt::format("{:.1f} s", seconds);
    const auto whole = static_cast<std::uint64_t>(seconds + 0.5);
    if (whole < 3600) return fmt::format("{} min {:02} s", whole / 60, whole % 60);
    return fmt::format("{} h {:02} min", whole / 3600, whole % 3600 / 60);
}

std::string bytes_text(std::uint64_t bytes) {
    if (bytes < 1024) return fmt::format("{} B", bytes);
    const char* const units[] = {"KiB", "MiB", "GiB", "TiB"};
    double value = static_cast<double>(bytes) / 1024;
    int unit = 0;
    while (value >= 1024 && unit < 3) {
        value /= 1024;
        ++unit;
    }
    return fmt::format("{:.1f} {}", value, units[unit]);
}

Usage usage_since(std::chrono::steady_clock::time_point start, double cpu_start_s) {
    const std::chrono::duration<double> wall = std::chrono::steady_clock::now() - start;
    return {wall.count(), cpu_now_s() - cpu_start_s, peak_memory_bytes()};
}

Report::Report(std::string name)
    : name_(std::move(name)),
      command_(name_),
      terminal_(isatty(STDERR_FILENO) == 1),
      logger_(std::make_shared<spdlog::logger>(name_, std::make_shared<spdlog::sinks::stderr_sink_mt>())),
      start_(std::chrono::steady_clock::now()),
      cpu_start_s_(cpu_now_s()) {
    logger_->set_pattern("%n: %v");
    logger_->flush_on(spdlog::level::info);
}

void Report::log_line(Level level, const std::string& text) {
    const std::lock_guard lock(mutex_);
    rewrite_line("");
    switch (level) {
        case Level::info:
            logger_->info(text);
            break;
        case Level::warning:
            logger_->warn("warning: " + text);
            break;
        case Level::error:
            logger_->error("error: " + text);
            break;
    }
}

void Report::rewrite_line(const std::string& text) {
    if (!line_open_ && text.empty()) return;
    fmt::print(stderr, "\r{}\x1b[K", text);
    std::fflush(stderr);
    line_open_ = !text.empty();
}

void Report::answer(std::string_view text) {
    const std::lock_guard lock(mutex_);
    rewrite_line("");
    if (std::fwrite(text.data(), 1, text.size(), stdout) != text.size()) refuse_stdout();
}

void Report::flush_answers() {
    if (std::fflush(stdout) != 0) refuse_stdout();
}

Cost Report::cost(std::string plan) const {
    const Usage used = usage();
    Cost cost;
    cost.stage = name_;
    cost.wall_s = used.wall_s;
    cost.cpu_s = used.cpu_s;
    cost.peak_memory_bytes = used.peak_memory_bytes;
    cost.command = command_;
    cost.plan = std::move(plan);
    return cost;
}

Provenance Report::provenance(std::uint64_t seed, std::vector<InputId> inputs, std::string plan) const {
    Provenance provenance;
    provenance.stage = name_;
    provenance.command = command_;
    provenance.seed = seed;
    provenance.inputs = std::move(inputs);
    provenance.plan = std::move(plan);
    return provenance;
}

void Report::close(const std::string& counts) {
    const Usage used = usage();
    std::string text = fmt::format("done: {} in {} ({} CPU), peak memory {}", counts, duration_text(used.wall_s),
                                   duration_text(used.cpu_s), bytes_text(used.peak_memory_bytes));
    if (warnings() > 0) text += fmt::format(", {} warning{}", warnings(), warnings() == 1 ? "" : "s");
    log_line(Level::info, text);
}

Progress::Progress(Report& report, std::string what, std::uint64_t total)
    : report_(report),
      what_(std::move(what)),
      total_(std::max<std::uint64_t>(total, 1)),
      start_(std::chrono::steady_clock::now()),
      next_(report.quiet() ? UINT64_MAX : 1 + (total_ - 1) / (report.terminal_ ? 1000 : 10)) {}

Progress::~Progress() {
    const std::lock_guard lock(report_.mutex_);
    report_.rewrite_line("");
}

void Progress::show(std::uint64_t done) {
    std::unique_lock lock(report_.mutex_);
    if (done < next_.load(std::memory_order_relaxed)) return;  // another thread has just shown this progress
    const std::chrono::duration<double> elapsed = std::chrono::steady_clock::now() - start_;
    const double fraction = std::min(1.0, static_cast<double>(done) / static_cast<double>(total_));
    const std::string left = done < total_ ? duration_text(elapsed.count() * (1 - fraction) / fraction) + " left"
                                           : "took " + duration_text(elapsed.count());
    if (report_.terminal_) {
        // At most ten updates a second at any speed of the work.
        const double speed = static_cast<double>(done) / std::max(elapsed.count(), 1e-6);
        next_ = done + std::max<std::uint64_t>(1, static_cast<std::uint64_t>(0.1 * speed));
        report_.rewrite_line(fmt::format("{}: {} {:.1f} %, {}", report_.name_, what_, 100 * fraction, left));
    } else {
        const std::uint64_t tenth = std::min<std::uint64_t>(10, static_cast<std::uint64_t>(10 * fraction));
        // Smallest count that reaches the next tenth; nothing is printed after the last tenth.
        next_ = tenth == 10
                    ? UINT64_MAX
                    : static_cast<std::uint64_t>((static_cast<unsigned __int128>(total_) * (tenth + 1) + 9) / 10);
        report_.logger_->info("{} {} %, {}", what_, 10 * tenth, left);
    }
}

}  // namespace loom::app
