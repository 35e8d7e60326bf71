#pragma once
// Errors of the frames of an animation over time: whether noise flickers from frame to frame, or stands still.

#include <cstddef>
#include <cstdint>
#include <span>
#include <string>
#include <vector>

namespace loom::compare {

/// Sums over pairs of successive frames t, t + 1, over pixels and channels. With the error e = x - r, and the noise of
/// references with numbers of their own taken off where it is known:
///   error    mean of (e_t^2 + e_{t+1}^2) / 2 / (r^2 + 0.01),  r^2 the mean of both frames
///   flicker  mean of (e_{t+1} - e_t)^2 / 2 / (r^2 + 0.01)
///   frozen   1 - flicker / error: 0 for noise that is new in each frame, 1 for noise that stays
struct PairSums {
    double error = 0, flicker = 0, n = 0;

    void add(const PairSums& o) { error += o.error, flicker += o.flicker, n += o.n; }
    double mean_error() const { return error / n; }
    double mean_flicker() const { return flicker / n; }
    double frozen() const { return 1 - flicker / error; }
};

/// A frame, and what is between it and the next one (n = 0 for the last).
struct FrameErrors {
    std::uint64_t number = 0;
    double relmse = 0;
    PairSums all, still;  // still: pixels whose reference stays
};

/// One sequence of frames; frames are added in their order.
class SequenceErrors {
  public:
    /// in:      most_values  of which the spectrum is computed: evenly spaced pixels, so that they fit
    explicit SequenceErrors(std::string method, std::size_t n_frames, std::size_t most_values = std::size_t(1) << 26)
        : method_(std::move(method)), n_frames_(n_frames), most_values_(most_values) {}

    /// in:      x, r   [pixel, rgb];  var_r  of r, or empty: unknown
    void add(std::uint64_t number, std::span<const float> x, std::span<const float> r, std::span<const float> var_r);

    /// Number of values of a frame.
    std::size_t size() const { return e_.size(); }
    const std::string& method() const { return method_; }
    const std::vector<FrameErrors>& frames() const { return frames_; }
    /// Sums of all pairs.
    PairSums all() const;
    PairSums still() const;
    double relmse() const;

    /// Power of the error at k / F cycles per frame, k = 0 ... F / 2, by a Hann window, mean over pixels and channels; noise
    /// that is new in each frame has the same power, its relMSE, at all.
    ///   |sum_t w_t e_t exp(-2 pi i k t / F)|^2 / sum_t w_t^2 / (mean_t r_t^2 + 0.01)
    std::vector<double> spectrum() const;

  private:
    std::string method_;
    std::size_t n_frames_, most_values_, step_ = 1;
    std::vector<FrameErrors> frames_;
    std::vector<float> e_, r_, var_r_;       // of the frame before
    std::vector<float> series_, reference_;  // [frame, value] of each step-th pixel
};

struct Options;

/// Whether --sequence or --spectrum is asked for.
bool is_sequence(const Options& options);
/// Compares sequences: inputs and reference are names with a % for the number of a frame; the frames are those of the
/// reference. Returns the answer.
/// throws:  InputError when a frame is missing or does not fit
std::string compare_sequences(const Options& options);

}  // namespace loom::compare
