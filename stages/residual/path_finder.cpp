#include "stages/residual/path_finder.h"

#include "stages/core/sampling/warp.h"

namespace loom::residual {
namespace {

// Pairs of random numbers of a sample that starts from a site. Each bounce has its own, so that the two scenes of an
// edit ask for the same ones.
enum : std::uint32_t { choice_pair = 0, point_pair = 1, light_pair = 2, lobe_pair = 3, first_walk_pair = 8 };
constexpr std::uint32_t walk_pair(int k, bool to_light, std::uint32_t what) { return first_walk_pair + std::uint32_t(k) * 8 + (to_light ? 4 : 0) + what; }

}  // namespace

PathFinder::PathFinder(const DynamicScenes& scenes, const DynamicScene& side, const PathOptions& options) : scenes_(scenes), side_(side), options_(options) {
    path_.crossings = &crossings_;
}

bool PathFinder::occluded(const Ray& ray) {
    ++n_rays;
    return side_.scene.occluded(ray);
}

Hit PathFinder::intersect(const Ray& ray) {
    ++n_rays;
    return side_.scene.intersect(ray);
}

bool PathFinder::scatters(const Hit& hit) const { return hit && !side_.scene.materials[side_.scene.shapes[hit.shape].material].black(); }

Segment PathFinder::segment_between(const Vertex& s, const Vertex& l) {
    const Ray ray = spawn_segment(s.at.p, s.at.ng, l.at.p);
    const Vector3f d = normalize(l.at.p - s.at.p);
    const auto first = std::uint32_t(crossings_.size());
    return {std::abs(dot(s.at.ng, d)), std::abs(dot(l.at.ng, d)), first, side_.cross(ray, scratch_, crossings_)};
}

Segment PathFinder::segment_to_light(const Vertex& v, const LightEnd& light) {
    const Ray ray = light.at_infinity ? spawn_ray(v.at.p, v.at.ng, Vector3f(light.y)) : spawn_segment(v.at.p, v.at.ng, light.y);
    const Vector3f d = light.at_infinity ? Vector3f(light.y) : normalize(light.y - v.at.p);
    const auto first = std::uint32_t(crossings_.size());
    return {std::abs(dot(v.at.ng, d)), 1, first, side_.cross(ray, scratch_, crossings_)};
}

Segment PathFinder::segment_to_sensor(const Vertex& v, const FilmPoint& film) {
    const auto first = std::uint32_t(crossings_.size());
    return {1, std::abs(dot(v.at.ng, film.d)), first, side_.cross({film.from, film.d, film.t_min, film.t * (1 - shadow_epsilon)}, scratch_, crossings_)};
}

LightEnd PathFinder::light_end(const LightSample& s) const {
    LightEnd light;
    light.Le = Radiance(s.Li);
    light.y = s.at_infinity ? Point3f(s.wi) : s.y;
    light.n = s.n;
    light.pdf = s.pdf_w;
    light.emitter = s.emitter;
    light.at_infinity = s.at_infinity;
    light.delta = s.delta;
    light.changed = side_.changed_emitter[s.emitter];
    return light;
}

std::uint32_t PathFinder::crossing_of(const Segment& segment, const SitePoint& point) const {
    for (std::uint32_t c = segment.first; c < segment.first + segment.n; ++c)
        if (crossings_[c].member == point.member && crossings_[c].primitive == point.hit.primitive) {
            // A sphere is passed through twice.
            if (c + 1 < segment.first + segment.n && crossings_[c + 1].member == point.member && crossings_[c + 1].primitive == point.hit.primitive &&
                length2(crossings_[c + 1].p - point.p) < length2(crossings_[c].p - point.p))
                return c + 1;
            return c;
        }
    return ~0u;
}

bool PathFinder::step(const Stop& from, Point2f u, Point2f u_lobe_roulette, Vector3f& d, Lobe& lobe, Hit& hit, Ray& ray) {
    const ShadingPoint here = side_.aimed(from.v, from.back);
    if (u_lobe_roulette.y >= survival(here)) return false;
    const BsdfSample<float> s = sample(here.bsdf, here.wo_local, u_lobe_roulette.x, u);
    if (s.lobe == Lobe::none || is_black(s.weight)) return false;
    d = here.frame.to_world(s.wi);
    lobe = s.lobe;
    ray = spawn_ray(from.v.at.p, from.v.at.ng, d);
    hit = intersect(ray);
    return scatters(hit);
}

void PathFinder::join_sensor(Stop& stop) {
    const Sensor& sensor = side_.scene.sensor;
    const std::optional<FilmPoint> film = sensor.project(stop.v.at.p);
    const float r = sensor.filter_radius;
    if (!film || !(film->film.x > -r && film->film.y > -r && film->film.x < float(sensor.width) + r && film->film.y < float(sensor.height) + r)) return;
    const Vector3f to_sensor = -film->d;
    stop.end = interact(side_, stop.v, to_sensor, stop.back, Lobe::none);
    if (!(max_channel(stop.end.f_cos) > 0)) return;
    const Point3f o = offset_origin(stop.v.at.p, stop.v.at.ng, to_sensor);
    if (occluded({o, to_sensor, 0, film->t - film->t_min})) return;
    stop.end_segment = segment_to_sensor(stop.v, *film);
    if (!(stop.end_segment.cos_light > 0)) return;
    stop.sensor = {film->film, film->scale};
    stop.joined = true;
}

void PathFinder::join_light(Stop& stop, Point2f u) {
    if (side_.scene.emitters.empty()) return;
    const LightSample light = sample_light(side_.scene, stop.v.at.p, u);
    if (!(light.pdf_w > 0)) return;
    stop.end = interact(side_, stop.v, stop.back, light.wi, Lobe::none);
    if (!(max_channel(stop.end.f_cos) > 0)) return;
    const Point3f& p = stop.v.at.p;
    if (occluded(light.at_infinity ? spawn_ray(p, stop.v.at.ng, light.wi) : spawn_segment(p, stop.v.at.ng, light.y))) return;
    stop.light = light_end(light);
    stop.end_segment = segment_to_light(stop.v, stop.light);
    stop.joined = true;
}

void PathFinder::to_sensor(const Sampler& numbers, int n_max) {
    for (int k = 0;; ++k) {
        ++n_vertices;
        join_sensor(z_.back());
        if (int(z_.size()) >= n_max) return;
        Vector3f d;
        Lobe lobe;
        Hit hit;
        Ray ray;
        if (!step(z_.back(), numbers.pair(walk_pair(k, false, 0)), numbers.pair(walk_pair(k, false, 1)), d, lobe, hit, ray)) return;
        Stop next;
        next.v = side_.vertex(ray, hit);
        next.back = -d;
        Stop& here = z_.back();
        here.onward = interact(side_, here.v, d, here.back, lobe);
        here.segment = segment_between(next.v, here.v);
        z_.push_back(next);
    }
}

void PathFinder::to_light(const Sampler& numbers, int n_max, bool first_too) {
    for (int k = 0;; ++k) {
        ++n_vertices;
        if (k > 0 || first_too) join_light(y_.back(), numbers.pair(walk_pair(k, true, 2)));
        if (int(y_.size()) >= n_max) return;
        Vector3f d;
        Lobe lobe;
        Hit hit;
        Ray ray;
        if (!step(y_.back(), numbers.pair(walk_pair(k, true, 0)), numbers.pair(walk_pair(k, true, 1)), d, lobe, hit, ray)) return;
        Stop next;
        next.v = side_.vertex(ray, hit);
        next.back = -d;
        Stop& here = y_.back();
        here.onward = interact(side_, here.v, here.back, d, lobe);
        here.segment = segment_between(here.v, next.v);
        y_.push_back(next);
    }
}

void PathFinder::show_to_sensor(const LightEnd& light, const Segment& light_segment, const Found& found, const Visitor& visit) {
    for (std::size_t a = 0; a < z_.size(); ++a) {
        if (!z_[a].joined) continue;
        path_.vertices.clear();
        path_.places.clear();
        path_.segments.clear();
        path_.sensor = z_[a].sensor;
        path_.light = light;
        path_.vertices.push_back(z_[a].end);
        path_.places.push_back(&z_[a].v);
        path_.segments.push_back(z_[a].end_segment);
        for (std::size_t k = a; k-- > 0;) {
            path_.vertices.push_back(z_[k].onward);
            path_.places.push_back(&z_[k].v);
            path_.segments.push_back(z_[k].segment);
        }
        path_.segments.push_back(light_segment);
        Found mine = found;
        if (found.technique == Technique::dynamic_from_emitter) mine.place = std::uint32_t(path_.m());
        visit(path_, mine);
    }
}

void PathFinder::show_from_sensor(const SensorEnd& sensor, const Segment& sensor_segment, const Found& found, std::size_t first, const Visitor& visit) {
    for (std::size_t b = first; b < y_.size(); ++b) {
        if (!y_[b].joined) continue;
        path_.vertices.clear();
        path_.places.clear();
        path_.segments.clear();
        path_.sensor = sensor;
        path_.light = y_[b].light;
        path_.segments.push_back(sensor_segment);
        for (std::size_t k = 0; k < b; ++k) {
            path_.vertices.push_back(y_[k].onward);
            path_.places.push_back(&y_[k].v);
            path_.segments.push_back(y_[k].segment);
        }
        path_.vertices.push_back(y_[b].end);
        path_.places.push_back(&y_[b].v);
        path_.segments.push_back(y_[b].end_segment);
        visit(path_, found);
    }
}

void PathFinder::show_two_ends(const Interaction* middle, const Vertex* middle_vertex, const Segment* between, int n_between, const Found& found,
                               const Visitor& visit) {
    const int most = longest();
    for (std::size_t a = 0; a < z_.size(); ++a) {
        if (!z_[a].joined) continue;
        for (std::size_t b = 0; b < y_.size(); ++b) {
            if (!y_[b].joined || int(a + b + 2 + (middle ? 1 : 0)) > most) continue;
            path_.vertices.clear();
            path_.places.clear();
            path_.segments.clear();
            path_.sensor = z_[a].sensor;
            path_.light = y_[b].light;
            path_.vertices.push_back(z_[a].end);
            path_.places.push_back(&z_[a].v);
            path_.segments.push_back(z_[a].end_segment);
            for (std::size_t k = a; k-- > 0;) {
                path_.vertices.push_back(z_[k].onward);
                path_.places.push_back(&z_[k].v);
                path_.segments.push_back(z_[k].segment);
            }
            Found mine = found;
            if (middle) {
                path_.vertices.push_back(*middle);
                path_.places.push_back(middle_vertex);
                mine.place = std::uint32_t(path_.m());
            }
            for (int k = 0; k < n_between; ++k) path_.segments.push_back(between[k]);
            for (std::size_t k = 0; k < b; ++k) {
                path_.vertices.push_back(y_[k].onward);
                path_.places.push_back(&y_[k].v);
                path_.segments.push_back(y_[k].segment);
            }
            path_.vertices.push_back(y_[b].end);
            path_.places.push_back(&y_[b].v);
            path_.segments.push_back(y_[b].end_segment);
            visit(path_, mine);
        }
    }
}

void PathFinder::find(Technique technique, Site site, const Sampler& numbers, const Visitor& visit) {
    const SiteShapes& shapes = scenes_.at(site);
    const Scene& scene = side_.scene;
    const int most = longest();
    if (most < 1) return;
    crossings_.clear();
    z_.clear();
    y_.clear();
    const Point2f u_choice = numbers.pair(choice_pair), u_light = numbers.pair(light_pair);
    const SitePoint point = shapes.sample(u_choice.x, numbers.pair(point_pair));
    const SiteShapes::Member& member = shapes.members()[point.member];
    const std::uint32_t shape = side_.is_new ? member.new_shape : member.old_shape;
    Found found{technique, 0};

    switch (technique) {
        case Technique::dynamic_from_emitter: {
            if (scene.emitters.empty()) return;
            const LightSample s = sample_light(scene, point.p, u_light);
            if (!(s.pdf_w > 0)) return;
            Stop first;
            first.v = side_.vertex(point, shape, s.wi);
            first.back = s.wi;
            if (!scatters(first.v.hit) || !has_smooth_lobe(first.v.here.bsdf)) return;
            if (!scatters_on_both_sides(scene, first.v.here, first.v) && !(first.v.here.wo_local.z > 0)) return;
            if (occluded(s.at_infinity ? spawn_ray(point.p, point.ng, s.wi) : spawn_segment(point.p, point.ng, s.y))) return;
            const LightEnd light = light_end(s);
            const Segment light_segment = segment_to_light(first.v, light);
            z_.push_back(first);
            to_sensor(numbers, most);
            show_to_sensor(light, light_segment, found, visit);
            return;
        }
        case Technique::ghost_from_emitter: {
            if (scene.emitters.empty()) return;
            LightQuery query;
            query.u = u_light;
            look_up_light(scene, query);
            const LightSample seen = sample_light(scene, point.p, query);
            if (!(seen.pdf_w > 0)) return;
            const Ray away{point.p, -seen.wi};
            const Hit hit = intersect(away);
            if (!scatters(hit)) return;
            Stop first;
            first.v = side_.vertex(away, hit);
            first.back = seen.wi;
            const Point3f& p = first.v.at.p;
            LightEnd light;
            if (query.placed || seen.delta) {
                const LightSample s = sample_light(scene, p, query);
                if (!(s.pdf_w > 0)) return;
                light = light_end(s);
            } else {
                light = light_end(seen);
                light.pdf = light_pdf(scene, light, p);
            }
            if (!light.at_infinity) first.back = normalize(light.y - p);
            if (occluded(light.at_infinity ? spawn_ray(p, first.v.at.ng, first.back) : spawn_segment(p, first.v.at.ng, light.y))) return;
            const Segment light_segment = segment_to_light(first.v, light);
            found.place = crossing_of(light_segment, point);
            if (found.place == ~0u) {
                ++n_unrelocated;
                return;
            }
            z_.push_back(first);
            to_sensor(numbers, most);
            show_to_sensor(light, light_segment, found, visit);
            return;
        }
        case Technique::dynamic_from_sensor:
        case Technique::ghost_from_sensor: {
            const bool ghost = technique == Technique::ghost_from_sensor;
            const std::optional<FilmPoint> film = scene.sensor.project(point.p);
            const float r = scene.sensor.filter_radius;
            if (!film || !(film->film.x > -r && film->film.y > -r && film->film.x < float(scene.sensor.width) + r && film->film.y < float(scene.sensor.height) + r))
                return;
            Stop first;
            first.back = -film->d;
            FilmPoint at = *film;
            if (ghost) {
                const Ray ray{film->from, film->d, film->t_min, INFINITY};
                const Hit hit = intersect(ray);
                if (!scatters(hit) || hit.t < film->t) return;
                first.v = side_.vertex(ray, hit);
                at.scale *= scene.sensor.kind == SensorKind::perspective ? sqr(double(film->t) / hit.t) : 1.0;
                at.t = hit.t;
            } else {
                first.v = side_.vertex(point, shape, first.back);
                if (!scatters(first.v.hit)) return;
                if (!scatters_on_both_sides(scene, first.v.here, first.v) && !(first.v.here.wo_local.z > 0)) return;
                if (occluded({offset_origin(point.p, point.ng, first.back), first.back, 0, film->t - film->t_min})) return;
                found.place = 1;
            }
            const Segment sensor_segment = segment_to_sensor(first.v, at);
            if (!(sensor_segment.cos_light > 0)) return;
            if (ghost) {
                found.place = crossing_of(sensor_segment, point);
                if (found.place == ~0u) {
                    ++n_unrelocated;
                    return;
                }
            }
            y_.push_back(first);
            to_light(numbers, most, ghost);
            show_from_sensor({at.film, at.scale}, sensor_segment, found, ghost ? 0 : 1, visit);
            return;
        }
        case Technique::dynamic_two_ends: {
            Stop middle;
            middle.v = side_.vertex(point, shape, Vector3f(point.ng));
            if (!scatters(middle.v.hit)) return;
            Vector3f local = sample_cosine_hemisphere(u_light);
            if (scatters_on_both_sides(scene, middle.v.here, middle.v) && u_choice.y >= 0.5f) local.z = -local.z;
            const Vector3f to_light_d = middle.v.here.frame.to_world(local);
            const Ray ray = spawn_ray(point.p, point.ng, to_light_d);
            const Hit hit = intersect(ray);
            if (!scatters(hit)) return;
            Vector3f to_sensor_d;
            Lobe lobe;
            Hit sensor_hit;
            Ray sensor_ray;
            middle.back = to_light_d;
            if (!step(middle, numbers.pair(walk_pair(0, false, 3)), numbers.pair(lobe_pair), to_sensor_d, lobe, sensor_hit, sensor_ray)) return;
            const Interaction x = interact(side_, middle.v, to_sensor_d, to_light_d, lobe);
            Stop z, y;
            z.v = side_.vertex(sensor_ray, sensor_hit);
            z.back = -to_sensor_d;
            y.v = side_.vertex(ray, hit);
            y.back = -to_light_d;
            const Segment between[2] = {segment_between(z.v, middle.v), segment_between(middle.v, y.v)};
            z_.push_back(z);
            y_.push_back(y);
            to_sensor(numbers, most - 2);
            to_light(numbers, most - 2, true);
            show_two_ends(&x, &middle.v, between, 2, found, visit);
            return;
        }
        case Technique::ghost_two_ends: {
            Vector3f local = sample_cosine_hemisphere(u_light);
            if (u_choice.y >= 0.5f) local.z = -local.z;
            const Vector3f d = Framef(point.ng).to_world(local);
            const Ray ahead{point.p, d}, behind{point.p, -d};
            const Hit light_hit = intersect(ahead);
            if (!scatters(light_hit)) return;
            const Hit sensor_hit = intersect(behind);
            if (!scatters(sensor_hit)) return;
            Stop z, y;
            z.v = side_.vertex(behind, sensor_hit);
            y.v = side_.vertex(ahead, light_hit);
            y.back = normalize(z.v.at.p - y.v.at.p);
            z.back = -y.back;
            const Segment between = segment_between(z.v, y.v);
            found.place = crossing_of(between, point);
            if (found.place == ~0u) {
                ++n_unrelocated;
                return;
            }
            z_.push_back(z);
            y_.push_back(y);
            to_sensor(numbers, most - 1);
            to_light(numbers, most - 1, true);
            show_two_ends(nullptr, nullptr, &between, 1, found, visit);
            return;
        }
        case Technique::path_tracing: return;
    }
}

bool PathFinder::find_from_camera(PathId id, const Sampler& numbers, const Visitor& visit) {
    const Scene& scene = side_.scene;
    crossings_.clear();
    y_.clear();
    path_.vertices.clear();
    path_.places.clear();
    path_.segments.clear();
    Ray ray = scene.sensor.sample_ray(std::uint32_t(id.pixel % scene.sensor.width), std::uint32_t(id.pixel / scene.sensor.width), numbers.pair(film_pair));
    bool touched = !scenes_.same_choice_of_lights;
    first_hit = {};
    // What the path meets, first; what it is worth only where the edit has a part in it.
    std::vector<LightEnd> hit_light;  // by segment: the light at its end
    const auto crosses = [&](const Ray& r) { return scenes_.mover_rays && scenes_.mover_rays->occluded(r); };
    for (int depth = 1;; ++depth) {
        const Hit hit = intersect(ray);
        LightEnd light;
        Ray upto = ray;
        if (hit) upto.t_max = hit.t * (1 - shadow_epsilon);
        touched = touched || crosses(upto);
        if (!hit) {
            const Spectrum Le = environment(scene, ray.d);
            if (is_black(Le) && !(scene.environment >= 0 && side_.changed_emitter[std::size_t(scene.environment)])) {
                hit_light.push_back(light);
                if (scenes_.lights_changed) touched = true;
                break;
            }
            light.Le = Radiance(Le);
            light.y = Point3f(ray.d);
            light.at_infinity = true;
            light.emitter = std::uint16_t(scene.environment);
            light.changed = side_.changed_emitter[std::size_t(scene.environment)];
            light.pdf = pdf_environment_w(scene, ray.d);
            touched = touched || light.changed;
            hit_light.push_back(light);
            break;
        }
        Stop stop;
        stop.v = side_.vertex(ray, hit);
        stop.back = -ray.d;
        touched = touched || stop.v.site != no_site;
        if (depth == 1) first_hit = {albedo(stop.v.here.bsdf, stop.v.here.wo_local), stop.v.here.frame.n, hit.t};
        if (const int emitter = scene.shapes[hit.shape].emitter; emitter >= 0) {
            light.Le = Radiance(emitted(scene, stop.v.at, stop.back));
            light.y = stop.v.at.p;
            light.n = stop.v.at.ng;
            light.emitter = std::uint16_t(emitter);
            light.changed = side_.changed_emitter[std::size_t(emitter)];
            light.pdf = depth > 1 ? pdf_light_w(scene, y_.back().v.at.p, stop.v.at) : 0.0f;
            touched = touched || light.changed;
        }
        hit_light.push_back(light);
        // The edge that has arrived.
        if (depth == 1) {
            path_.sensor = {};
            const FilmPoint film = scene.sensor.film_of(ray, hit.t);
            path_.sensor = {film.film, film.scale};
            path_.segments.push_back(segment_to_sensor(stop.v, film));
        } else {
            y_.back().segment = segment_between(y_.back().v, stop.v);
        }
        if (depth == options_.max_depth || !scatters(hit)) {
            y_.push_back(stop);
            break;
        }
        ++n_vertices;
        const ShadingPoint& here = stop.v.here;
        if (!scene.emitters.empty() && has_smooth_lobe(here.bsdf)) {
            const LightSample s = sample_light(scene, here.p, numbers.pair(dimension(depth, Place::light)));
            touched = touched || side_.changed_emitter[s.emitter];
            if (s.pdf_w > 0 && !is_black(f_cos_pdf(here, s.wi).f_cos)) {
                const Ray shadow = s.at_infinity ? spawn_ray(here.p, here.ng, s.wi) : spawn_segment(here.p, here.ng, s.y);
                stop.joined = !occluded(shadow);
                touched = touched || crosses(shadow);
                stop.light = light_end(s);
                stop.to_light = s.wi;
            }
        }
        const float q = options_.roulette != Roulette::off && depth >= options_.rr_depth ? float(survival(here)) : 1.0f;
        bool goes_on = !(q < 1 && numbers.pair(dimension(depth, Place::roulette)).x >= q);
        if (goes_on) {
            const BsdfModel& model = *here.bsdf.model;
            const bool one_lobe = model.kind == BsdfKind::diffuse && here.bsdf.opacity == 1;
            const float u_lobe = one_lobe ? 0.0f : numbers.pair(dimension(depth, Place::lobe)).x;
            const BsdfSample<float> s = sample(here.bsdf, here.wo_local, u_lobe, numbers.pair(dimension(depth, Place::direction)));
            goes_on = s.lobe != Lobe::none && !is_black(s.weight);
            if (goes_on) {
                stop.ahead = here.frame.to_world(s.wi);
                stop.lobe = s.lobe;
                ray = spawn_ray(here.p, here.ng, stop.ahead);
            }
        }
        y_.push_back(stop);
        if (!goes_on) break;
    }
    if (!touched) return false;

    const auto show = [&](const LightEnd& light, bool next_event) {
        path_.light = light;
        bool any = light.changed;
        for (const Segment& s : path_.segments) any = any || s.n > 0;
        for (const Interaction& x : path_.vertices) any = any || x.site != no_site;
        if (any && max_channel(light.Le) > 0) visit(path_, {Technique::path_tracing, 0, next_event});
    };
    for (std::size_t k = 0; k < hit_light.size(); ++k) {
        // hit_light[k] lies at the end of segment k, behind k vertices.
        if (k >= y_.size() && k > 0) {
            // The path has left the scene.
            Stop& last = y_[k - 1];
            last.onward = interact(side_, last.v, last.back, last.ahead, last.lobe);
            path_.vertices.push_back(last.onward);
            path_.places.push_back(&last.v);
            path_.segments.push_back(segment_to_light(last.v, hit_light[k]));
            show(hit_light[k], false);
            break;
        }
        if (k == 0 && y_.empty()) {
            const FilmPoint film = scene.sensor.film_of(ray, 1);
            path_.sensor = {film.film, film.scale};
            const auto first = std::uint32_t(crossings_.size());
            path_.segments.push_back({1, 1, first, side_.cross(ray, scratch_, crossings_)});
            show(hit_light[0], false);
            break;
        }
        if (k > 0) {
            Stop& last = y_[k - 1];
            last.onward = interact(side_, last.v, last.back, last.ahead, last.lobe);
            path_.vertices.push_back(last.onward);
            path_.places.push_back(&last.v);
            path_.segments.push_back(last.segment);
        }
        if (max_channel(hit_light[k].Le) > 0) show(hit_light[k], false);
        Stop& here = y_[k];
        if (here.joined) {
            here.end = interact(side_, here.v, here.back, here.to_light, Lobe::none);
            path_.vertices.push_back(here.end);
            path_.places.push_back(&here.v);
            path_.segments.push_back(segment_to_light(here.v, here.light));
            show(here.light, true);
            path_.vertices.pop_back();
            path_.places.pop_back();
            path_.segments.pop_back();
        }
    }
    return true;
}

}  // namespace loom::residual
