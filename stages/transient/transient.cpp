#include "stages/transient/transient.h"

#include <fmt/format.h>

#include <algorithm>
#include <filesystem>
#include <fstream>
#include <sstream>

#include "formats/io/cost.h"
#include "formats/io/error.h"
#include "stages/core/app/command.h"
#include "stages/core/app/values.h"
#include "stages/core/clusters/shared_arrivals.h"
#include "stages/transient/tal.h"

namespace loom::transient {
namespace {

constexpr std::uint32_t default_bins = 300;

const std::vector<std::pair<std::string, Shape>> shapes{
    {"film", Shape::film},         {"delta", Shape::delta}, {"box", Shape::box},   {"gaussian", Shape::gaussian},
    {"expgauss", Shape::expgauss}, {"table", Shape::table}, {"sine", Shape::sine}, {"square", Shape::square}};

/// Converts the user's values to optical path lengths, in units of the scene.
class Lengths {
  public:
    explicit Lengths(const Options& options)
        : factor_(options.unit == Unit::ns ? speed_of_light / options.metres_per_unit : 1) {}
    double operator()(double in_unit) const { return in_unit * factor_; }

  private:
    double factor_;
};

std::vector<std::pair<float, float>> parse_group_index(const std::vector<std::string>& texts) {
    std::vector<std::pair<float, float>> table;
    for (const std::string& text : texts) {
        const auto equals = text.find('=');
        const auto phase = app::parse_number<float>(text.substr(0, equals));
        const auto group =
            equals == std::string::npos ? std::nullopt : app::parse_number<float>(text.substr(equals + 1));
        if (!phase || !group || !(*phase > 0) || !(*group > 0))
            throw InputError(fmt::format("--group-index {}: expected PHASE=GROUP, two positive numbers", text));
        table.emplace_back(*phase, *group);
    }
    return table;
}

Pulse read_pulse_table(const std::string& file, const Lengths& lengths) {
    std::ifstream in(file);
    std::vector<double> at, power;
    std::string line;
    for (int number = 1; std::getline(in, line); ++number) {
        line = line.substr(0, line.find('#'));
        if (line.find_first_not_of(" \t\r") == std::string::npos) continue;
        std::istringstream words(line);
        double t, p;
        std::string rest;
        if (!(words >> t >> p) || words >> rest)
            throw InputError(fmt::format("{}:{}: expected two numbers, time and power", file, number));
        at.push_back(lengths(t));
        power.push_back(p);
    }
    try {
        return Pulse::table(std::move(at), std::move(power));
    } catch (const InputError& error) {
        throw InputError(fmt::format("{}: {}", file, error.what()));
    }
}

double positive(double value, const char* option, const char* what) {
    if (!(value > 0)) throw InputError(fmt::format("{}: missing; give {}", option, what));
    return value;
}

/// Sets the pulse, and stores it in the header.
void set_pulse(const Options& options, double film_sigma, const Lengths& lengths, TimeResponse& response,
               TransientCubeHeader& header) {
    auto& said = header.response;
    const double length = lengths(options.pulse_length), tail = lengths(options.pulse_tail);
    Shape shape = options.pulse;
    if (shape == Shape::film) {
        shape = film_sigma > 0 ? Shape::gaussian : Shape::delta;
        said.length_opl = film_sigma;
    } else if (shape == Shape::box || shape == Shape::gaussian || shape == Shape::expgauss) {
        said.length_opl =
            positive(length, "--pulse-length",
                     shape == Shape::box ? "the length of the pulse" : "the standard deviation of the pulse");
    } else if (options.pulse_length != 0) {
        throw InputError("--pulse-length: needs --pulse box, gaussian or expgauss");
    }
    if ((shape == Shape::expgauss) != (tail != 0)) throw InputError("--pulse expgauss and --pulse-tail: give both");
    if ((shape == Shape::table) != !options.pulse_table.empty())
        throw InputError("--pulse table and --pulse-table: give both");
    switch (shape) {
        case Shape::film:
        case Shape::delta:
            break;
        case Shape::box:
            said.pulse = "box", response.pulse = Pulse::box(said.length_opl);
            break;
        case Shape::gaussian:
            said.pulse = "gaussian", response.pulse = Pulse::gaussian(said.length_opl);
            break;
        case Shape::expgauss:
            said.pulse = "expgauss";
            said.tail_opl = positive(tail, "--pulse-tail", "the mean delay");
            response.pulse = Pulse::exponential_gaussian(said.length_opl, said.tail_opl);
            break;
        case Shape::table:
            said.pulse = "table", response.pulse = read_pulse_table(options.pulse_table, lengths);
            break;
        case Shape::sine:
        case Shape::square:
            said.pulse = shape == Shape::sine ? "sine" : "square";
            response.modulation = shape == Shape::sine ? Modulation::sine : Modulation::square;
            break;
    }
}

/// Refuses graphs of different films.
void check_graphs(const std::vector<std::string>& names, const std::vector<PathGraph>& graphs) {
    for (std::size_t i = 0; i < graphs.size(); ++i) {
        const auto scene = [](const PathGraph& g) {
            return g.provenance.inputs.empty() ? std::string() : g.provenance.inputs[0].hash;
        };
        if (graphs[i].sensor.width != graphs[0].sensor.width || graphs[i].sensor.height != graphs[0].sensor.height)
            throw InputError(fmt::format("{}: is {} x {}, but {} is {} x {}", names[i], graphs[i].sensor.width,
                                         graphs[i].sensor.height, names[0], graphs[0].sensor.width,
                                         graphs[0].sensor.height));
        if (scene(graphs[i]) != scene(graphs[0]))
            throw InputError(
                fmt::format("{}: was traced in another scene than {}, or with other -D values", names[i], names[0]));
    }
}

/// Reads the clusters of each graph; none without --clusters.
std::vector<Clusters> read_all_clusters(const Options& options, const std::vector<PathGraph>& graphs,
                                        const std::vector<InputId>& ids) {
    if (!options.clusters.empty() && options.clusters.size() != graphs.size())
        throw InputError(fmt::format("--clusters: {} files for {} graphs", options.clusters.size(), graphs.size()));
    std::vector<Clusters> clusters;
    for (std::size_t i = 0; i < options.clusters.size(); ++i) {
        clusters.push_back(read_clusters(options.clusters[i]));
        require_clusters_of(graphs[i], ids[i], clusters[i], options.clusters[i]);
        if (graphs[i].tracing.samples_per_pixel != graphs[0].tracing.samples_per_pixel)
            throw InputError(
                fmt::format("{}: has {} samples per pixel, but {} has {}; with --clusters all graphs need as many",
                            options.graphs[i], graphs[i].tracing.samples_per_pixel, options.graphs[0],
                            graphs[0].tracing.samples_per_pixel));
    }
    return clusters;
}

/// Whether light arrives earlier or later when a parameter changes.
bool changes_lengths(const Derivative& derivative, std::size_t parameter) {
    for (const Column<float>* dopl : {&derivative.interior.dopl, &derivative.light_points.dopl, &derivative.seen.dopl})
        for (std::size_t i = parameter; i < dopl->size(); i += derivative.n_parameters())
            if ((*dopl)[i] != 0) return true;
    return false;
}

/// Refuses derivatives whose lengths of flight cannot be counted with group indices.
void check_lengths(const Timing& timing, const std::string& file, const Derivative& derivative) {
    if (timing.group_index.empty()) return;
    if (!derivative.boundary.opl.empty())
        throw InputError(
            fmt::format("{}: has {} boundary rows, whose lengths count with phase indices; leave out --group-index",
                        file, derivative.boundary.opl.size()));
    bool moves = false;
    for (std::size_t p = 0; p < derivative.n_parameters(); ++p) moves = moves || changes_lengths(derivative, p);
    if (moves)
        throw InputError(fmt::format(
            "{}: interior/dopl is of lengths with phase indices, for all segments of a path together; leave "
            "out --group-index",
            file));
}

/// Reads the derivative of each graph and sets the parameters of the header; none without --derivative.
std::vector<Derivative> read_all_derivatives(const Options& options, const std::vector<PathGraph>& graphs,
                                             TransientCubeHeader& header) {
    if (options.derivatives.empty()) return {};
    if (options.derivatives.size() != graphs.size())
        throw InputError(
            fmt::format("--derivative: {} files for {} graphs", options.derivatives.size(), graphs.size()));
    std::vector<Derivative> derivatives;
    for (std::size_t i = 0; i < options.derivatives.size(); ++i) {
        const std::string& file = options.derivatives[i];
        derivatives.push_back(read_derivative(file));
        require_derivative_of(graphs[i], identify_by_header(graphs[i], options.graphs[i]), derivatives[i], file);
        const auto& p = derivatives[i].parameters;
        TransientCubeHeader of_file;
        of_file.parameters = {p.name, p.unit, std::vector<std::string>(p.name.size(), "none"),
                              std::vector<double>(p.value.begin(), p.value.end())};
        if (i == 0)
            header.parameters = of_file.parameters;
        else if (const std::string why = parameter_difference_in_words(of_file, header); !why.empty())
            throw InputError(fmt::format("{}: {} (of {})", file, why, options.derivatives[0]));
    }
    return derivatives;
}

/// Light that a derivative moves between bins by one parameter.
struct Moved {
    bool exact = false, widened = false;
};
Moved moved_by(const Derivative& derivative, std::size_t parameter) {
    Moved moved;
    const std::size_t n = derivative.n_parameters();
    const auto& dopl = derivative.interior.dopl;
    for (std::size_t row = 0; row < derivative.interior.edge.size(); ++row) {
        if (dopl[row * n + parameter] == 0) continue;
        (derivative.temporal.is_exact[row] ? moved.exact : moved.widened) = true;
    }
    for (const Column<float>* other : {&derivative.light_points.dopl, &derivative.seen.dopl})
        for (std::size_t i = parameter; i < other->size(); i += n) moved.widened = moved.widened || (*other)[i] != 0;
    return moved;
}

/// Returns which borders of a derivative's temporal rows are those of the bins.
/// throws:  InputError naming both
ExactBorders exact_borders(const Derivative& derivative, const std::string& file, const TimeResponse& response,
                           const Timing& timing) {
    if (!derivative.has_temporal())
        throw InputError(
            fmt::format("--temporal exact: {} has no samples at the borders of bins; run loom-derive with "
                        "--temporal exact, --start, --width and --bins",
                        file));
    const auto& own = derivative.temporal_bins;
    const double start = own.start_opl[0], width = own.width_opl[0];
    if ((own.camera_segment[0] != 0) != timing.camera_segment)
        throw InputError(fmt::format(
            "--temporal exact: lengths in {} count from the {}, but those of the bins from the "
            "{}",
            file, own.camera_segment[0] ? "camera" : "first hit", timing.camera_segment ? "camera" : "first hit"));
    constexpr double tolerance = 1e-9;
    const double step = std::round(response.width / width), first = std::round((response.start - start) / width),
                 n = response.n_bins;
    const double slack = tolerance * std::max({std::abs(response.start), std::abs(response.end()), response.width});
    const bool fits = step >= 1 && first >= 0 && first + n * step <= own.n[0] && response.gate == response.width &&
                      std::abs(start + first * width - response.start) <= slack &&
                      std::abs(start + (first + n * step) * width - response.end()) <= slack;
    if (!fits)
        throw InputError(
            fmt::format("--temporal exact: {} bins of {:.9g} m from {:.9g} m, gates of {:.9g} m; their borders must be "
                        "borders of the {} bins of {:.9g} m from {:.9g} m in {}, and gates as long as bins",
                        response.n_bins, response.width, response.start, response.gate, own.n[0], width, start, file));
    return {std::uint32_t(first), std::uint32_t(step)};
}

/// Sets for each parameter whether the derivative of its bins is complete, and says so.
/// out:     borders of each derivative's temporal rows; empty: they are not used
std::vector<ExactBorders> set_temporal(const Options& options, const std::vector<Derivative>& derivatives,
                                       const TimeResponse& response, const Timing& timing, TransientCubeHeader& header,
                                       app::Report& report) {
    const bool is_delta = response.pulse.is_delta() && response.modulation == Modulation::none;
    if (options.temporal == Temporal::exact && (!is_delta || derivatives.empty()))
        throw InputError("--temporal exact: needs --derivative and a delta pulse; any other pulse is exact as it is");
    if (!is_delta && response.widened == 0) return {};
    std::vector<ExactBorders> borders;
    if (options.temporal == Temporal::exact)
        for (std::size_t i = 0; i < derivatives.size(); ++i)
            borders.push_back(exact_borders(derivatives[i], options.derivatives[i], response, timing));
    std::string widened;
    for (std::size_t p = 0; p < header.n_parameters(); ++p) {
        Moved moved;
        for (const Derivative& d : derivatives) {
            const Moved by = borders.empty() ? Moved{false, changes_lengths(d, p)} : moved_by(d, p);
            moved.exact = moved.exact || by.exact;
            moved.widened = moved.widened || by.widened;
        }
        if (!moved.exact && !moved.widened) continue;
        if (is_delta && options.temporal == Temporal::refuse)
            throw InputError(
                fmt::format("--temporal refuse: {} changes arrival times, and bins jump with a delta pulse; give "
                            "another --pulse, or --temporal widen or exact",
                            header.parameters.name[p]));
        header.parameters.temporal[p] = !moved.widened ? "exact" : moved.exact ? "partly" : "widened";
        if (moved.widened) widened += (widened.empty() ? "" : ", ") + header.parameters.name[p];
    }
    if (!widened.empty() && response.widened > 0)
        report.info(
            "light that moves between bins is the mean over {:.6g} {} of arrival time, for the derivatives by {}",
            *options.widen, options.unit == Unit::ns ? "ns" : "m", widened);
    else if (!widened.empty())
        report.info(
            "delta pulse: {}light that moves between bins is that of a box pulse one bin long, for the "
            "derivatives by {}",
            borders.empty() ? "" : "a part of the ", widened);
    return borders;
}

/// Sets the length over which slopes are averaged.
void set_widened(const Options& options, const Lengths& lengths, TimeResponse& response) {
    if (!options.widen) return;
    if (options.derivatives.empty()) throw InputError("--widen: needs --derivative");
    if (options.temporal != Temporal::widen) throw InputError("--widen: needs --temporal widen");
    if (response.modulation != Modulation::none)
        throw InputError("--widen: a modulation is as wide as its period; give another --pulse");
    response.widened = lengths(*options.widen);
}

void check_tal(const Options& options, const PathGraph& graph) {
    if (options.tal.empty()) return;
    check_output_path(options.tal);
    if (graph.sensor.kind != "nlos_capture_meter")
        throw InputError(fmt::format("--tal: {} is no NLOS capture (sensor nlos_capture_meter)", options.graphs[0]));
}

/// Sets the bins of a modulation: phases of one period.
void set_phases(const Options& options, const Lengths& lengths, TimeResponse& response, TransientCubeHeader& header) {
    if (options.start || options.width || options.gate)
        throw InputError("--pulse sine, square: bins are phases; leave out --start, --width and --gate");
    response.n_bins = options.bins.value_or(4);
    if (response.n_bins < 2 || (response.modulation == Modulation::square && response.n_bins % 2 != 0))
        throw InputError(fmt::format("--bins {}: {} needs {} phases", response.n_bins, header.response.pulse,
                                     response.modulation == Modulation::sine ? "two or more" : "an even number of"));
    response.period = header.response.period_opl =
        lengths(positive(options.period, "--period", "the period of the modulation"));
    response.start = 0;
    response.width = response.gate = response.period / response.n_bins;
}

/// Sets the bins of a pulse: by the options, else the film of the graph, else where its light arrives.
void set_window(const Options& options, const Lengths& lengths, const PathGraph& graph, const Timing& timing,
                TimeResponse& response) {
    if (options.period != 0) throw InputError("--period: needs --pulse sine or square");
    const auto& film = graph.transient;
    const bool has_film = !film.n_bins.empty();
    response.n_bins = options.bins.value_or(has_film ? film.n_bins[0] : default_bins);
    const Window window = has_film || (options.start && options.width) ? Window{} : window_of(graph, timing);
    response.start = options.start ? lengths(*options.start) : has_film ? film.start_opl[0] : window.start;
    response.width = options.width ? lengths(*options.width)
                     : has_film    ? film.bin_width_opl[0]
                                   : (window.end - response.start) / response.n_bins;
    if (!(response.width > 0))
        throw InputError(fmt::format("--start {}: no light arrives after it; give --width", *options.start));
    response.gate = options.gate ? lengths(*options.gate) : response.width;
}

/// Radiance of a cube, summed over its pixels.
struct LightSums {
    Rgb<double> steady, inside, before, after, never;

