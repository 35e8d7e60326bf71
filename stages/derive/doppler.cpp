#include "stages/derive/doppler.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <utility>

#include "formats/io/cost.h"
#include "formats/io/error.h"
#include "formats/transient_cube.h"
#include "stages/core/app/command.h"
#include "stages/core/compute/parallel.h"
#include "stages/core/scene/build.h"
#include "stages/core/scene/nlos.h"
#include "stages/derive/derive.h"

namespace loom::derive {
namespace {

using Vec = Vector3<double>;
using Pt = Point3<double>;

AffineVelocity operator*(const AffineVelocity& v, double s) {
    AffineVelocity scaled = v;
    for (double& x : scaled.linear) x *= s;
    scaled.offset = v.offset * s;
    return scaled;
}

AffineVelocity& operator+=(AffineVelocity& a, const AffineVelocity& b) {
    for (std::size_t i = 0; i < a.linear.size(); ++i) a.linear[i] += b.linear[i];
    a.offset = a.offset + b.offset;
    return a;
}

Vec& operator+=(Vec& a, const Vec& b) {
    return a = a + b;
}

/// The sum of all effects at their speeds, as that of one parameter.
template <class Effect>
Effects<Effect> summed(const Effects<Effect>& effects, std::span<const double> speeds) {
    Effects<Effect> sum;
    for (const auto& [p, effect] : effects) {
        if (speeds[p] == 0) continue;
        if (sum.empty())
            sum.push_back({0, effect * speeds[p]});
        else
            sum[0].effect += effect * speeds[p];
    }
    return sum;
}

struct Extent {
    double low = INFINITY, high = -INFINITY;

    void add(double x) { low = std::min(low, x), high = std::max(high, x); }
    void add(const Extent& o) { low = std::min(low, o.low), high = std::max(high, o.high); }
};

/// Bins whose outer ones are centred at the ends of an extent.
DopplerHeader::Bins bins_over(const Extent& extent, std::uint32_t n, double least) {
    if (!(extent.low <= extent.high)) return {n, -0.5 * least * n, least};
    const double size = extent.high - extent.low;
    const double floor = std::max(least, 1e-9 * std::max(std::abs(extent.low), std::abs(extent.high)));
    const double width = n > 1 ? std::max(size / (n - 1), floor) : std::max(size * (1 + 1e-9), floor);
    return {n, 0.5 * (extent.low + extent.high) - 0.5 * width * n, width};
}

/// Returns the bin of x; n beyond the last, 0 below the first.
std::size_t bin_of(const DopplerHeader::Bins& bins, double x) {
    const double k = std::floor((x - bins.start) / bins.width);
    return k < 0 ? 0 : k < bins.n ? std::size_t(k) : bins.n;
}

/// Velocity and beat frequency of light, in SI units.
struct Sensor {
    double metres_per_unit, wavelength, chirp;

    double velocity(const DopplerWalker::Light& light) const { return 0.5 * metres_per_unit * light.rate; }
    double beat(const DopplerWalker::Light& light) const {
        return chirp * light.opl * metres_per_unit / (speed_of_light * 1e9) + 2 * velocity(light) / wavelength;
    }
};

/// Sums of one pixel.
struct PixelSums {
    double light = 0, moment = 0;               // of luminance, and times velocity
    double light2 = 0, cross = 0, moment2 = 0;  // squares and product of the sums of single paths

