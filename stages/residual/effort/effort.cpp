#include "stages/residual/effort/effort.h"

#include <fmt/format.h>
#include <tbb/enumerable_thread_specific.h>

#include <numeric>

#include "stages/core/compute/parallel.h"
#include "stages/core/sampling/streams.h"
#include "stages/core/stats/moments.h"
#include "stages/residual/control/blur.h"
#include "stages/residual/dynamic/camera_paths.h"
#include "stages/residual/effort/effort_model.h"

namespace loom::residual {
namespace {

/// Cost of a ray of dynamic paths, sampled one by one, over that of a ray in a batch of camera paths, with all
/// computations.
constexpr double cost_of_site_ray = 3.2;
/// Half of the paths are spread evenly: a pixel whose pilot found nothing has at most twice the variance. A quarter, as
/// in [001], trusts few samples too much (equal or more variance in ten of twelve edits).
constexpr double share_of_map_floor = 0.5;
constexpr std::uint64_t most_recorded_pixels = 4096, recorded_one_in = 8, most_pilot_samples = 1 << 15;
/// Smallest number of recorded, touched camera paths from which their noise can be estimated.
constexpr std::uint64_t few_recorded = 64;
/// Smallest share of the effort for camera paths: they find contributions that no other sample of the pilot finds.
constexpr double least_share_of_cameras = 0.5;

/// Moments of pairs of camera paths: of the difference and of the old path.
struct PairMoments {
    Moments difference, old;
    double product = 0;  // sum of products of deviations from the means
    void add(double d, double f) {
        const double off = d - difference.mean;
        difference.add(d);
        old.add(f);
        product += off * (f - old.mean);
    }
    double covariance() const { return old.n > 1 ? product / double(old.n - 1) : 0; }
};

/// Distribution of camera paths over pixels.
struct Map {
    std::vector<double> density;  // [pixel] relative to an even distribution of equal cost
    double gain = 1;              // variance with the even distribution over that with this one
};

/// in: variances, costs  of one path, [pixel]
Map map_of(const Sensor& sensor, const std::vector<double>& variances, const std::vector<double>& costs) {
    std::vector<double> deviations(variances.size());
    std::transform(variances.begin(), variances.end(), deviations.begin(), [](double v) { return std::sqrt(v); });
    deviations = blurred(sensor, deviations);
    double all_costs = 0, wanted_costs = 0, flat = 0, spread = 0;
    for (std::size_t p = 0; p < deviations.size(); ++p) {
        all_costs += costs[p];
        wanted_costs += costs[p] * deviations[p];
    }
    Map map;
    for (const double deviation : deviations) {
        map.density.push_back(wanted_costs > 0
                                  ? share_of_map_floor + (1 - share_of_map_floor) * deviation * all_costs / wanted_costs
                                  : 1);
        flat += sqr(deviation);
        spread += sqr(deviation) / map.density.back();
    }
    if (spread > 0) map.gain = flat / spread;
    return map;
}

/// Returns the camera paths of each pixel, n in the mean. At least two, which VarMean requires.
std::vector<std::uint32_t> rounded(const Map& map, double n) {
    std::vector<std::uint32_t> out;
    double carried = 0.5;  // remainder of the rounding
    for (const double density : map.density) {
        carried += n * density;
        const double taken = std::max(std::floor(carried), 2.0);
        out.push_back(std::uint32_t(taken));
        carried = std::max(carried - taken, 0.0);
    }
    return out;
}

/// State of one thread.
struct PilotWorker {
    PathPairs pairs;
    CameraPaths cameras;
    NumbersBlock numbers;
    std::vector<PilotPart> parts;  // of the current sample, and their pixels
    std::vector<std::uint32_t> pixels;

