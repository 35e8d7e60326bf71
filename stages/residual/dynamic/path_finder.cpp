#include "stages/residual/dynamic/path_finder.h"

#include "stages/core/sampling/streams.h"
#include "stages/core/sampling/warp.h"
#include "stages/core/scene/embree.h"

namespace loom::residual {

PathFinder::PathFinder(const DynamicScenes& scenes, const DynamicScene& side, const PathOptions& options)
    : scenes_(scenes), side_(side), options_(options) {
    path_.crossings = &crossings_.all;
}

bool PathFinder::occluded(const Ray& ray) {
    ++n_rays;
    return side_.scene.occluded(ray);
}

Hit PathFinder::intersect(const Ray& ray, bool from_camera) {
    ++n_rays;
    return from_camera ? side_.scene.intersect_from_camera(ray) : side_.scene.intersect(ray);
}

bool PathFinder::scatters(const Hit& hit) const {
    return hit && !side_.scene.materials[side_.scene.shapes[hit.shape_idx].material_idx].black();
}

Segment PathFinder::segment_to_sensor(const Vertex& v, const FilmPoint& film) {
    const auto first = std::uint32_t(crossings_.all.size());
    return {1, std::abs(dot(v.at.ng, film.d)), first,
            side_.cross({film.from, film.d, film.t_min, film.t * (1 - point_epsilon)}, crossings_)};
}

std::optional<FilmPoint> PathFinder::on_film(const Point3f& p) const {
    const Sensor& sensor = side_.scene.sensor;
    const std::optional<FilmPoint> at = sensor.project(p);
    const float r = sensor.filter_radius;
    const bool reached = at && at->film.x > -r && at->film.y > -r && at->film.x < float(sensor.width) + r &&
                         at->film.y < float(sensor.height) + r;
    return reached ? at : std::nullopt;
}

bool PathFinder::hides_from_sensor(const Vertex& v, const FilmPoint& film) {
    ++n_rays;
    return side_.scene.camera_rays->occluded({spawn_ray(v.at.end(), -film.d).o, -film.d, 0, film.t - film.t_min});
}

LightEnd PathFinder::light_end(const LightSample& s) const {
    LightEnd light;
    light.Le = Radiance(s.Li);
    light.y = s.at_infinity ? Point3f(s.wi) : s.y;
    light.n = s.n;
    light.hit_error = s.hit_error;
    light.pdf = s.density();
    light.emitter = s.emitter_idx;
    light.at_infinity = s.at_infinity;
    light.delta = s.delta;
    light.changed = side_.changed_emitter[s.emitter_idx];
    return light;
}

bool PathFinder::relocate(const Segment& segment, const SitePoint& point, std::uint32_t& place) {
    // A segment crosses a sphere twice; take the nearer crossing.
    float nearest = INFINITY;
    for (std::uint32_t c = segment.first; c < segment.first + segment.n; ++c) {
        const Crossing& crossing = crossings_.all[c];
        const float distance2 = length2(crossing.p - point.p);
        if (crossing.member != point.member || crossing.primitive != point.hit.primitive_idx || !(distance2 < nearest))
            continue;
        nearest = distance2;
        place = c;
    }
    if (nearest < INFINITY) return true;
    ++n_unrelocated;
    return false;
}

bool PathFinder::step(Stop& from, Point2f u, Point2f u_lobe_roulette, Stop& next) {
    const ShadingPoint here = side_.aimed(from.v, from.back);
    if (u_lobe_roulette.y >= survival(here)) return false;
    const BsdfSample<float> s = sample(here.bsdf, here.wo_local, u_lobe_roulette.x, u);
    if (s.lobe == Lobe::none || is_black(s.weight)) return false;
    from.ahead = here.frame.to_world(s.wi);
    from.lobe = s.lobe;
    const Ray ray = spawn_ray(from.v.at.end(), from.ahead);
    const Hit hit = intersect(ray);
    if (!scatters(hit)) return false;
    next.v = side_.vertex(ray, hit);
    next.back = -from.ahead;
    return true;
}

void PathFinder::join_sensor(Stop& stop) {
    const std::optional<FilmPoint> film = on_film(stop.v.at.p);
    if (!film) return;
    stop.end = interact(side_, stop.v, -film->d, stop.back, Lobe::none);
    if (!(max_channel(stop.end.f_cos) > 0) || hides_from_sensor(stop.v, *film)) return;
    stop.end_segment = segment_to_sensor(stop.v, *film);
    stop.sensor = {film->film, film->scale};
    stop.joined = stop.end_segment.cos_light > 0;
}

void PathFinder::join_light(Stop& stop, Point2f u) {
    if (side_.scene.emitters.empty()) return;
    const LightSample light = sample_light(side_.scene, stop.v.at.p, u);
    if (!(light.density() > 0)) return;
    stop.end = interact(side_, stop.v, stop.back, light.wi, Lobe::none);
    stop.light = light_end(light);
    if (!(max_channel(stop.end.f_cos) > 0) || occluded(shadow_ray(stop.v, stop.light))) return;
    stop.end_segment = segment_to_light(side_, stop.v, stop.light, crossings_);
    stop.joined = true;
}

void PathFinder::walk(std::vector<Stop>& stops, Towards towards, const Numbers& numbers, int n_max, bool join_first) {
    const bool lit = towards == Towards::light;
    for (int k = 0;; ++k) {
        ++n_vertices;
        if (k > 0 || join_first) {
            if (lit)
                join_light(stops.back(), numbers.pair(site_dimension::walk(k, lit, 2)));
            else
                join_sensor(stops.back());
        }
        if (int(stops.size()) >= n_max) return;
        stops.emplace_back();
        Stop &here = stops[stops.size() - 2], &next = stops.back();
        if (!step(here, numbers.pair(site_dimension::walk(k, lit, 0)), numbers.pair(site_dimension::walk(k, lit, 1)),
                  next)) {
            stops.pop_back();
            return;
        }
        here.onward = interact(side_, here.v, lit ? here.back : here.ahead, lit ? here.ahead : here.back, here.lobe);
        here.segment = lit ? segment_between(side_, here.v, next.v, crossings_)
                           : segment_between(side_, next.v, here.v, crossings_);
    }
}

/// Sets path_ from the sensor to the start of the walk towards it, and the next segment.
void PathFinder::from_sensor(std::size_t a, const Segment& ahead) {
    path_.start(z_[a].sensor, z_[a].end_segment);
    for (std::size_t k = a + 1; k-- > 0;)
        path_.add(k == a ? z_[k].end : z_[k].onward, z_[k].v, k > 0 ? z_[k - 1].segment : ahead);
}

/// Adds to path_ the vertices from the start of the walk towards the light.
void PathFinder::to_light(std::size_t b) {
    for (std::size_t k = 0; k < b; ++k) path_.add(y_[k].onward, y_[k].v, y_[k].segment);
    path_.add(y_[b].end, y_[b].v, y_[b].end_segment);
    path_.light = y_[b].light;
}

void PathFinder::show_to_sensor(const LightEnd& light, const Segment& light_segment, const Found& found,
                                const Visitor& visit) {
    for (std::size_t a = 0; a < z_.size(); ++a) {
        if (!z_[a].joined) continue;
        from_sensor(a, light_segment);
        path_.light = light;
        Found mine = found;
        if (found.technique == Technique::dynamic_from_emitter) mine.place = std::uint32_t(path_.m());
        visit(path_, mine);
    }
}

void PathFinder::show_from_sensor(const SensorEnd& sensor, const Segment& sensor_segment, const Found& found,
                                  std::size_t first, const Visitor& visit) {
    for (std::size_t b = first; b < y_.size(); ++b) {
        if (!y_[b].joined) continue;
        path_.start(sensor, sensor_segment);
        to_light(b);
        visit(path_, found);
    }
}

void PathFinder::show_two_ends(const Interaction* middle, const Vertex* middle_vertex, const Segment* between,
                               const Found& found, const Visitor& visit) {
    const int most = longest();
    for (std::size_t a = 0; a < z_.size(); ++a) {
        if (!z_[a].joined) continue;
        for (std::size_t b = 0; b < y_.size(); ++b) {
            if (!y_[b].joined || int(a + b + 2 + (middle ? 1 : 0)) > most) continue;
            Found mine = found;
            from_sensor(a, between[0]);
            if (middle) {
                path_.add(*middle, *middle_vertex, between[1]);
                mine.place = std::uint32_t(path_.m());
            }
            to_light(b);
            visit(path_, mine);
        }
    }
}

void PathFinder::find(Technique technique, Site site, const Numbers& numbers, const Visitor& visit) {
    if (longest() < 1) return;
    crossings_.all.clear();
    z_.clear();
    y_.clear();
    const SiteShapes& shapes = scenes_.at(site);
    const Start start = start_of(technique);
    if (!(shapes.area(start) > 0)) return;
    const Point2f u_choice = numbers.pair(site_dimension::choice), u_light = numbers.pair(site_dimension::light);
    const SitePoint point = shapes.sample(start, u_choice.x, numbers.pair(site_dimension::point));
    const SiteShapes::Member& member = shapes.members()[point.member];
    const SiteSample from{point, side_.is_new ? member.new_shape : member.old_shape, u_choice.y, u_light, numbers,
                          visit};
    switch (technique) {
        case Technique::dynamic_from_emitter:
            return dynamic_from_emitter(from);
        case Technique::ghost_from_emitter:
            return ghost_from_emitter(from);
        case Technique::dynamic_from_sensor:
            return dynamic_from_sensor(from);
        case Technique::ghost_from_sensor:
            return ghost_from_sensor(from);
        case Technique::dynamic_two_ends:
            return dynamic_two_ends(from);
        case Technique::ghost_two_ends:
            return ghost_two_ends(from);
        case Technique::path_tracing:
            return;
    }
}

bool PathFinder::reflects_back(const Vertex& v) const {
    return scatters_on_both_sides(side_.scene, v.here, v) || v.here.wo_local.z > 0;
}

void PathFinder::dynamic_from_emitter(const SiteSample& from) {
    // Sample a light.
    if (side_.scene.emitters.empty()) return;
    const LightSample s = sample_light(side_.scene, from.point.p, from.u_light);
    if (!(s.density() > 0)) return;

    // Make the point the vertex next to it.
    Stop first;
    first.v = side_.vertex(from.point, from.shape, s.wi);
    first.back = s.wi;
    if (!scatters(first.v.hit) || !has_smooth_lobe(first.v.here.bsdf) || !reflects_back(first.v)) return;

    from_light(first, light_end(s), nullptr, Technique::dynamic_from_emitter, from);
}

void PathFinder::ghost_from_emitter(const SiteSample& from) {
    // Sample a light from the ghost.
    const Scene& scene = side_.scene;
    if (scene.emitters.empty()) return;
    LightQuery query;
    query.u = from.u_light;
    look_up_light(scene, query);
    const LightSample seen = sample_light(scene, from.point.p, query);
    if (!(seen.density() > 0)) return;

    // Find the vertex behind the ghost.
    const Ray away{from.point.p, -seen.wi};
    const Hit hit = intersect(away);
    if (!scatters(hit)) return;
    Stop first;
    first.v = side_.vertex(away, hit);

    // Evaluate the light from that vertex.
    const Point3f& p = first.v.at.p;
    LightEnd light;
    if (query.placed || seen.delta) {
        const LightSample s = sample_light(scene, p, query);
        if (!(s.density() > 0)) return;
        light = light_end(s);
    } else {
        light = light_end(seen);
        light.pdf = light_pdf(scene, light, p);
    }
    first.back = direction_to(light, p);

    from_light(first, light, &from.point, Technique::ghost_from_emitter, from);
}

void PathFinder::from_light(const Stop& first, const LightEnd& light, const SitePoint* ghost, Technique technique,
                            const SiteSample& from) {
    // Test visibility.
    if (occluded(shadow_ray(first.v, light))) return;

    // Find the ghost on the segment.
    Found found{technique, 0};
    const Segment light_segment = segment_to_light(side_, first.v, light, crossings_);
    if (ghost && !relocate(light_segment, *ghost, found.place)) return;

    // Walk to the sensor.
    z_.push_back(first);
    walk(z_, Towards::sensor, from.numbers, longest());
    show_to_sensor(light, light_segment, found, from.visit);
}

void PathFinder::dynamic_from_sensor(const SiteSample& from) {
    // Project the point onto the film.
    const std::optional<FilmPoint> film = on_film(from.point.p);
    if (!film) return;

    // Make it the first vertex of the path.
    Stop first;
    first.back = -film->d;
    first.v = side_.vertex(from.point, from.shape, first.back);
    if (!scatters(first.v.hit) || !reflects_back(first.v)) return;

    // Test visibility.
    if (hides_from_sensor(first.v, *film)) return;
    const Segment sensor_segment = segment_to_sensor(first.v, *film);
    if (!(sensor_segment.cos_light > 0)) return;

    // Walk to the light. A path of this vertex alone is left to technique 1.
    y_.push_back(first);
    walk(y_, Towards::light, from.numbers, longest(), false);
    show_from_sensor({film->film, film->scale}, sensor_segment, {Technique::dynamic_from_sensor, 1}, 1, from.visit);
}

void PathFinder::ghost_from_sensor(const SiteSample& from) {
    // Project the ghost onto the film.
    const std::optional<FilmPoint> film = on_film(from.point.p);
    if (!film) return;

    // Find the vertex behind it.
    const Ray ray{film->from, film->d, film->t_min, INFINITY};
    const Hit hit = intersect(ray, true);
    if (!scatters(hit) || hit.t < film->t) return;
    Stop first;
    first.back = -film->d;
    first.v = side_.vertex(ray, hit);
    FilmPoint at = *film;
    at.scale *= side_.scene.sensor.kind == SensorKind::perspective ? sqr(double(film->t) / hit.t) : 1.0;
    at.t = hit.t;

    // Find the ghost on the segment.
    const Segment sensor_segment = segment_to_sensor(first.v, at);
    if (!(sensor_segment.cos_light > 0)) return;
    Found found{Technique::ghost_from_sensor, 0};
    if (!relocate(sensor_segment, from.point, found.place)) return;

    // Walk to the light.
    y_.push_back(first);
    walk(y_, Towards::light, from.numbers, longest());
    show_from_sensor({at.film, at.scale}, sensor_segment, found, 0, from.visit);
}

void PathFinder::dynamic_two_ends(const SiteSample& from) {
    // Sample a direction towards the light by the cosine, and find its vertex.
    Stop middle;
    middle.v = side_.vertex(from.point, from.shape, Vector3f(from.point.ng));
    if (!scatters(middle.v.hit)) return;
    Vector3f local = sample_cosine_hemisphere(from.u_light);
    if (scatters_on_both_sides(side_.scene, middle.v.here, middle.v) && from.u_side >= 0.5f) local.z = -local.z;
    const Vector3f to_light_d = middle.v.here.frame.to_world(local);
    const Ray ray = spawn_ray(middle.v.at.end(), to_light_d);
    const Hit hit = intersect(ray);
    if (!scatters(hit)) return;

    // Sample the BSDF towards the sensor, and find that vertex.
    middle.back = to_light_d;
    Stop z, y;
    if (!step(middle, from.numbers.pair(site_dimension::walk(0, false, 3)), from.numbers.pair(site_dimension::lobe), z))
        return;
    const Interaction x = interact(side_, middle.v, middle.ahead, to_light_d, middle.lobe);
    y.v = side_.vertex(ray, hit);
    y.back = -to_light_d;
    const Segment between[2] = {segment_between(side_, z.v, middle.v, crossings_),
                                segment_between(side_, middle.v, y.v, crossings_)};

    // Walk to both ends.
    z_.push_back(z);
    y_.push_back(y);
    walk(z_, Towards::sensor, from.numbers, longest() - 2);
    walk(y_, Towards::light, from.numbers, longest() - 2);
    show_two_ends(&x, &middle.v, between, {Technique::dynamic_two_ends, 0}, from.visit);
}

void PathFinder::ghost_two_ends(const SiteSample& from) {
    // Sample a line through the ghost by the cosine.
    Vector3f local = sample_cosine_hemisphere(from.u_light);
    if (from.u_side >= 0.5f) local.z = -local.z;
    const Vector3f d = Framef(from.point.ng).to_world(local);

    // Find the vertices at both of its ends.
    const Ray ahead{from.point.p, d}, behind{from.point.p, -d};
    const Hit light_hit = intersect(ahead);
    if (!scatters(light_hit)) return;
    const Hit sensor_hit = intersect(behind);
    if (!scatters(sensor_hit)) return;
    Stop z, y;
    z.v = side_.vertex(behind, sensor_hit);
    y.v = side_.vertex(ahead, light_hit);
    y.back = normalize(z.v.at.p - y.v.at.p);
    z.back = -y.back;

    // Find the ghost on the segment.
    Found found{Technique::ghost_two_ends, 0};
    const Segment between = segment_between(side_, z.v, y.v, crossings_);
    if (!relocate(between, from.point, found.place)) return;

    // Walk to both ends.
    z_.push_back(z);
    y_.push_back(y);
    walk(z_, Towards::sensor, from.numbers, longest() - 1);
    walk(y_, Towards::light, from.numbers, longest() - 1);
    show_two_ends(nullptr, nullptr, &between, found, from.visit);
}

bool PathFinder::find_from_camera(PathId id, const Sampler& numbers, const Visitor& visit) {
    crossings_.all.clear();
    y_.clear();
    first_hit = {};
    // Trace the path; evaluate it only where the edit touches it.
    const CameraPath path = trace_from_camera(id, numbers);
    if (!path.touched || options_.max_depth == 0) return false;
    show_camera_path(path, visit);
    return true;
}

PathFinder::CameraPath PathFinder::trace_from_camera(PathId id, const Sampler& numbers) {
    const Scene& scene = side_.scene;
    CameraPath path;
    path.touched = !scenes_.same_choice_of_lights;
    path.first = scene.sensor.sample_ray(std::uint32_t(id.pixel % scene.sensor.width),
                                         std::uint32_t(id.pixel / scene.sensor.width), numbers.pair(film_pair));
    Ray ray = path.first;
    bool is_straight = true;
    for (int depth = 1;; ++depth) {
        // Intersect the ray.
        const Hit hit = intersect(ray, depth == 1);
        Ray upto = ray;
        if (hit) upto.t_max = hit.t * (1 - point_epsilon);
        path.touched = path.touched || crosses_movers(upto);
        if (!hit) {
            path.escaped = true;
            path.touched = path.touched || scenes_.lights_changed;
            if (scene.environment_idx >= 0 && !hides_sky(scene, is_straight)) path.sky = sky_end(ray.d);
            return path;
        }

        // Add its vertex, with the light that it emits.
        Stop& stop = y_.emplace_back();
        stop.v = side_.vertex(ray, hit);
        stop.back = -ray.d;
        path.touched = path.touched || stop.v.site != no_site;
        if (depth == 1) first_hit = loom::first_hit(stop.v.here, hit.t);
        if (const int emitter = scene.shapes[hit.shape_idx].emitter_idx; emitter >= 0) {
            stop.met = emitted_end(stop, emitter);
            stop.met.pdf = depth > 1 ? pdf_light_w(scene, y_[y_.size() - 2].v.at.p, stop.v.at) : 0.0f;
            path.touched = path.touched || stop.met.changed;
        }
        if (depth == options_.max_depth || !scatters(hit)) return path;

        // Sample a light and the next direction.
        ++n_vertices;
        join_sampled_light(stop, numbers, depth, path.touched);
        if (!leave(stop, numbers, depth)) return path;
        is_straight &= goes_straight_on(stop.lobe, stop.v.here.bsdf.model->kind);
        ray = spawn_ray(stop.v.here.end(), stop.ahead);
    }
}

bool PathFinder::crosses_movers(const Ray& ray) const {
    return scenes_.mover_rays && scenes_.mover_rays->occluded(ray);
}

LightEnd PathFinder::sky_end(const Vector3f& d) const {
    const Scene& scene = side_.scene;
    LightEnd sky;
    sky.Le = Radiance(environment(scene, d));
    sky.y = Point3f(d);
    sky.at_infinity = true;
    sky.emitter = std::uint16_t(scene.environment_idx);
    sky.changed = side_.changed_emitter[std::size_t(scene.environment_idx)];
    sky.pdf = pdf_environment_w(scene, d);
    return sky;
}

LightEnd PathFinder::emitted_end(const Stop& stop, int emitter) const {
    LightEnd light;
    light.Le = Radiance(emitted(side_.scene, stop.v.at, stop.back));
    light.y = stop.v.at.p;
    light.n = stop.v.at.ng;
    light.hit_error = stop.v.at.hit_error;
    light.emitter = std::uint16_t(emitter);
    light.changed = side_.changed_emitter[std::size_t(emitter)];
    return light;
}

void PathFinder::join_sampled_light(Stop& stop, const Sampler& numbers, int depth, bool& touched) {
    const ShadingPoint& here = stop.v.here;
    if (side_.scene.emitters.empty() || !has_smooth_lobe(here.bsdf)) return;
    const LightSample s = sample_light(side_.scene, here.p, numbers.pair(dimension(depth, Dimension::light)));
    touched = touched || side_.changed_emitter[s.emitter_idx];
    if (!(s.density() > 0) || is_black(f_cos_pdf(here, s.wi).f_cos)) return;
    stop.light = light_end(s);
    const Ray shadow = shadow_ray(stop.v, stop.light);
    stop.joined = !occluded(shadow);
    touched = touched || crosses_movers(shadow);
}

bool PathFinder::leave(Stop& stop, const Sampler& numbers, int depth) const {
    const ShadingPoint& here = stop.v.here;
    const float q = roulette_at(options_, depth) != Roulette::off ? survival(here) : 1.0f;
    if (roulette_ends(q, numbers, depth)) return false;
    const BsdfSample<float> s =
        draw_unshadowed(here, numbers, depth, numbers.pair(dimension(depth, Dimension::direction)));
    if (s.lobe == Lobe::none || is_black(s.weight)) return false;
    stop.ahead = here.frame.to_world(s.wi);
    stop.lobe = s.lobe;
    return true;
}

void PathFinder::show_camera_path(const CameraPath& path, const Visitor& visit) {
    const auto show = [&](const LightEnd& light, bool next_event) {
        path_.light = light;
        if (max_channel(light.Le) > 0 && path_.dynamic()) visit(path_, {Technique::path_tracing, 0, next_event});
    };
    const auto go_on = [&](Stop& from, const Segment& ahead) {
        from.onward = interact(side_, from.v, from.back, from.ahead, from.lobe);
        path_.add(from.onward, from.v, ahead);
    };
    const FilmPoint film = side_.scene.sensor.film_of(path.first, y_.empty() ? 1 : first_hit.depth);
    const SensorEnd sensor{film.film, film.scale};
    for (std::size_t k = 0; k < y_.size(); ++k) {
        // Extend the path by one vertex.
        Stop& here = y_[k];
        if (k == 0)
            path_.start(sensor, segment_to_sensor(here.v, film));
        else
            go_on(y_[k - 1], segment_between(side_, y_[k - 1].v, here.v, crossings_));

        // End it at the light that this vertex emits, then at the one sampled from it.
        show(here.met, false);
        if (!here.joined) continue;
        here.end = interact(side_, here.v, here.back, direction_to(here.light, here.v.at.p), Lobe::none);
        path_.add(here.end, here.v, segment_to_light(side_, here.v, here.light, crossings_));
        show(here.light, true);
        path_.remove_last();
    }
    if (!path.escaped) return;

    // End it at the sky.
    if (y_.empty()) {
        const auto at = std::uint32_t(crossings_.all.size());
        path_.start(sensor, {1, 1, at, side_.cross(path.first, crossings_)});
    } else {
        go_on(y_.back(), segment_to_light(side_, y_.back().v, path.sky, crossings_));
    }
    show(path.sky, false);
}

}  // namespace loom::residual
