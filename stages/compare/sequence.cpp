#include "stages/compare/sequence.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <map>
#include <numbers>
#include <optional>

#include "formats/io/error.h"
#include "stages/compare/compare.h"
#include "stages/compare/inputs.h"
#include "stages/core/app/values.h"

namespace loom::compare {
namespace {

namespace fs = std::filesystem;

double squared(double x) {
    return x * x;
}

}  // namespace

void SequenceErrors::add(std::uint64_t number, std::span<const float> x, std::span<const float> r,
                         std::span<const float> var_r) {
    std::vector<float> e(x.size());
    for (std::size_t i = 0; i < x.size(); ++i) e[i] = x[i] - r[i];
    const FrameErrors frame{number, mean_squared_relative(x, r), {}, {}};
    // What lies between the frame before and this one belongs to that.
    if (!frames_.empty()) {
        FrameErrors& before = frames_.back();
        const bool knows_noise = !var_r.empty() && !var_r_.empty();
        for (std::size_t pixel = 0; 3 * pixel < x.size(); ++pixel) {
            PairSums sums;
            bool still = true;
            for (std::size_t i = 3 * pixel; i < 3 * pixel + 3; ++i) {
                const double r0 = double(r_[i]), r1 = double(r[i]), e0 = double(e_[i]), e1 = double(e[i]),
                             scale = 0.5 * (r0 * r0 + r1 * r1) + relative_floor,
                             noise = knows_noise ? double(var_r_[i]) + double(var_r[i]) : 0;
                sums.error += (e0 * e0 + e1 * e1 - noise) / (2 * scale);
                sums.flicker += (squared(e1 - e0) - noise) / (2 * scale);
                sums.n += 1;
                // A hundredth is seen by nobody; of a reference with noise no less than that can be told.
                constexpr double unseen = 0.01;
                still &= std::abs(r1 - r0) <= unseen * (0.5 * std::abs(r0 + r1) + unseen) + 2 * std::sqrt(noise);
            }
            before.all.add(sums);
            if (still) before.still.add(sums);
        }
    }
    if (frames_.empty()) {
        step_ = std::max<std::size_t>(1, (x.size() * n_frames_ + most_values_ - 1) / most_values_);
        series_.reserve(n_frames_ * (x.size() / step_ + 3));
        reference_.reserve(series_.capacity());
    }
    for (std::size_t i = 0; i < x.size(); i += 3 * step_) {
        series_.insert(series_.end(), e.begin() + std::ptrdiff_t(i), e.begin() + std::ptrdiff_t(i) + 3);
        reference_.insert(reference_.end(), r.begin() + std::ptrdiff_t(i), r.begin() + std::ptrdiff_t(i) + 3);
    }
    frames_.push_back(frame);
    e_ = std::move(e);
    r_.assign(r.begin(), r.end());
    var_r_.assign(var_r.begin(), var_r.end());
}

PairSums SequenceErrors::all() const {
    PairSums sums;
    for (const FrameErrors& frame : frames_) sums.add(frame.all);
    return sums;
}
PairSums SequenceErrors::still() const {
    PairSums sums;
    for (const FrameErrors& frame : frames_) sums.add(frame.still);
    return sums;
}
double SequenceErrors::relmse() const {
    double sum = 0;
    for (const FrameErrors& frame : frames_) sum += frame.relmse / double(frames_.size());
    return sum;
}

std::vector<double> SequenceErrors::spectrum() const {
    const std::size_t n = frames_.size(), n_values = n > 0 ? series_.size() / n : 0;
    if (n < 2) return {};
    std::vector<double> window(n);
    double norm = 0;
    for (std::size_t t = 0; t < n; ++t) {
        window[t] = squared(std::sin(std::numbers::pi * (double(t) + 0.5) / double(n)));
        norm += squared(window[t]);
    }
    std::vector<double> power(n / 2 + 1);
    for (std::size_t i = 0; i < n_values; ++i) {
        double scale = relative_floor;
        for (std::size_t t = 0; t < n; ++t) scale += squared(double(reference_[t * n_values + i])) / double(n);
        for (std::size_t k = 0; k < power.size(); ++k) {
            double re = 0, im = 0;
            for (std::size_t t = 0; t < n; ++t) {
                const double phase = 2 * std::numbers::pi * double(k * t % n) / double(n),
                             e = window[t] * double(series_[t * n_values + i]);
                re += e * std::cos(phase), im += e * std::sin(phase);
            }
            power[k] += (re * re + im * im) / (norm * scale * double(n_values));
        }
    }
    return power;
}

bool is_sequence(const Options& options) {
    return options.sequence || options.spectrum;
}

namespace {

std::string number_text(double x) {
    return std::isnan(x) ? "nan" : fmt::format("{:.4g}", x);
}

std::string spectrum_of(const std::vector<SequenceErrors>& sequences) {
    std::string text = "method\tfrequency\tpower\n";
    for (const SequenceErrors& sequence : sequences) {
        const std::vector<double> power = sequence.spectrum();
        for (std::size_t k = 0; k < power.size(); ++k)
            text += fmt::format("{}\t{:.6g}\t{:.6g}\n", sequence.method(), double(k) / double(sequence.frames().size()),
                                power[k]);
    }
    return text;
}
std::string frames_of(const std::vector<SequenceErrors>& sequences) {
    std::string text = "method\tframe\trelmse\tflicker\tfrozen\tstill\terror_still\tflicker_still\tfrozen_still\n";
    for (const SequenceErrors& sequence : sequences)
        for (const FrameErrors& f : sequence.frames())
            text += fmt::format("{}\t{}\t{}\t{}\t{}\t{}\t{}\t{}\t{}\n", sequence.method(), f.number,
                                number_text(f.relmse), number_text(f.all.mean_flicker()), number_text(f.all.frozen()),
                                number_text(f.still.n / f.all.n), number_text(f.still.mean_error()),
                                number_text(f.still.mean_flicker()), number_text(f.still.frozen()));
    return text;
}
std::string summary_of(const std::vector<SequenceErrors>& sequences) {
    std::size_t width = 6;
    for (const SequenceErrors& s : sequences) width = std::max(width, s.method().size());
    std::string text = fmt::format("{:{}}  frames     relmse    flicker  frozen  still  error there  flicker  frozen\n",
                                   "method", width);
    for (const SequenceErrors& s : sequences) {
        const PairSums all = s.all(), still = s.still();
        text += fmt::format("{:{}}  {:6}  {:9}  {:9}  {:6.2f}  {:4.0f} %  {:11}  {:7}  {:6.2f}\n", s.method(), width,
                            s.frames().size(), number_text(s.relmse()), number_text(all.mean_flicker()), all.frozen(),
                            100 * still.n / all.n, number_text(still.mean_error()), number_text(still.mean_flicker()),
                            still.frozen());
    }
    return text;
}

}  // namespace

std::string compare_sequences(const Options& options) {
    if (options.json || options.cost || !options.difference.empty() || !options.parameter.empty() ||
        !options.reference_variance.empty() || !options.fail_above.empty() || !options.fail_below.empty())
        throw InputError("--sequence, --spectrum: allow no other options than --reference, --scene and --tsv");
    if (options.reference.empty()) throw InputError("--reference: missing; a sequence, with a % in its name");
    const std::map<std::uint64_t, std::string> references = files_of_sequence(options.reference);
    if (references.size() < 2) throw InputError(fmt::format("{}: one frame is no sequence", options.reference));
    std::vector<SequenceErrors> sequences;
    std::vector<std::map<std::uint64_t, std::string>> files;
    for (const Input& input : inputs_of(options.inputs)) {
        files.push_back(files_of_sequence(input.file));
        sequences.emplace_back(input.label, references.size());
        for (const auto& [number, reference] : references)
            if (!files.back().contains(number))
                throw InputError(fmt::format("{}: has no frame {}, as {}", input.file, number, reference));
    }
    for (const auto& [number, file] : references) {
        const NoisyImage reference = read_noisy_image(file);
        for (std::size_t i = 0; i < sequences.size(); ++i) {
            const std::string& name = files[i].at(number);
            const NoisyImage frame = read_noisy_image(name);
            if (frame.width != reference.width || frame.height != reference.height)
                throw InputError(fmt::format("{}: is {} x {}, but {} is {} x {}", name, frame.width, frame.height, file,
                                             reference.width, reference.height));
            if (!sequences[i].frames().empty() && frame.rgb.size() != sequences[i].size())
                throw InputError(fmt::format("{}: has another size than the frames before", name));
            sequences[i].add(number, frame.rgb, reference.rgb, reference.var_mean);
        }
    }
    return options.spectrum ? spectrum_of(sequences) : options.tsv ? frames_of(sequences) : summary_of(sequences);
}

}  // namespace loom::compare
