#include "stages/residual/dynamic_estimator.h"

#include <tbb/enumerable_thread_specific.h>

#include "stages/core/app/report.h"
#include "stages/core/transport/film.h"
#include "stages/core/transport/parallel.h"

namespace loom::residual {
namespace {

constexpr std::uint64_t samples_per_chunk = 1024, chunks_per_round = 64;

struct Splat {
    std::uint32_t pixel;
    Radiance value;
};

/// What one sample adds to the picture, a pixel once.
class Splats {
  public:
    void add(std::uint32_t pixel, const Radiance& value) {
        for (Splat& s : of_sample_)
            if (s.pixel == pixel) {
                s.value += value;
                return;
            }
        of_sample_.push_back({pixel, value});
    }
    void end_sample(std::vector<Splat>& out) {
        out.insert(out.end(), of_sample_.begin(), of_sample_.end());
        of_sample_.clear();
    }

  private:
    std::vector<Splat> of_sample_;
};

/// What a thread works with.
struct Worker {
    PathFinder in_new, in_old;
    PathMapper from_new, from_old;
    std::vector<Term> terms, partner_terms;
    Splats splats;
    std::uint64_t nonfinite = 0;
    Worker(const DynamicScenes& scenes, const PathOptions& path, const MappingLimits& limits)
        : in_new(scenes, scenes.new_scene, path), in_old(scenes, scenes.old_scene, path), from_new(scenes, true, limits), from_old(scenes, false, limits) {}
};

}  // namespace

std::vector<Family> families_of(const DynamicScenes& scenes) {
    using enum Technique;
    std::vector<Family> all;
    const auto at = [&](Site site) { return !scenes.at(site).empty(); };
    const bool n = at(Site::new_place), o = at(Site::old_place), r = at(Site::repainted);
    constexpr Technique none = path_tracing;
    if (n || o) {
        all.push_back({"dynamic-from-emitter", n ? dynamic_from_emitter : none, o ? dynamic_from_emitter : none, Site::new_place, Site::old_place});
        all.push_back({"dynamic-two-ends", n ? dynamic_two_ends : none, o ? dynamic_two_ends : none, Site::new_place, Site::old_place});
        all.push_back({"ghost-from-emitter", o ? ghost_from_emitter : none, n ? ghost_from_emitter : none, Site::old_place, Site::new_place});
        all.push_back({"ghost-two-ends", o ? ghost_two_ends : none, n ? ghost_two_ends : none, Site::old_place, Site::new_place});
    }
    if (n) all.push_back({"new-place-from-sensor", dynamic_from_sensor, ghost_from_sensor, Site::new_place, Site::new_place});
    if (o) all.push_back({"old-place-from-sensor", ghost_from_sensor, dynamic_from_sensor, Site::old_place, Site::old_place});
    if (r) {
        all.push_back({"repainted-from-emitter", dynamic_from_emitter, dynamic_from_emitter, Site::repainted, Site::repainted});
        all.push_back({"repainted-from-sensor", dynamic_from_sensor, dynamic_from_sensor, Site::repainted, Site::repainted});
        all.push_back({"repainted-two-ends", dynamic_two_ends, dynamic_two_ends, Site::repainted, Site::repainted});
    }
    all.push_back({"path-tracing", path_tracing, path_tracing, Site::new_place, Site::old_place});
    return all;
}

Image render_dynamic(const ScenePair& pair, const Edit& edit, const DynamicOptions& options, const PathOptions& path_options, const Work& work, app::Report& report,
                     DynamicCounts& counts) {
    const DynamicScenes scenes(pair.old_scene, pair.new_scene, edit);
    const Sensor& sensor = pair.new_scene.sensor;
    const std::vector<Family> families = families_of(scenes);
    const std::uint64_t n_pixels = sensor.n_pixels();
    PathOptions path = path_options;
    path.seed = seeds_of(Method::correlated, path.seed).new_scene;

    // Samples of each family, and what that makes of each technique in each scene.
    std::vector<std::uint64_t> n_samples;
    SampleCounts in_new, in_old;
    in_new.per_pixel = in_old.per_pixel = double(work.spp);
    for (std::size_t f = 0; f < families.size(); ++f) {
        const double share = f < options.shares.size() ? options.shares[f] : 1.0;
        const bool camera = f + 1 == families.size();
        n_samples.push_back(camera ? work.spp : std::uint64_t(std::llround(share * double(n_pixels * work.spp))));
        if (camera) continue;
        const Family& family = families[f];
        if (family.in_new != Technique::path_tracing) in_new.from_site[std::size_t(family.in_new) - 1][std::size_t(family.site_new)] = double(n_samples[f]);
        if (family.in_old != Technique::path_tracing) in_old.from_site[std::size_t(family.in_old) - 1][std::size_t(family.site_old)] = double(n_samples[f]);
    }

    tbb::enumerable_thread_specific<Worker> workers([&] { return Worker(scenes, path, options.limits); });
    const float r = sensor.filter_radius;

    /// Adds sign * weight * F(path) to the pixels that see it.
    const auto splat = [&](Worker& w, const Evaluation& e, Point2f film, double factor, double own, bool own_is_camera, std::int64_t only_pixel) {
        const auto one = [&](std::uint32_t x, std::uint32_t y) {
            const double h = sensor.filter_density(x, y, film);
            if (!(h > 0)) return;
            const double sum = options.weighted || options.only_family < 0 ? e.site_density + h * e.camera_density : own_is_camera ? h * own : own;
            w.splats.add(y * sensor.width + x, e.F * (factor * h / sum));
        };
        if (only_pixel >= 0) {
            const auto x = std::uint32_t(std::uint64_t(only_pixel) % sensor.width), y = std::uint32_t(std::uint64_t(only_pixel) / sensor.width);
            // Rounding must not lose a sample at the border of its own pixel.
            const float reach = r * (1 - 1e-6f);
            film = {clamp(film.x, float(x) + 0.5f - reach, float(x) + 0.5f + reach), clamp(film.y, float(y) + 0.5f - reach, float(y) + 0.5f + reach)};
            one(x, y);
            return;
        }
        const int x0 = std::max(int(std::floor(film.x - r - 0.5f)), 0), x1 = std::min(int(std::ceil(film.x + r - 0.5f)), int(sensor.width) - 1);
        const int y0 = std::max(int(std::floor(film.y - r - 0.5f)), 0), y1 = std::min(int(std::ceil(film.y + r - 0.5f)), int(sensor.height) - 1);
        for (int y = y0; y <= y1; ++y)
            for (int x = x0; x <= x1; ++x) one(std::uint32_t(x), std::uint32_t(y));
    };
    /// A path that was found in one of the scenes, with its partner.
    const auto add = [&](Worker& w, bool is_new, const FullPath& p, const Found& found, std::int64_t only_pixel) {
        const DynamicScene& side = is_new ? scenes.new_scene : scenes.old_scene;
        const DynamicScene& other = is_new ? scenes.old_scene : scenes.new_scene;
        w.terms.clear();
        const Evaluation e = evaluate(scenes, side, is_new ? in_new : in_old, path, p, &w.terms);
        if (!all_finite(e.F) || !std::isfinite(e.site_density + e.camera_density)) {
            ++w.nonfinite;
            return;
        }
        if (!(max_channel(e.F) > 0)) return;
        const auto own_of = [&](const std::vector<Term>& terms, const Evaluation& of, std::uint32_t place) {
            if (found.technique == Technique::path_tracing) return options.only_family >= 0 ? of.camera_density : found.by_next_event ? of.nee_density : of.camera_density - of.nee_density;
            for (const Term& t : terms)
                if (t.technique == found.technique && t.place == place) return t.density;
            return 0.0;
        };
        const double own = own_of(w.terms, e, found.place);
        if (!(own > 0)) return;  // a start that the path, worked out from its vertices, does not have
        const bool camera = found.technique == Technique::path_tracing;
        const double sign = is_new ? 1 : -1;
        if (options.mapping && options.only_family < 0) {
            Rejection why;
            PathMapper& mapper = is_new ? w.from_new : w.from_old;
            const MappedPath* q = mapper.map(p, found, why);
            if (q) {
                w.partner_terms.clear();
                const Evaluation partner = evaluate(scenes, other, is_new ? in_old : in_new, path, q->path, &w.partner_terms);
                const double rho = own_of(w.partner_terms, partner, found.place) / own * q->density_ratio;
                if (max_channel(partner.F) > 0 && rho > 0) {
                    splat(w, e, p.sensor.film, sign / (1 + rho), own, camera, only_pixel);
                    splat(w, partner, q->path.sensor.film, -sign * rho / (1 + rho), own, camera, only_pixel);
                    return;
                }
            }
        }
        splat(w, e, p.sensor.film, sign, own, camera, only_pixel);
    };

    std::vector<Radiance> sum(n_pixels), square(n_pixels), family_sum(n_pixels);
    app::Progress progress(report, "sampling", n_pixels * work.spp * families.size());
    for (std::size_t f = 0; f + 1 < families.size(); ++f) {
        if (options.only_family >= 0 && options.only_family != int(f)) continue;
        const Family& family = families[f];
        std::fill(family_sum.begin(), family_sum.end(), Radiance());
        const std::uint64_t first = n_samples[f] / work.spp * work.first_sample, family_seed = mix64(path.seed ^ (f + 1) * 0x9e3779b97f4a7c15ull);
        for (std::uint64_t round = 0; round < n_samples[f]; round += samples_per_chunk * chunks_per_round) {
            const std::uint64_t n = std::min(samples_per_chunk * chunks_per_round, n_samples[f] - round);
            std::vector<std::vector<Splat>> found(chunks_per_round);
            parallel_chunks(n, samples_per_chunk, work.threads, [&](std::uint64_t chunk, std::uint64_t begin, std::uint64_t end) {
                Worker& w = workers.local();
                for (std::uint64_t i = begin; i < end; ++i) {
                    const Sampler numbers(path.sampler, family_seed, 0, first + round + i);
                    if (family.in_new != Technique::path_tracing)
                        w.in_new.find(family.in_new, family.site_new, numbers, [&](const FullPath& p, const Found& by) { add(w, true, p, by, -1); });
                    if (family.in_old != Technique::path_tracing)
                        w.in_old.find(family.in_old, family.site_old, numbers, [&](const FullPath& p, const Found& by) { add(w, false, p, by, -1); });
                    w.splats.end_sample(found[chunk]);
                }
                progress.add(end - begin);
            });
            // In the order of the samples, so that sums do not depend on threads.
            for (const std::vector<Splat>& splats : found)
                for (const Splat& s : splats) {
                    family_sum[s.pixel] += s.value;
                    square[s.pixel] += s.value * s.value;
                }
        }
        for (std::uint64_t i = 0; i < n_pixels; ++i) {
            sum[i] += family_sum[i];
            square[i] = square[i] - family_sum[i] * family_sum[i] * (1.0 / double(std::max<std::uint64_t>(n_samples[f], 1)));
        }
    }

    Film film(sensor.width, sensor.height, work.spp);
    const bool cameras = options.only_family < 0 || options.only_family + 1 == int(families.size());
    parallel_chunks(n_pixels, 64, work.threads, [&](std::uint64_t, std::uint64_t begin, std::uint64_t end) {
        Worker& w = workers.local();
        std::vector<Splat> own;
        for (std::uint64_t pixel = begin; pixel < end; ++pixel) {
            PixelSums sums;
            for (std::uint64_t s = 0; s < work.spp; ++s) {
                const PathId id{pixel, work.first_sample + s};
                const Sampler numbers(path.sampler, path.seed, pixel, id.sample);
                own.clear();
                const bool touched = w.in_new.find_from_camera(id, numbers, [&](const FullPath& p, const Found& by) { add(w, true, p, by, std::int64_t(pixel)); });
                if (touched) w.in_old.find_from_camera(id, numbers, [&](const FullPath& p, const Found& by) { add(w, false, p, by, std::int64_t(pixel)); });
                w.splats.end_sample(own);
                sums.add(own.empty() || !cameras ? Spectrum() : Spectrum(own[0].value * double(work.spp)), w.in_new.first_hit);
            }
            film.set(pixel, sums);
        }
        progress.add((end - begin) * work.spp);
    });
    Image image = std::move(film).finish({});
    const char* const rgb[] = {"R", "G", "B"};
    for (int c = 0; c < 3; ++c) {
        const auto mean = image.add(rgb[c]);
        for (std::uint64_t i = 0; i < n_pixels; ++i) mean[i] = float(mean[i] + sum[i][c]);
        const auto var = image.add(std::string("VarMean.") + rgb[c]);
        for (std::uint64_t i = 0; i < n_pixels; ++i) var[i] = float(var[i] + std::max(square[i][c], 0.0));
    }
    for (const Worker& w : workers) {
        counts.counts.rays += w.in_new.n_rays + w.in_old.n_rays + w.from_new.n_rays + w.from_old.n_rays;
        counts.counts.vertices += w.in_new.n_vertices + w.in_old.n_vertices;
        counts.counts.nonfinite += w.nonfinite;
        counts.n_unrelocated += w.in_new.n_unrelocated + w.in_old.n_unrelocated;
    }
    return image;
}

}  // namespace loom::residual
