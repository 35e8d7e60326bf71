#include "stages/residual/frame_plan.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "stages/core/scene/build.h"
#include "stages/core/stats/moments.h"
#include "stages/residual/control/coverage.h"

namespace loom::residual {
namespace {

constexpr std::uint64_t samples_per_pixel = 4, most_pixels = 8192, least_pixels = 64;
constexpr std::size_t most_frames = 3;

/// Cost of path tracing over n_s + G n g + F n c paths, at equal variance.
double gain_of(const FramePilot& p, double spp, double still_spp, double n_frames, double n_graphs) {
    const double variance = p.still / still_spp + p.difference / spp;
    if (!(variance > 0)) return INFINITY;
    return n_frames * (p.fresh / variance) /
           (still_spp + n_graphs * FramePlan::graph * spp + n_frames * spp * p.cost());
}

double still_spp_of(const FramePilot& p, double spp, double n_frames, double n_graphs) {
    const double most = std::max(spp * n_frames, 2.0);  // what path tracing of all frames would have
    if (!(p.still > 0)) return 2;
    const double wanted =
        p.difference > 0 ? spp * std::sqrt((n_graphs * FramePlan::graph + n_frames * p.cost()) * p.still / p.difference)
                         : most;
    return std::clamp(std::round(wanted), 2.0, most);
}

std::vector<PathResult> trace(const Scene& scene, const PathOptions& path, const std::vector<PathId>& ids) {
    std::vector<PathResult> results(ids.size());
    PathBatch batch(scene, path);
    for (std::size_t i = 0; i < ids.size(); i += PathBatch::capacity) {
        const std::size_t n = std::min(PathBatch::capacity, ids.size() - i);
        batch.trace(std::span(ids).subspan(i, n), std::span(results).subspan(i, n));
    }
    return results;
}

/// Mean over pixels of the variance of value(i), the colour of path i, summed over channels.
template <class Value>
double mean_variance(std::size_t n_paths, Value&& value) {
    double sum = 0;
    for (std::size_t i = 0; i < n_paths; i += samples_per_pixel) {
        std::array<Moments, 3> L;
        for (std::size_t k = i; k < i + samples_per_pixel; ++k) {
            const Spectrum x = value(k);
            for (int c = 0; c < 3; ++c) L[std::size_t(c)].add(double(x[c]));
        }
        for (const Moments& m : L)
            if (std::isfinite(m.m2)) sum += m.var_sample();
    }
    return sum * samples_per_pixel / double(n_paths);
}

/// Multiplies weights by those of least variance of groups of pixels along the film, as ControlSums::fit() does, but for the
/// variance of the image.
void fit(const std::vector<PathResult>& before, const std::vector<PathResult>& after, std::vector<Spectrum>& alpha) {
    constexpr std::size_t group = 32 * samples_per_pixel;
    for (std::size_t begin = 0; begin < alpha.size(); begin += group) {
        const std::size_t end = std::min(begin + group, alpha.size());
        for (int c = 0; c < 3; ++c) {
            double of_old = 0, of_both = 0;
            for (std::size_t i = begin; i < end; i += samples_per_pixel) {
                PairMoments pairs;
                for (std::size_t k = i; k < i + samples_per_pixel; ++k)
                    pairs.add(double(before[k].L[c]), double(after[k].L[c]));
                of_old += double(alpha[i][c]) * pairs.of_before;
                of_both += pairs.of_both;
            }
            if (!(of_old > 0) || !std::isfinite(of_both)) continue;
            const auto weight = float(best_control_weight(0, of_old, of_both));
            for (std::size_t i = begin; i < end; ++i) alpha[i][c] *= weight;
        }
    }
}

}  // namespace

FramePlan::FramePlan(const FramePilot& pilot, std::uint64_t spp, std::uint64_t n_frames, std::uint64_t n_graphs) {
    const double n = double(spp), graphs = double(n_graphs);
    const auto gain_at = [&](double f) { return gain_of(pilot, n, still_spp_of(pilot, n, f, graphs), f, graphs); };
    still_spp = std::uint64_t(still_spp_of(pilot, n, double(n_frames), graphs));
    gain = gain_at(double(n_frames));
    // The gain grows with the number of frames.
    std::uint64_t low = 0, high = 1'000'000;
    if (!(gain_at(double(high)) >= 1)) return;
    while (high - low > 1) {
        const std::uint64_t middle = (low + high) / 2;
        (gain_at(double(middle)) >= 1 ? high : low) = middle;
    }
    break_even = high;
}

FramePilot look_at_frames(const Animation& animation, const std::shared_ptr<const Scene>& still,
                          const std::vector<Frames::Frame>& frames, const PathOptions& path, std::uint64_t spp) {
    // Choose pixels, and frames in the middle of equal parts.
    const std::uint64_t n_pixels = still->sensor.n_pixels();
    const std::size_t n_frames = std::min(most_frames, frames.size());
    const double most_paths = double(n_pixels) * double(spp) * double(frames.size()) / 25;
    const auto wanted = std::uint64_t(most_paths / double(samples_per_pixel * (n_frames + 1)));
    const std::uint64_t n = std::min(std::clamp(wanted, least_pixels, most_pixels), n_pixels);
    std::vector<PathId> ids;
    for (std::uint64_t k = 0; k < n; ++k) {
        const double at = (double(k) + streams::selection(path.seed, k)) / double(n);
        for (std::uint64_t sample = 0; sample < samples_per_pixel; ++sample)
            ids.push_back({std::min(std::uint64_t(at * double(n_pixels)), n_pixels - 1), sample});
    }

    // Trace them in both scenes.
    FramePilot pilot;
    bool any_light = false, any_shape = false;
    const std::vector<PathResult> before = trace(*still, path, ids);
    const auto images = std::make_shared<TextureCache>();
    for (std::size_t k = 0; k < n_frames; ++k) {
        const Frames::Frame& frame = frames[(2 * k + 1) * frames.size() / (2 * n_frames)];
        SceneDescription description = animation.frames[frame.row];
        const Edit edit = find_edit(animation.still, description);
        KnownParts known = known_parts(still, edit);
        known.images = images;
        const auto now = build_scene(std::move(description), known);
        const EditReach reach(*still, *now, edit);
        const bool all = !reach.everything.empty();
        any_light |= reach.any_emitter && !all;
        any_shape |= all || edit.n_dynamic() + edit.n_ghosts() + edit.n_repainted() > 0;
        const std::optional<ControlSums> control =
            still->nlos ? std::nullopt : graph_control({*still, *now}, reach, path.seed, 1);
        const std::vector<PathResult> after = trace(*now, path, ids);
        std::vector<Spectrum> alpha(ids.size(), Spectrum(1));
        if (control)
            for (std::size_t i = 0; i < ids.size(); ++i) alpha[i] = control->alpha[ids[i].pixel];
        if (control && control->fits) fit(before, after, alpha);
        const auto difference = [&](std::size_t i) { return after[i].L - alpha[i] * before[i].L; };
        pilot.still +=
            mean_variance(ids.size(), [&](std::size_t i) { return alpha[i] * before[i].L; }) / double(n_frames);
        pilot.fresh += mean_variance(ids.size(), [&](std::size_t i) { return after[i].L; }) / double(n_frames);
        pilot.difference += mean_variance(ids.size(), difference) / double(n_frames);
        for (std::size_t i = 0; i < ids.size(); ++i)
            pilot.touched += (!(after[i].L == before[i].L) || after[i].n_vertices != before[i].n_vertices) /
                             double(ids.size() * n_frames);
    }
    // Lights that move touch nearly all paths, most of them by light samples alone.
    pilot.again = any_light ? 1.2 : any_shape ? 2 : 0.7;
    return pilot;
}

}  // namespace loom::residual