    void add(double of_light, double of_moment) {
        light += of_light, moment += of_moment;
        light2 += sqr(of_light), cross += of_light * of_moment, moment2 += sqr(of_moment);
    }
    double mean() const { return light > 0 ? moment / light : 0.0; }
    /// Variance of the mean, a ratio, to first order.
    double variance(std::uint64_t n) const {
        if (n < 2 || !(light > 0)) return 0;
        const double m = mean(), squares = moment2 - 2 * m * cross + m * m * light2;
        return std::max(squares, 0.0) / sqr(light) * double(n) / double(n - 1);
    }
};

/// Calls f(light, path) for all light of a pixel, in the order of graphs and samples, and end_path() after each path.
template <class F, class EndPath>
void each_light(const std::vector<DopplerWalker>& walkers, std::span<const PathGraph> graphs, std::size_t pixel, F&& f,
                EndPath&& end_path) {
    for (std::size_t i = 0; i < graphs.size(); ++i)
        for (std::size_t path = pixel; path < graphs[i].n_paths(); path += graphs[i].n_pixels()) {
            walkers[i].walk(path, [&](const DopplerWalker::Light& light) {
                if (light.luminance > 0) f(light);
            });
            end_path();
        }
}

/// The beat that 99.9 % of the light of some paths does not exceed.
double late_beat(const DopplerWalker& walker, const PathGraph& graph, const Sensor& sensor) {
    constexpr std::size_t looked_at = 65536;
    std::vector<std::pair<double, double>> beats;  // (frequency, luminance)
    double energy = 0;
    const std::size_t step = std::max<std::size_t>(graph.n_paths() / looked_at, 1);
    for (std::size_t path = 0; path < graph.n_paths(); path += step)
        walker.walk(path, [&](const DopplerWalker::Light& light) {
            if (!std::isfinite(light.opl) || !(light.luminance > 0)) return;
            beats.emplace_back(sensor.beat(light), light.luminance);
            energy += light.luminance;
        });
    if (beats.empty()) return INFINITY;
    std::sort(beats.begin(), beats.end());
    double late = 0;
    std::size_t last = beats.size() - 1;
    while (last > 0 && late + beats[last].second < 1e-3 * energy) late += beats[last--].second;
    return beats[last].first;
}

}  // namespace

SceneTangents motion_of(const Scene& scene, const SceneTangents& tangents, std::span<const double> speeds) {
    SceneTangents motion(scene);
    motion.parameters = {{"time", "s", 0}};
    for (std::size_t s = 0; s < tangents.shapes.size(); ++s) {
        motion.shapes[s] = summed(tangents.shapes[s], speeds);
        for (const auto& effects : tangents.vertices[s]) motion.vertices[s].push_back(summed(effects, speeds));
    }
    for (std::size_t m = 0; m < tangents.materials.size(); ++m)
        motion.materials[m] = summed(tangents.materials[m], speeds);
    for (std::size_t e = 0; e < tangents.emitters.size(); ++e)
        motion.emitters[e] = summed(tangents.emitters[e], speeds);
    motion.camera = summed(tangents.camera, speeds);
    return motion;
}

std::string missing_for_doppler(const PathGraph& graph, const SceneTangents& motion) {
    bool primitives = false, media = false;
    for (const auto& vertices : motion.vertices) primitives |= !vertices.empty();
    for (const auto& effects : motion.materials)
        for (const auto& [p, t] : effects) media |= t.int_ior != 0;
    std::string missing;
    if (primitives && graph.vertices.primitive.empty()) missing = "--primitives";
    if (media && !graph.vertices.eta.empty() && graph.vertices.medium.empty())
        missing += missing.empty() ? "--media" : " --media";
    return missing;
}

DopplerWalker::DopplerWalker(const PathGraph& graph, const Scene& scene, const SceneTangents& motion)
    : graph_(graph), scene_(scene), motion_(motion), reader_(graph), motions_(scene, motion) {}

Vec DopplerWalker::material(std::uint32_t shape, std::uint32_t primitive, const Pt& p) const {
    if (!motion_.moves(shape)) return {};
    SurfacePlace place;
    place.shape_idx = shape;
    place.primitive_idx = primitive;
    place.p = p;
    PointMotion<1> motion;
    motions_.add_material(place, motion);
    return motion.p(0);
}

double DopplerWalker::index_rate(const Column<std::uint16_t>& media, std::size_t row) const {
    if (media.empty() || media[row] == no_medium) return 0;
    double rate = 0;
    for (const auto& [p, t] : motion_.materials[media[row]]) rate += t.int_ior;
    return rate;
}

void DopplerWalker::extend(Tip& tip, const Pt& x, const Vec& v, double eta, double deta) const {
    const Vec d = x - tip.x;
    const double r = length(d);
    tip.opl += eta * r;
    if (r > 0) tip.rate += eta * dot(d, v - tip.v) / r;
    tip.rate += deta * r;
    tip.x = x;
    tip.v = v;
}

DopplerWalker::Tip DopplerWalker::at_camera(std::size_t path) const {
    Tip tip;
    tip.x = camera_origin<double>(graph_, path);
    for (const auto& [p, v] : motion_.camera) tip.v = tip.v + v.at(tip.x);
    return tip;
}

void DopplerWalker::advance(std::size_t j, Tip& tip) const {
    const auto& v = graph_.vertices;
    const Pt x = position<double>(graph_, j);
    extend(tip, x, material(v.shape[j], v.primitive.empty() ? 0 : v.primitive[j], x),
           v.eta.empty() ? 1.0 : double(v.eta[j]), index_rate(v.medium, j));
}

DopplerWalker::Tip DopplerWalker::at_light(std::size_t path, std::size_t k, Tip tip) const {
    const auto& e = graph_.light_edges;
    const float* y = e.y.data() + 4 * k;
    const std::size_t emitter = e.emitter[k];
    const double eta = e.eta.empty() ? 1.0 : double(e.eta[k]), deta = index_rate(e.medium, k);
    if (y[3] == 0) {
        tip.rate -= eta * dot(Vec{y[0], y[1], y[2]}, tip.v);
        tip.opl = INFINITY;
        return tip;
    }
    const Pt light{y[0], y[1], y[2]};
    const auto of_emitter = [&](const Pt& p) {
        Vec v;
        for (const auto& [parameter, velocity] : motion_.emitters[emitter]) v = v + velocity.at(p);
        return v;
    };
    if (scene_.nlos && scene_.nlos->laser_sampling) {
        // The beam passes over the wall, whose matter scatters it.
        const NlosCapture& capture = *scene_.nlos;
        const std::size_t i = capture.laser_point(path % graph_.n_pixels());
        const Hit spot = i < capture.laser_points.size() ? capture.laser_points[i].hit : Hit{};
        extend(tip, light, spot ? material(spot.shape_idx, spot.primitive_idx, light) : Vec{}, eta, deta);
        if (graph_.emitters.position.empty()) return tip;
        const float* p = graph_.emitters.position.data() + 3 * emitter;
        const Pt laser{p[0], p[1], p[2]};
        extend(tip, laser, of_emitter(laser), eta, deta);
    } else if (scene_.emitters[emitter].kind == EmitterKind::area) {
        extend(tip, light, material(scene_.emitters[emitter].shape_idx, 0, light), eta, deta);
    } else {
        extend(tip, light, of_emitter(light), eta, deta);
    }
    return tip;
}

Doppler doppler_of(std::span<const PathGraph> graphs, const Scene& scene, const SceneTangents& motion,
                   const DopplerOptions& options) {
    Doppler d;
    d.film = {graphs[0].sensor.width, graphs[0].sensor.height, 0};
    for (const PathGraph& graph : graphs) d.film.samples_per_pixel += graph.tracing.samples_per_pixel;
    d.wavelength = options.wavelength;
    d.chirp = options.chirp;
    std::vector<DopplerWalker> walkers;
    walkers.reserve(graphs.size());
    for (const PathGraph& graph : graphs) walkers.emplace_back(graph, scene, motion);
    const Sensor sensor{options.metres_per_unit, options.wavelength, options.chirp};
    const std::size_t n_pixels = d.n_pixels();
    const double per_path = 1 / double(d.film.samples_per_pixel);
    constexpr std::uint64_t chunk = 64;

    // Mean velocities, and the extents of both spectra.
    std::vector<float> light(n_pixels), velocity(n_pixels), variance(n_pixels), never(n_pixels);
    std::vector<Extent> velocities((n_pixels + chunk - 1) / chunk), beats(velocities.size());
    parallel_chunks(n_pixels, chunk, options.threads, [&](std::uint64_t i, std::uint64_t begin, std::uint64_t end) {
        for (std::size_t pixel = begin; pixel < end; ++pixel) {
            PixelSums sums;
            double of_light = 0, of_moment = 0, without_beat = 0;
            each_light(
                walkers, graphs, pixel,
                [&](const DopplerWalker::Light& l) {
                    const double v = sensor.velocity(l);
                    of_light += l.luminance, of_moment += l.luminance * v;
                    velocities[i].add(v);
                    if (std::isfinite(l.opl))
                        beats[i].add(sensor.beat(l));
                    else
                        without_beat += l.luminance;
                },
                [&] { sums.add(std::exchange(of_light, 0), std::exchange(of_moment, 0)); });
            light[pixel] = float(sums.light * per_path);
            velocity[pixel] = float(sums.mean());
            variance[pixel] = float(sums.variance(d.film.samples_per_pixel));
            never[pixel] = float(without_beat * per_path);
        }
    });
    Extent of_velocity, of_beat;
    for (const Extent& extent : velocities) of_velocity.add(extent);
    for (const Extent& extent : beats) of_beat.add(extent);
    d.velocity_bins = bins_over(of_velocity, options.n_bins, 1e-12);
    if (options.chirp != 0) {
        of_beat.high = std::min(of_beat.high, late_beat(walkers[0], graphs[0], sensor));
        d.beat_bins = bins_over(of_beat, options.n_bins, 1e-12);
    }

    // Spectra.
    const std::size_t n = options.n_bins, n_beats = d.beat_bins.n;
    std::vector<float> spectrum(n_pixels * n), beat(n_pixels * n_beats), after(n_pixels);
    parallel_chunks(n_pixels, chunk, options.threads, [&](std::uint64_t, std::uint64_t begin, std::uint64_t end) {
        std::vector<double> by_velocity(n), by_beat(n_beats + 1);
        for (std::size_t pixel = begin; pixel < end; ++pixel) {
            std::fill(by_velocity.begin(), by_velocity.end(), 0.0);
            std::fill(by_beat.begin(), by_beat.end(), 0.0);
            each_light(
                walkers, graphs, pixel,
                [&](const DopplerWalker::Light& l) {
                    by_velocity[std::min(bin_of(d.velocity_bins, sensor.velocity(l)), n - 1)] += l.luminance;
                    if (n_beats > 0 && std::isfinite(l.opl))
                        by_beat[bin_of(d.beat_bins, sensor.beat(l))] += l.luminance;
                },
                [] {});
            for (std::size_t k = 0; k < n; ++k) spectrum[pixel * n + k] = float(by_velocity[k] * per_path);
            for (std::size_t k = 0; k < n_beats; ++k) beat[pixel * n_beats + k] = float(by_beat[k] * per_path);
            after[pixel] = float(by_beat[n_beats] * per_path);
        }
    });
    d.light = std::move(light);
    d.velocity = std::move(velocity);
    d.velocity_var_mean = std::move(variance);
    d.spectrum = std::move(spectrum);
    if (n_beats > 0) {
        d.beat = std::move(beat);
        d.beat_after = std::move(after);
        d.never = std::move(never);
    }
    return d;
}

void declare_doppler(app::Command& command, DopplerRequest& request) {
    command.output("--doppler", request.output,
                   "velocities and Doppler shifts (.h5) instead of derivatives; --wrt then moves in time");
    command.files("--with", request.graphs, "doppler: further path graphs of the scene, with other samples");
    command.option("--speed", request.speeds,
                   "doppler: NAME=SPEED of a parameter, its unit per second (default: 1 of a single one); may be "
                   "repeated, others rest");
    command.option("--wavelength", request.numbers.wavelength, "doppler: wavelength of the light",
                   app::Range<double>{1e-12, 1e6, "m"});
    command.option("--chirp", request.numbers.chirp,
                   "doppler: rate at which the light's frequency rises, for a beat spectrum (FMCW); 0: none",
                   app::Range<double>{0, 1e30, "Hz/s"});
    command.option("--doppler-bins", request.numbers.n_bins, "doppler: number of bins of each spectrum",
                   app::Range<std::uint32_t>{1, max_doppler_bins});
    command.option("--metres-per-unit", request.numbers.metres_per_unit, "doppler: length of one unit of the scene",
                   app::Range<double>{1e-12, 1e12, "m"});
    command.example("loom-derive moving.xml graph.h5 --wrt t --doppler doppler.h5 --chirp 1e14");
}

std::vector<double> speeds_of(const SceneTangents& tangents, const std::vector<std::string>& texts) {
    const auto& parameters = tangents.parameters;
    const auto names = [&] {
        std::string text;
        for (const Parameter& p : parameters) text += (text.empty() ? "" : ", ") + p.name;
        return text;
    };
    if (texts.empty()) {
        if (parameters.size() == 1) return {1.0};
        throw InputError(fmt::format("--doppler: {} parameters; give --speed NAME=SPEED of those that move: {}",
                                     parameters.size(), names()));
    }
    std::vector<double> speeds(parameters.size());
    for (const std::string& text : texts) {
        // A name may hold a '='.
        const std::size_t equals = text.rfind('=');
        const auto speed =
            equals == std::string::npos ? std::nullopt : app::parse_number<double>(text.substr(equals + 1));
        if (!speed || !std::isfinite(*speed)) throw InputError(fmt::format("--speed {}: expected NAME=SPEED", text));
        const std::string name = text.substr(0, equals);
        const auto found =
            std::find_if(parameters.begin(), parameters.end(), [&](const Parameter& p) { return p.name == name; });
        if (found == parameters.end())
            throw InputError(fmt::format("--speed {}: no parameter {}, only {}", text, name, names()));
        speeds[std::size_t(found - parameters.begin())] = *speed;
    }
    return speeds;
}

void run_doppler(const Options& options, app::Report& report) {
    const DopplerRequest& request = options.doppler;
    if (!options.output.empty() || options.plan)
        throw InputError("--doppler: has an output of its own; leave out --output and --plan");
    check_output_path(request.output);
    std::vector<std::string> files{options.graph};
    files.insert(files.end(), request.graphs.begin(), request.graphs.end());
    const Defines defines = parse_defines(options.defines);
    const SceneDescription description = read_scene(options.scene, defines, options.sensor);
    const std::unique_ptr<Scene> scene = build_scene(description);
    const SceneTangents tangents =
        find_tangents(*scene, description, options.scene, defines, options.sensor, options.wrt);
    const SceneTangents motion = motion_of(*scene, tangents, speeds_of(tangents, request.speeds));

    std::vector<PathGraph> graphs;
    std::vector<InputId> inputs;
    for (const std::string& file : files) {
        graphs.push_back(read_path_graph(file));
        require_scene_of(graphs.back(), file, *scene, options.scene);
        const PathGraph &first = graphs.front(), &graph = graphs.back();
        if (graph.sensor.width != first.sensor.width || graph.sensor.height != first.sensor.height)
            throw InputError(fmt::format("{}: another film size than {}", file, files[0]));
        if (const std::string missing = missing_for_doppler(graph, motion); !missing.empty())
            throw InputError(
                fmt::format("{}: lacks columns for these parameters; trace it with loom-trace {}", file, missing));
        inputs.push_back(identify_by_header(graph, file));
        for (std::size_t i = 0; i + 1 < inputs.size(); ++i)
            if (inputs[i].hash == inputs.back().hash)
                throw InputError(fmt::format("{}: the same paths as in {}", file, files[i]));
    }
    inputs.insert(inputs.begin(), {app::base_name(options.scene), graphs[0].provenance.inputs[0].hash});

    DopplerOptions numbers = request.numbers;
    numbers.threads = options.threads;
    Doppler doppler = doppler_of(graphs, *scene, motion, numbers);
    const bool has_beat = numbers.chirp != 0;
    const std::string plan = has_beat ? "on: velocities, beat; off: nothing" : "on: velocities; off: beat (no --chirp)";
    doppler.provenance = report.provenance(graphs[0].provenance.seed, std::move(inputs), plan);
    write_doppler(doppler, request.output);
    Cost cost = report.cost(plan);
    for (const PathGraph& graph : graphs) cost.samples += graph.n_paths();
    cost.sources = {options.scene};
    write_cost_of(request.output, cost, files);
    const auto& bins = doppler.velocity_bins;
    report.done("{} paths; {} bins of {:.4g} m/s from {:.4g} m/s{}", cost.samples, bins.n, bins.width, bins.start,
                has_beat
                    ? fmt::format(", of {:.4g} Hz from {:.4g} Hz", doppler.beat_bins.width, doppler.beat_bins.start)
                    : std::string());
}

}  // namespace loom::derive