    /// in: K  number of families
    ///     n0  camera paths of a recorded pixel
    void keep(const Part& part, std::size_t K, double n0) {
        PilotPart kept{};
        const double camera = n0 * part.h * part.density.camera_density, density = part.density.site_density + camera;
        for (const Term& t : part.terms)
            if (t.technique != Technique::path_tracing) kept.w[t.family] += float(t.density / density);
        kept.w[K - 1] = float(camera / density);
        for (int c = 0; c < 3; ++c) kept.v[c] = float(part.value[c] / density);
        kept.at_first = part.at_first;
        parts.push_back(kept);
        pixels.push_back(part.pixel);
    }
};

/// Traces the samples of a pilot.
class PilotRun {
  public:
    Pilot pilot;
    const std::uint64_t per_family, per_pixel;  // samples of each family; camera paths of each pixel, for the map
    std::vector<double> variances, costs;       // [pixel] of one pair: variance of its difference, and rays
    std::vector<double> covariance[3], old_variance[3];  // as in Effort
    // Over one camera path in every pixel: rays of the new path, rays of both paths, and number of touched paths.
    double new_rays = 0, pair_rays = 0, touched = 0;
    double recording = 0;          // cost of evaluating the densities of camera paths
    std::uint64_t n_recorded = 0;  // pixels whose camera paths are recorded

    PilotRun(const DynamicScenes& scenes, const std::vector<Family>& families, const PathPairs::Options& pairs,
             const PathOptions& path, const tracing::Work& work)
        : per_family(std::clamp<std::uint64_t>(scenes.new_scene.scene.sensor.n_pixels() * work.spp / 1024, 256,
                                               most_pilot_samples)),
          per_pixel(std::max<std::uint64_t>(work.spp / 32, 2)),
          n_pixels_(scenes.new_scene.scene.sensor.n_pixels()),
          K_(families.size()),
          threads_(work.threads),
          path_(path),
          samples_(K_, double(per_family)),
          workers_([&scenes, &families, &pairs, this] {
              return PilotWorker{
                  PathPairs(scenes, families, samples_, false, path_, pairs), CameraPaths(scenes, path_), {}, {}, {}};
          }) {
        pilot.families.resize(K_);
        pilot.cost.assign(K_, 0);
        for (std::size_t f = 0; f + 1 < K_; ++f) sample_site(f);
        sample_pixels();
    }

    void count(tracing::Counts& counts) const {
        for (const PilotWorker& w : workers_) {
            counts.add(w.cameras.counts_new);
            counts.add(w.cameras.counts_old);
            counts.add({w.pairs.rays(), w.pairs.vertices(), w.pairs.nonfinite});
        }
    }

  private:
    double rays_of_pairs() const {
        std::uint64_t sum = 0;
        for (const PilotWorker& w : workers_) sum += w.pairs.rays();
        return double(sum);
    }
    /// Calls body(worker, samples of the chunk, begin, end).
    template <class Body>
    void record(std::uint64_t n, std::uint64_t chunk_size, PilotSamples& all, Body&& body) {
        std::vector<PilotSamples> chunks((n + chunk_size - 1) / chunk_size);
        parallel_chunks(n, chunk_size, threads_, [&](std::uint64_t chunk, std::uint64_t begin, std::uint64_t end) {
            body(workers_.local(), chunks[chunk], begin, end);
        });
        for (const PilotSamples& r : chunks) all.append(r);
    }

    void sample_site(std::size_t f) {
        const std::uint64_t seed = streams::family(path_.seed, f);
        const double before = rays_of_pairs();
        record(per_family, 128, pilot.families[f],
               [&](PilotWorker& w, PilotSamples& out, std::uint64_t begin, std::uint64_t end) {
                   for (std::uint64_t i = begin; i < end; ++i) {
                       w.pairs.from_site(f, w.numbers.of(path_.sampler, seed, i),
                                         [&](const Part& part) { w.keep(part, K_, double(pilot.per_pixel)); });
                       out.end_sample(w.parts, w.pixels);
                   }
               });
        pilot.cost[f] = cost_of_site_ray * (rays_of_pairs() - before);
    }

