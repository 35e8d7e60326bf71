#include "stages/residual/dynamic/path_pairs.h"

namespace loom::residual {

std::vector<Family> families_of(const DynamicScenes& scenes) {
    using enum Technique;
    std::vector<Family> all;
    const auto at = [&](Site site) { return !scenes.at(site).empty(); };
    const bool n = at(Site::new_place), o = at(Site::old_place), r = scenes.at(Site::repainted).scatters();
    const bool n_scatters = scenes.at(Site::new_place).scatters(), o_scatters = scenes.at(Site::old_place).scatters();
    constexpr Technique none = path_tracing;
    if (n_scatters || o_scatters) {
        all.push_back({"dynamic-from-emitter", n_scatters ? dynamic_from_emitter : none,
                       o_scatters ? dynamic_from_emitter : none, Site::new_place, Site::old_place});
        all.push_back({"dynamic-two-ends", n_scatters ? dynamic_two_ends : none, o_scatters ? dynamic_two_ends : none,
                       Site::new_place, Site::old_place});
    }
    if (n || o) {
        all.push_back({"ghost-from-emitter", o ? ghost_from_emitter : none, n ? ghost_from_emitter : none,
                       Site::old_place, Site::new_place});
        all.push_back(
            {"ghost-two-ends", o ? ghost_two_ends : none, n ? ghost_two_ends : none, Site::old_place, Site::new_place});
    }
    if (n)
        all.push_back({"new-place-from-sensor", n_scatters ? dynamic_from_sensor : none, ghost_from_sensor,
                       Site::new_place, Site::new_place});
    if (o)
        all.push_back({"old-place-from-sensor", ghost_from_sensor, o_scatters ? dynamic_from_sensor : none,
                       Site::old_place, Site::old_place});
    if (r) {
        all.push_back(
            {"repainted-from-emitter", dynamic_from_emitter, dynamic_from_emitter, Site::repainted, Site::repainted});
        all.push_back(
            {"repainted-from-sensor", dynamic_from_sensor, dynamic_from_sensor, Site::repainted, Site::repainted});
        all.push_back({"repainted-two-ends", dynamic_two_ends, dynamic_two_ends, Site::repainted, Site::repainted});
    }
    all.push_back({"path-tracing", path_tracing, path_tracing, Site::new_place, Site::old_place});
    return all;
}

PathPairs::PathPairs(const DynamicScenes& scenes, const std::vector<Family>& families,
                     const std::vector<double>& samples, bool first_to_camera, const PathOptions& path,
                     const Options& options)
    : scenes_(scenes),
      families_(families),
      path_(path),
      options_(options),
      in_new_(scenes, scenes.new_scene, path),
      in_old_(scenes, scenes.old_scene, path),
      from_new_(scenes, true, options.limits),
      from_old_(scenes, false, options.limits) {
    counts_new_.first_to_camera = counts_old_.first_to_camera = first_to_camera;
    for (std::size_t f = 0; f + 1 < families.size(); ++f) {
        const Family& family = families[f];
        if (family.in_new != Technique::path_tracing)
            counts_new_.of(family.in_new, family.site_new) = {samples[f], std::uint8_t(f)};
        if (family.in_old != Technique::path_tracing)
            counts_old_.of(family.in_old, family.site_old) = {samples[f], std::uint8_t(f)};
    }
}

void PathPairs::from_site(std::size_t f, const Numbers& numbers, const Sink& sink) {
    const Family& family = families_[f];
    from_new_.start_sample();
    from_old_.start_sample();
    if (family.in_new != Technique::path_tracing)
        in_new_.find(family.in_new, family.site_new, numbers,
                     [&](const FullPath& p, const Found& by) { add(true, p, by, -1, sink); });
    if (family.in_old != Technique::path_tracing)
        in_old_.find(family.in_old, family.site_old, numbers,
                     [&](const FullPath& p, const Found& by) { add(false, p, by, -1, sink); });
}

bool PathPairs::from_camera(PathId id, const Sampler& numbers, const Sink& sink) {
    const auto pixel = std::int64_t(id.pixel);
    from_new_.start_sample();
    from_old_.start_sample();
    const bool touched = in_new_.find_from_camera(
        id, numbers, [&](const FullPath& p, const Found& by) { add(true, p, by, pixel, sink); });
    if (touched)
        in_old_.find_from_camera(id, numbers,
                                 [&](const FullPath& p, const Found& by) { add(false, p, by, pixel, sink); });
    return touched;
}

double PathPairs::own_density(const std::vector<Term>& terms, const Evaluation& of, const Found& found,
                              std::uint32_t place) const {
    if (found.technique == Technique::path_tracing)
        return found.by_next_event ? of.nee_density : of.camera_density - of.nee_density;
    for (const Term& t : terms)
        if (t.technique == found.technique && t.place == place) return t.density;
    return 0;
}

void PathPairs::add(bool is_new, const FullPath& p, const Found& found, std::int64_t only_pixel, const Sink& sink) {
    const DynamicScene &side = is_new ? scenes_.new_scene : scenes_.old_scene,
                       &other = is_new ? scenes_.old_scene : scenes_.new_scene;
    terms_.clear();
    const Evaluation e = evaluate(scenes_, side, is_new ? counts_new_ : counts_old_, path_, p, &terms_);
    if (!all_finite(e.F) || !std::isfinite(e.site_density + e.camera_density)) {
        ++nonfinite;
        return;
    }
    if (!(max_channel(e.F) > 0)) return;
    const double own = own_density(terms_, e, found, found.place);
    if (!(own > 0)) return;  // the path evaluated from its vertices has no such start; or it is left to camera paths
    const bool camera = found.technique == Technique::path_tracing;
    const double sign = is_new ? 1 : -1;
    if (options_.mapping) {
        Rejection why;
        const MappedPath* q = (is_new ? from_new_ : from_old_).map(p, found, why);
        if (options_.as_printed && q && q->density_ratio > 10) q = nullptr;
        if (q) {
            partner_terms_.clear();
            const Evaluation partner =
                evaluate(scenes_, other, is_new ? counts_old_ : counts_new_, path_, q->path, &partner_terms_);
            const double rho = own_density(partner_terms_, partner, found, found.place) / own * q->density_ratio;
            if (max_channel(partner.F) > 0 && rho > 0) {
                show(p, e, terms_, sign / (1 + rho), own, camera, only_pixel, sink);
                if (options_.as_printed) {
                    Evaluation with_weight_of_base = e;
                    with_weight_of_base.F = partner.F;
                    show(q->path, with_weight_of_base, terms_, -sign * q->density_ratio / (1 + rho), own, camera,
                         only_pixel, sink);
                    return;
                }
                show(q->path, partner, partner_terms_, -sign * rho / (1 + rho), own, camera, only_pixel, sink);
                return;
            }
        }
    }
    show(p, e, terms_, sign, own, camera, only_pixel, sink);
}

void PathPairs::show(const FullPath& p, const Evaluation& e, const std::vector<Term>& terms, double factor, double own,
                     bool by_camera, std::int64_t only_pixel, const Sink& sink) const {
    const Sensor& sensor = scenes_.new_scene.scene.sensor;
    const float r = sensor.filter_radius;
    Point2f film = p.sensor.film;
    const auto one = [&](std::uint32_t x, std::uint32_t y) {
        const double h = sensor.filter_density(x, y, film);
        if (h > 0) sink({y * sensor.width + x, e.F * (factor * h), h, e, terms, own, by_camera, p.dynamic_at_first()});
    };
    if (only_pixel >= 0) {
        const auto x = std::uint32_t(std::uint64_t(only_pixel) % sensor.width),
                   y = std::uint32_t(std::uint64_t(only_pixel) / sensor.width);
        // Rounding must not lose a sample at the border of its own pixel.
        const float reach = r * (1 - 1e-6f);
        film = {clamp(film.x, float(x) + 0.5f - reach, float(x) + 0.5f + reach),
                clamp(film.y, float(y) + 0.5f - reach, float(y) + 0.5f + reach)};
        one(x, y);
        return;
    }
    const int x0 = std::max(int(std::floor(film.x - r - 0.5f)), 0),
              x1 = std::min(int(std::ceil(film.x + r - 0.5f)), int(sensor.width) - 1);
    const int y0 = std::max(int(std::floor(film.y - r - 0.5f)), 0),
              y1 = std::min(int(std::ceil(film.y + r - 0.5f)), int(sensor.height) - 1);
    for (int y = y0; y <= y1; ++y)
        for (int x = x0; x <= x1; ++x) one(std::uint32_t(x), std::uint32_t(y));
}

}  // namespace loom::residual