    void add(const TransientRows& rows) {
        add(rows.radiance, inside);
        add(rows.before, before);
        add(rows.after, after);
        add(rows.never, never);
        add(rows.steady, steady);
    }
    double percent(const Rgb<double>& part) const {
        return luminance(steady) > 0 ? 100 * luminance(part) / luminance(steady) : 0.0;
    }

  private:
    static void add(std::span<const float> values, Rgb<double>& sum) {
        for (std::size_t i = 0; i < values.size(); i += 3) sum += Rgb<double>(values[i], values[i + 1], values[i + 2]);
    }
};

std::string plan_of(const TransientCubeHeader& header, double widened, bool shares, bool camera_segment) {
    std::string derivatives;
    const std::string by = widened > 0 ? fmt::format("{:.6g} m", widened) : "a bin";
    const auto& p = header.parameters;
    for (std::size_t i = 0; i < header.n_parameters(); ++i)
        derivatives += fmt::format("{}{}{}", i == 0 ? ", derivatives by " : ", ", p.name[i],
                                   p.temporal[i] == "widened"  ? fmt::format(" (response widened by {})", by)
                                   : p.temporal[i] == "partly" ? " (response widened by a bin for a part)"
                                   : p.temporal[i] == "exact"  ? " (exact at the borders of bins)"
                                                               : "");
    return fmt::format("on: {}{} pulse, {}{}; off: {}", shares ? "light shared by clusters at first hits, " : "",
                       header.response.pulse, camera_segment ? "camera segment" : "lengths from the first hit",
                       derivatives, derivatives.empty() ? "derivatives" : "nothing");
}

/// Returns options with the bins and the pulse of the cube `like`.
Options as_like(Options options) {
    const TransientCube cube = read_any_cube(options.like);
    if (options.bins || options.start || options.width || options.gate || options.pulse != Shape::film ||
        options.pulse_length != 0 || options.pulse_tail != 0 || options.period != 0)
        throw InputError("--like: leave out --bins, --start, --width, --gate, --period and the options of the pulse");
    const double unit = Lengths(options)(1);
    const auto& t = cube.time;
    options.bins = t.n_bins;
    options.start = t.start_opl / unit, options.width = t.bin_width_opl / unit, options.gate = t.gate_opl / unit;
    options.unwarp |= t.camera_segment == 0;
    const auto& r = cube.response;
    if (!r.pulse.empty()) {
        const auto shape =
            std::find_if(shapes.begin(), shapes.end(), [&](const auto& s) { return s.first == r.pulse; });
        if (shape == shapes.end() || shape->second == Shape::table)
            throw InputError(
                fmt::format("--like {}: has a pulse by a table; give the options of the pulse", options.like));
        options.pulse = shape->second;
        options.pulse_length = r.length_opl / unit, options.pulse_tail = r.tail_opl / unit;
        options.period = r.period_opl / unit;
    }
    options.like.clear();
    return options;
}

}  // namespace

void declare(app::Command& command, Options& options) {
    command.files("graphs", options.graphs, "path graphs (.h5) of one scene with different samples").required();
    command.files("--clusters", options.clusters,
                  "clusters (.h5) of these graphs, in their order; first hits share the light of their cluster");
    command.files("--derivative", options.derivatives,
                  "derivatives (.h5) of these graphs, in their order; the cube then holds the derivative of each bin");
    command.choice(
        "--temporal", options.temporal,
        "delta pulse with derivatives that change arrival times: widen the response by a bin, use the samples "
        "of loom-derive --temporal exact, or refuse",
        {{"widen", Temporal::widen}, {"exact", Temporal::exact}, {"refuse", Temporal::refuse}});
    command.option(
        "--widen", options.widen,
        "any pulse: average what moves between bins over this length of arrival time, centred; less noise, and "
        "a bias of the order of its square (default: a delta pulse by a bin, others not)",
        app::Range<double>{1e-12, 1e12});
    command.output("-o,--output", options.output, "transient cube (.h5)");
    command.output("--tal", options.tal, "also write an NLOS capture in the format of the TAL tools (.h5)");
    command.choice("--unit", options.unit,
                   "unit of all lengths of these options and of the cube's labels: optical path length in units of the "
                   "scene, or nanoseconds",
                   {{"opl", Unit::opl}, {"ns", Unit::ns}});
    command.option("--metres-per-unit", options.metres_per_unit, "length of one unit of the scene",
                   app::Range<double>{1e-12, 1e12, "m"});
    command.file(
        "--like", options.like,
        "cube (.h5), ours or any with mean and var_mean, whose bins and pulse are taken in place of the film's");
    command.option("--bins", options.bins, "number of bins (default: the film's, else 300)",
                   app::Range<std::uint32_t>{1, 1u << 24});
    command.option("--start", options.start,
                   "start of the first bin (default: the film's, else the first arrival of light)");
    command.option("--width", options.width,
                   "distance between bins (default: the film's, else 99.9 % of the light is in the window)",
                   app::Range<double>{1e-12, 1e12});
    command.option("--gate", options.gate,
                   "length of time that a bin is open (default: --width, so that bins tile the time)",
                   app::Range<double>{1e-12, 1e12});
    command.choice("--pulse", options.pulse,
                   "shape of the light in time: the film's, a delta, box or Gaussian pulse, a Gaussian with an "
                   "exponential tail, a table, or a modulation with --bins phases of one period",
                   shapes);
    command.option("--pulse-length", options.pulse_length, "box: length; gaussian, expgauss: standard deviation",
                   app::Range<double>{0, 1e12});
    command.option("--pulse-tail", options.pulse_tail, "expgauss: mean delay of the exponential tail",
                   app::Range<double>{0, 1e12});
    command.file("--pulse-table", options.pulse_table, "table: text file with time and power in each line");
    command.option("--period", options.period, "sine, square: period of the modulation", app::Range<double>{0, 1e12});
    command.flag("--unwarp", options.unwarp, "count lengths from the first hit, not from the camera");
    command.option("--group-index", options.group_index, "PHASE=GROUP: group index of media with this phase index");
    command.option("--memory", options.memory_MiB, "memory for the block of rows in work",
                   app::Range<std::uint64_t>{1, 1u << 20, "MiB"});
    command.threads(options.threads);
    command.example(
        "loom-transient graph.h5 -o cube.h5 --unit ns --start 10 --width 0.05 --bins 400 --pulse gaussian "
        "--pulse-length 0.1");
}

void run(const Options& given, app::Report& report) {
    const Options options = given.like.empty() ? given : as_like(given);
    if (options.output.empty()) throw InputError("--output: missing (an .h5 file)");
    if (!options.clusters.empty() && !options.derivatives.empty())
        throw InputError(
            "--derivative, --clusters: give only one of them; derivatives are of the light that each path found "
            "itself, not of light shared by clusters");
    check_output_path(options.output);
    const Lengths lengths(options);
    std::vector<PathGraph> graphs;
    TransientCubeHeader header;
    for (const std::string& file : options.graphs) {
        graphs.push_back(read_path_graph(file));
        header.film.samples_per_pixel += graphs.back().tracing.samples_per_pixel;
    }
    header.provenance.inputs = identify_parts(options.graphs);
    check_graphs(options.graphs, graphs);
    const std::vector<Clusters> clusters = read_all_clusters(options, graphs, header.provenance.inputs);
    const std::vector<Derivative> derivatives = read_all_derivatives(options, graphs, header);
    for (const auto* files : {&options.clusters, &options.derivatives})
        for (const std::string& file : *files) header.provenance.inputs.push_back(identify(file));
    if (!given.like.empty()) header.provenance.inputs.push_back(identify(given.like));
    check_tal(options, graphs[0]);

    // Set the response: pulse and bins.
    const auto& film = graphs[0].transient;
    const bool has_film = !film.n_bins.empty();
    Timing timing{!options.unwarp && (!has_film || film.camera_segment[0] != 0),
                  parse_group_index(options.group_index)};
    TimeResponse response;
    set_pulse(options, has_film ? film.sigma_opl[0] : 0, lengths, response, header);
    if (response.modulation != Modulation::none)
        set_phases(options, lengths, response, header);
    else
        set_window(options, lengths, graphs[0], timing, response);
    for (std::size_t i = 0; i < derivatives.size(); ++i) check_lengths(timing, options.derivatives[i], derivatives[i]);
    set_widened(options, lengths, response);
    const std::vector<ExactBorders> borders = set_temporal(options, derivatives, response, timing, header, report);

    // Fill the header of the cube.
    header.film.width = graphs[0].sensor.width;
    header.film.height = graphs[0].sensor.height;
    header.time = {response.n_bins,
                   response.start,
                   response.width,
                   response.gate,
                   options.unit == Unit::ns ? "ns" : "opl",
                   options.metres_per_unit,
                   timing.camera_segment};
    header.provenance = report.provenance(graphs[0].provenance.seed, std::move(header.provenance.inputs),
                                          plan_of(header, response.widened, !clusters.empty(), timing.camera_segment));
    const std::uint64_t cube_bytes =
                            2 * sizeof(float) * (1 + header.n_parameters()) * header.row_size() * header.film.height,
                        max_bytes = options.memory_MiB << 20;
    report.info("{} x {} pixels, {} bins of {:.6g} {} from {:.6g}: {}, of which {} in memory", header.film.width,
                header.film.height, response.n_bins, header.in_unit(response.width),
                header.time.unit == "ns" ? "ns" : "m", header.in_unit(response.start), app::bytes_text(cube_bytes),
                app::bytes_text(std::min(cube_bytes, max_bytes)));

    // Bin the paths, row by row of the film.
    TalCapture tal;
    if (!options.tal.empty()) tal = start_capture(graphs[0], header);
    LightSums light;
    {
        TransientCubeWriter writer(options.output, header);
        app::Progress progress(report, "binning", header.n_pixels());
        std::vector<SharedArrivals> shared;
        for (std::size_t i = 0; i < clusters.size(); ++i)
            shared.emplace_back(graphs[i], clusters[i], timing, options.threads);
        bin_graphs(
            graphs, shared, derivatives, response, timing, max_bytes, options.threads, progress,
            [&](std::uint32_t first_row, const TransientRows& rows) {
                writer.write_rows(first_row, rows);
                if (!options.tal.empty()) add_rows(graphs[0], first_row, rows, tal);
                light.add(rows);
            },
            borders);
        writer.commit();
    }
    if (!options.tal.empty()) write_tal_capture(tal, options.tal);
    if (!std::isfinite(luminance(light.steady))) report.warn("the sums hold light that is not finite");

    Cost cost = report.cost(header.provenance.plan);
    for (const PathGraph& g : graphs) cost.samples += g.n_paths();
    std::vector<std::string> parents = options.graphs;
    for (const auto* files : {&options.clusters, &options.derivatives})
        parents.insert(parents.end(), files->begin(), files->end());
    write_cost_of(options.output, cost, parents);
    report.done("{} paths; light: {:.4g} % in the bins, {:.3g} % before, {:.3g} % after, {:.3g} % never", cost.samples,
                light.percent(light.inside), light.percent(light.before), light.percent(light.after),
                light.percent(light.never));
}

}  // namespace loom::transient