    /// Traces pairs in all pixels for the map; in some pixels also evaluates the densities of all families.
    void sample_pixels() {
        const std::uint64_t one_in = std::max(recorded_one_in, n_pixels_ / most_recorded_pixels);
        const auto is_recorded = [&](std::uint64_t pixel) { return K_ > 1 && mix64(pixel) % one_in == 0; };
        for (std::uint64_t pixel = 0; pixel < n_pixels_; ++pixel) n_recorded += is_recorded(pixel);
        for (auto* by_pixel : {&variances, &costs}) by_pixel->resize(n_pixels_);
        for (int c = 0; c < 3; ++c)
            for (auto* by_pixel : {&covariance[c], &old_variance[c]}) by_pixel->resize(n_pixels_);
        const double before = rays_of_pairs();
        record(n_pixels_, 64, pilot.families[K_ - 1],
               [&](PilotWorker& w, PilotSamples& out, std::uint64_t begin, std::uint64_t end) {
                   std::vector<PathId> ids;
                   for (std::uint64_t pixel = begin; pixel < end; ++pixel)
                       for (std::uint64_t s = 0; s < per_pixel; ++s) ids.push_back({pixel, s});
                   std::vector<PairMoments> moments(3 * (end - begin));
                   for (std::size_t k = 0; k < ids.size(); k += PathBatch::capacity) {
                       const std::span<const PathId> some{&ids[k], std::min(PathBatch::capacity, ids.size() - k)};
                       w.cameras.trace(some);
                       for (std::size_t i = 0; i < some.size(); ++i) {
                           const PathId id = some[i];
                           const Spectrum difference = w.cameras.difference(i), L_new = w.cameras.L_new(i);
                           costs[id.pixel] += double(w.cameras.rays(i)) / double(per_pixel);
                           if (!all_finite(difference) || !all_finite(L_new)) continue;
                           for (int c = 0; c < 3; ++c)
                               moments[3 * (id.pixel - begin) + std::size_t(c)].add(difference[c],
                                                                                    L_new[c] - difference[c]);
                           if (!w.cameras.touched(i) || id.sample >= pilot.per_pixel || !is_recorded(id.pixel))
                               continue;
                           w.pairs.from_camera(id, Sampler(path_.sampler, path_.seed, id.pixel, id.sample),
                                               [&](const Part& part) { w.keep(part, K_, double(pilot.per_pixel)); });
                           out.end_sample(w.parts, w.pixels);
                       }
                   }
                   for (std::uint64_t pixel = begin; pixel < end; ++pixel)
                       for (std::size_t c = 0; c < 3; ++c) {
                           const PairMoments& m = moments[3 * (pixel - begin) + c];
                           variances[pixel] += m.difference.var_sample() / 3;
                           covariance[c][pixel] = m.covariance();
                           old_variance[c][pixel] = m.old.var_sample();
                       }
               });
        recording = cost_of_site_ray * (rays_of_pairs() - before);
        for (const PilotWorker& w : workers_) {
            new_rays += double(w.cameras.counts_new.rays) / double(per_pixel);
            pair_rays += double(w.cameras.counts_new.rays + w.cameras.counts_old.rays) / double(per_pixel);
            touched += double(w.cameras.n_touched) / double(n_pixels_ * per_pixel);
        }
        pilot.camera_scale = double(n_pixels_) / double(std::max<std::uint64_t>(n_recorded, 1));
        pilot.cost[K_ - 1] = double(pilot.per_pixel) * new_rays + recording * pilot.camera_scale;
    }

    const std::uint64_t n_pixels_;
    const std::size_t K_;
    const int threads_;
    const PathOptions path_;
    const std::vector<double> samples_;
    tbb::enumerable_thread_specific<PilotWorker> workers_;
};

}  // namespace

bool Effort::cameras_alone() const {
    return std::all_of(samples.begin(), samples.end() - 1, [](double n) { return n == 0; });
}

Effort equal_effort(const std::vector<Family>& families, const Sensor& sensor, std::uint64_t spp) {
    Effort effort;
    effort.samples.assign(families.size(), double(sensor.n_pixels() * spp));
    effort.per_pixel.assign(sensor.n_pixels(), std::uint32_t(spp));
    return effort;
}

Effort camera_effort(const std::vector<Family>& families, const Sensor& sensor, std::uint64_t spp) {
    Effort effort = equal_effort(families, sensor, spp);
    std::fill(effort.samples.begin(), effort.samples.end(), 0.0);
    return effort;
}

Effort effort_by_pilot(const DynamicScenes& scenes, const std::vector<Family>& families, const PilotOptions& options,
                       const PathOptions& path, const tracing::Work& work, tracing::Counts& counts) {
    const Sensor& sensor = scenes.new_scene.scene.sensor;
    const std::size_t K = families.size();
    PilotRun run(scenes, families, options.pairs, path, work);
    run.count(counts);
    const Pilot& pilot = run.pilot;
    const double n0 = double(pilot.per_pixel);
    // Cost of spp plain pairs without the cost of the pilot.
    const double whole = 2 * run.new_rays * double(work.spp);
    const double taken = double(run.per_pixel) * run.pair_rays + run.recording +
                         std::accumulate(pilot.cost.begin(), pilot.cost.end() - 1, 0.0);
    const double budget = std::max(whole - taken, 0.25 * whole);

    const Map map = options.adaptive_map ? map_of(sensor, run.variances, run.costs)
                                         : Map{std::vector<double>(sensor.n_pixels(), 1.0), 1};
    Spending best;
    best.x.assign(K, 0);
    best.x[K - 1] = budget / (n0 * run.pair_rays);
    double M_alone = 0;
    if (run.n_recorded > 0) {
        const bool hardly_met = pilot.families[K - 1].groups().size() < few_recorded;
        M_alone = (hardly_met ? camera_variance_by_all(pilot, best.x[K - 1]) : variance_of(pilot, false, best.x).M) /
                  map.gain;
        const double least_cameras = hardly_met ? least_share_of_cameras / 2 : least_share_of_cameras;
        Spending with = best_spending(pilot, false, budget, map.gain, least_cameras);
        if (Spending first = best_spending(pilot, true, budget, map.gain, least_cameras);
            !hardly_met && first.M < with.M)
            with = std::move(first);
        // Variance of pairs in all pixels beyond that of the recorded pixels is attributed to contributions that only
        // camera paths find.
        const double of_all =
            std::accumulate(run.variances.begin(), run.variances.end(), 0.0) / (n0 * best.x[K - 1] * map.gain);
        const double unseen = hardly_met ? 0 : std::max(of_all - M_alone, 0.0);
        M_alone += unseen;
        with.M += unseen * best.x[K - 1] / with.x[K - 1];
        if (with.M * options.must_gain < M_alone) best = std::move(with);
    }
    Effort effort;
    effort.first_to_camera = best.first_to_camera;
    effort.samples.assign(K, 0);
    for (std::size_t f = 0; f + 1 < K; ++f) effort.samples[f] = std::floor(best.x[f] * double(run.per_family));
    effort.per_pixel = rounded(map, best.x[K - 1] * n0);
    for (int c = 0; c < 3; ++c) {
        effort.covariance[c] = std::move(run.covariance[c]);
        effort.old_variance[c] = std::move(run.old_variance[c]);
    }

    const auto [fewest, most] = std::minmax_element(effort.per_pixel.begin(), effort.per_pixel.end());
    effort.why = fmt::format(
        "pilot ({:.0f} % of the effort): the edit touches {:.0f} % of camera paths; {:.1f} per pixel ({} to {})",
        100 * taken / whole, 100 * run.touched, best.x[K - 1] * n0, *fewest, *most);
    if (options.adaptive_map) effort.why += fmt::format(", {:.1f} times less variance than evenly", map.gain);
    if (!effort.cameras_alone()) {
        for (std::size_t f = 0; f + 1 < K; ++f)
            if (effort.samples[f] > 0)
                effort.why += fmt::format(", {} {:.0f} %", families[f].name, 100 * best.x[f] * pilot.cost[f] / budget);
        effort.why += fmt::format("{}: {:.1f} times less variance than camera paths alone",
                                  best.first_to_camera ? ", none of what is directly visible" : "", M_alone / best.M);
    } else if (K > 1) {
        effort.why += "; paths from the edit do not pay";
    }
    return effort;
}

}  // namespace loom::residual
