#include "stages/residual/stored/old_graph.h"

#include <fmt/format.h>
#include <tbb/enumerable_thread_specific.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <deque>
#include <filesystem>
#include <optional>

#include "formats/io/content_hash.h"
#include "formats/io/error.h"
#include "stages/core/app/report.h"
#include "stages/core/app/values.h"
#include "stages/core/tracing/film.h"
#include "stages/core/tracing/graph_builder.h"
#include "stages/residual/control/seen_emission.h"
#include "stages/residual/stored/path_parts.h"
#include "stages/residual/stored/resumed_paths.h"

namespace loom::residual {
namespace {

constexpr const char* rgb[] = {"R", "G", "B"};

template <class Enum>
std::optional<Enum> named(std::string_view name, std::string_view (*name_of)(Enum),
                          std::initializer_list<Enum> values) {
    for (const Enum value : values)
        if (name_of(value) == name) return value;
    return std::nullopt;
}

bool alike(const PathOptions& a, const PathOptions& b) {
    return a.seed == b.seed && a.sampler == b.sampler && a.roulette == b.roulette && a.rr_depth == b.rr_depth &&
           a.max_depth == b.max_depth;
}

PathOptions options_of(const PathGraph& graph, const std::string& file) {
    PathOptions path;
    path.seed = graph.provenance.seed;
    path.rr_depth = graph.tracing.roulette_depth;
    path.max_depth = graph.tracing.max_depth;
    const auto sampler = named(graph.tracing.sampler, sampler_name, {SamplerKind::sobol, SamplerKind::independent});
    const auto roulette =
        named(graph.tracing.roulette, roulette_name, {Roulette::albedo, Roulette::throughput, Roulette::off});
    if (!sampler || !roulette)
        throw InputError(
            fmt::format("{}: was traced with sampler {} and roulette {}, which this build does not support", file,
                        graph.tracing.sampler, graph.tracing.roulette));
    path.sampler = *sampler;
    path.roulette = *roulette;
    return path;
}

void check_pass(const PathGraph& graph, const std::string& file, const Scene& old_scene, const std::string& scene_name,
                int max_depth) {
    const Provenance& made = graph.provenance;
    if (made.stage != "loom-trace")
        throw InputError(
            fmt::format("{}: --old-graph: was written by {}; only paths as loom-trace writes them can be traced again",
                        file, made.stage));
    const std::string hash = content_hash_text(old_scene.content_hash);
    if (std::none_of(made.inputs.begin(), made.inputs.end(), [&](const InputId& i) { return i.hash == hash; }))
        throw InputError(fmt::format(
            "{}: is a graph of {} with content {}, not of {} with these values, whose content is {}; trace it again",
            file, made.inputs.empty() ? "an unknown scene" : made.inputs[0].name,
            made.inputs.empty() ? "unknown" : made.inputs[0].hash, scene_name, hash));
    if (graph.sensor.width != old_scene.sensor.width || graph.sensor.height != old_scene.sensor.height)
        throw InputError(fmt::format("{}: is of {} x {} pixels, but the film of {} has {} x {}", file,
                                     graph.sensor.width, graph.sensor.height, scene_name, old_scene.sensor.width,
                                     old_scene.sensor.height));
    if (graph.tracing.max_depth != max_depth)
        throw InputError(fmt::format("{}: was traced with max_depth {}, not {}; give --max-depth {}", file,
                                     graph.tracing.max_depth, max_depth, graph.tracing.max_depth));
    if (graph.shapes.id.size() != old_scene.shapes.size() || graph.emitters.id.size() != old_scene.emitters.size())
        throw InputError(fmt::format("{}: has {} shapes and {} lights, but {} has {} and {}", file,
                                     graph.shapes.id.size(), graph.emitters.id.size(), scene_name,
                                     old_scene.shapes.size(), old_scene.emitters.size()));
}

std::uint64_t end_of(const PathGraph& graph) {
    return graph.tracing.first_sample + graph.tracing.samples_per_pixel;
}

/// A command of loom-trace without the options that choose its samples.
struct TraceCommand {
    std::string rest;
    std::uint64_t first = 0, spp = 0;
};
std::optional<TraceCommand> parse(std::string command) {
    TraceCommand parsed;
    for (const auto& [flag, value] :
         {std::pair<std::string, std::uint64_t*>{" --first-sample ", &parsed.first}, {" --spp ", &parsed.spp}}) {
        const auto at = command.find(flag);
        if (at == std::string::npos) return std::nullopt;
        const auto digits = at + flag.size(), end = std::min(command.find(' ', digits), command.size());
        const std::optional<std::uint64_t> number =
            app::parse_number<std::uint64_t>(command.substr(digits, end - digits));
        if (!number) return std::nullopt;
        *value = *number;
        command.erase(at, end - at);
    }
    for (const std::string same_paths : {" --passes 1", " --misses", " --primitives", " --media"})
        if (const auto at = command.find(same_paths); at != std::string::npos) command.erase(at, same_paths.size());
    parsed.rest = std::move(command);
    return parsed;
}

/// Where the pairs of one new scene go.
struct Output {
    GraphResidual result;
    Film film;
    tracing::NonfiniteLog old_nonfinite, new_nonfinite;

    Output(const Sensor& sensor, const OldGraph& graph, const GraphJob& job, app::Report& report)
        : film(sensor.width, sensor.height, graph.spp),
          old_nonfinite(report, sensor.width, graph.path.seed, " of the old scene"),
          new_nonfinite(report, sensor.width, graph.path.seed, " of the new scene") {
        result.why_all = job.reach.everything;
        for (auto& squares : result.squares) squares.resize(job.old_picture ? sensor.n_pixels() : 0);
    }
};

/// Paths of a chunk of pixels in the old scene and in one new one. State of one thread.
class PairsOfScene {
  public:
    tracing::Counts counts;
    std::uint64_t touched = 0, probed = 0, others = 0;  // probed paths that differ from the graph's
    std::string other;                                  // name of one of them

    /// in:  passes  of the graph
    PairsOfScene(const Scene& old_scene, const GraphJob& job, const OldGraph& graph,
                 const std::vector<StoredPaths>& passes, Output& out)
        : graph_(graph),
          passes_(passes),
          old_batch_(old_scene, graph.path),
          resumed_({old_scene, job.new_scene}, job.reach, graph.path),
          out_(out),
          control_(job.control),
          parts_(job.parts),
          seen_(job.seen),
          scenes_{old_scene, job.new_scene},
          n_pixels_(old_scene.sensor.n_pixels()) {
        for (const StoredPaths& pass : passes) finders_.emplace_back(pass, job.reach);
        for (int c = 0; job.old_picture && c < 3; ++c) old_mean_[c] = job.old_picture->find(rgb[c]);
        if (parts_) recorded_ = std::make_unique<RecordedPaths>(job.new_scene, graph.path);
    }

    /// Starts the pixels [begin, end).
    void start(std::uint64_t begin, std::uint64_t end) {
        begin_ = begin, width_ = end - begin;
        sums_.assign(width_, {});
        flags_.resize(width_ * graph_.spp);
        n_samples_ = 0;
        touched_.clear();
        pairs_.clear();
        kept_.clear();
        pairs_.reserve(flags_.size());  // their addresses must stay valid
        if (control_) kept_.reserve(flags_.size());
    }

    /// Adds a sample of all pixels: queues the paths that the edit touches, and adds the first hits of the others.
    /// in:      block  with the paths of that sample, in a pass
    void follow(std::size_t pass, StoredBlock& block, std::size_t first, FirstHits& first_hits) {
        std::uint8_t* const flags = flags_.data() + width_ * n_samples_++;
        changes_.clear();
        finders_[pass].find(first, first + width_, flags, changes_);
        for (std::size_t k = 0; k < width_; ++k) {
            if (flags[k]) continue;
            sums_[k].add(first_hits.of(first + k));
            if (weighs_old(begin_ + k)) keep(block, first + k);
        }
        const std::size_t n_before = pairs_.size();
        for (const PathChange& change : changes_.paths) {
            pairs_.emplace_back().first = first_hits.of(change.path);
            touched_.push_back({pass, change.path});
        }
        resumed_.add(block, changes_, std::span(pairs_).subspan(n_before));
    }

    /// Ends the pixels after their last sample.
    void finish() {
        resumed_.finish();
        counts.add(resumed_.counts);
        resumed_.counts = {};
        touched += touched_.size();
        probe();
        if (seen_ && !seen_->empty()) leave_out_seen();
        add();
        if (parts_) divide();
        for (std::uint64_t k = 0; k < width_; ++k) out_.film.set(begin_ + k, sums_[k]);
    }

  private:
    /// Whether the old image has another weight than 1 in a pixel, or may get one.
    bool weighs_old(std::uint64_t pixel) const { return control_ && control_->pairs(pixel); }
    /// Computes what an untouched path brings, in both scenes.
    void keep(StoredBlock& block, std::size_t path) {
        PathPair& pair = kept_.emplace_back();
        if (const Spectrum* known = block.known_light(path))
            pair.before = *known;
        else
            resumed_.add_untouched(block, path, pair);
    }

    /// Traces some of the touched paths in the old scene as well; they must equal those of the graph.
    void probe() {
        constexpr std::size_t one_in = 64;
        const std::size_t step = std::max(one_in, touched_.size() / PathBatch::capacity + 1);
        probes_.clear();
        for (std::size_t k = 0; k < touched_.size(); k += step)
            probes_.push_back(passes_[touched_[k].pass].id(touched_[k].path));
        probed_.resize(probes_.size());
        old_batch_.trace(probes_, probed_);
        for (std::size_t i = 0; i < probes_.size(); ++i) {
            const auto& [pass, path] = touched_[i * step];
            const PathResult& traced = probed_[i];
            counts.add(traced);
            const Spectrum& known = pairs_[i * step].stored;
            const auto& first = graph_.passes[pass].paths.first_vertex;
            const std::uint64_t n = first[path + 1] - first[path];
            constexpr double tolerance = 1e-4;
            bool same = n == traced.n_vertices;
            for (int c = 0; c < 3; ++c)
                same &= !(std::abs(double(traced.L[c]) - known[c]) > tolerance * std::abs(double(known[c])));
            ++probed;
            if (same) continue;
            ++others;
            if (other.empty())
                other = fmt::format(
                    "{}: path {} has {} vertices and brings ({}, {}, {}), but {} and ({}, {}, {}) when it is traced "
                    "again",
                    graph_.files[pass], path, n, known.r, known.g, known.b, traced.n_vertices, traced.L.r, traced.L.g,
                    traced.L.b);
        }
    }

    /// Takes the emission that camera rays find from the pairs of pixels that have it by rays of their own.
    void leave_out_seen() {
        const std::uint8_t* flags = flags_.data();
        std::size_t t = 0, n_kept = 0, pass = 0, first_of_pass = 0;
        for (std::size_t sample = 0; sample < n_samples_; ++sample, flags += width_) {
            if (sample - first_of_pass == graph_.passes[pass].tracing.samples_per_pixel) first_of_pass = sample, ++pass;
            for (std::size_t k = 0; k < width_; ++k) {
                const std::uint64_t pixel = begin_ + k;
                PathPair* const pair = flags[k] ? &pairs_[t++] : weighs_old(pixel) ? &kept_[n_kept++] : nullptr;
                if (!pair || !seen_->has(pixel)) continue;
                const Ray ray = passes_[pass].camera_ray((sample - first_of_pass) * n_pixels_ + pixel);
                pair->before = pair->before - emission_at_first_hit(scenes_.old_scene, ray);
                if (flags[k]) pair->after = pair->after - emission_at_first_hit(scenes_.new_scene, ray);
            }
        }
    }

    /// Adds the samples' contributions in their order; zeros before the first nonzero one are only counted.
    void add() {
        squares_.assign(old_mean_[0].empty() ? 0 : 3 * width_, 0.0);
        const std::uint8_t* flags = flags_.data();
        std::size_t t = 0, n_kept = 0;
        for (std::uint64_t sample = 0; sample < graph_.spp; ++sample, flags += width_)
            for (std::size_t k = 0; k < width_; ++k) {
                PixelSums& sums = sums_[k];
                if (!flags[k]) {
                    if (sums.L[0].n > 0) sums.add(Spectrum(0));
                    if (!weighs_old(begin_ + k)) continue;
                    const Spectrum& L = kept_[n_kept++].before;
                    add_controlled(begin_ + k, L, L);
                    continue;
                }
                const PathPair& pair = pairs_[t];
                const PathId id = passes_[touched_[t].pass].id(touched_[t].path);
                ++t;
                out_.old_nonfinite.check(pair.before, id);
                out_.new_nonfinite.check(pair.after, id);
                for (Moments& L : sums.L) L.n = std::max(L.n, sample);
                sums.add(pair.after - pair.before, pair.first);
                if (weighs_old(begin_ + k)) add_controlled(begin_ + k, pair.before, pair.after);
                for (std::size_t c = 0; c < 3 && !squares_.empty(); ++c)
                    squares_[3 * k + c] +=
                        (double(pair.after[int(c)]) - pair.before[int(c)]) *
                        (double(pair.after[int(c)]) + pair.before[int(c)] - 2.0 * old_mean_[c][begin_ + k]);
            }
        for (PixelSums& sums : sums_)
            for (Moments& L : sums.L) L.n = graph_.spp;
        for (std::size_t k = 0; k < squares_.size(); ++k)
            out_.result.squares[k % 3][begin_ + k / 3] = float(squares_[k]);
    }

    /// Divides the touched pairs into their parts.
    void divide() {
        for (std::size_t begin = 0; begin < touched_.size(); begin += PathBatch::capacity) {
            const std::size_t n = std::min(PathBatch::capacity, touched_.size() - begin);
            probes_.clear();
            for (std::size_t k = begin; k < begin + n; ++k)
                probes_.push_back(passes_[touched_[k].pass].id(touched_[k].path));
            probed_.resize(n);
            const StoredPaths& after = recorded_->trace(probes_, probed_);
            for (std::size_t k = 0; k < n; ++k) {
                counts.add(probed_[k]);
                const auto& [pass, path] = touched_[begin + k];
                const PathGraph& graph = graph_.passes[pass];
                parts_->add(probes_[k].pixel,
                            parts_->finder().of(passes_[pass], path,
                                                first_row(graph.light_edges.vertex, graph.paths.first_vertex[path]),
                                                after, k, recorded_->first_edge(k), passes_[pass].sampler(path)));
            }
        }
    }

    void add_controlled(std::uint64_t pixel, const Spectrum& before, const Spectrum& after) {
        std::array<PairMoments, 3>& pairs = *control_->pairs(pixel);
        for (int c = 0; c < 3; ++c) pairs[std::size_t(c)].add(double(before[c]), double(after[c]));
    }

    struct Touched {
        std::size_t pass, path;  // path of a pass
    };
    const OldGraph& graph_;
    const std::vector<StoredPaths>& passes_;
    PathBatch old_batch_;
    ResumedPaths resumed_;
    std::vector<TouchedPaths> finders_;  // [pass]
    Output& out_;
    ControlSums* control_;
    PartSums* parts_;
    const SeenEmission* seen_;
    ScenePair scenes_;
    std::unique_ptr<RecordedPaths> recorded_;  // with parts: of the new scene
    std::uint64_t n_pixels_;
    std::span<const float> old_mean_[3];
    std::uint64_t begin_ = 0;  // first pixel of the chunk
    std::size_t width_ = 0;    // its pixels
    std::size_t n_samples_ = 0;
    std::vector<PixelSums> sums_;
    std::vector<double> squares_;  // [pixel and channel]
    std::vector<std::uint8_t> flags_;
    PathChanges changes_;  // of one sample index
    std::vector<Touched> touched_;
    std::vector<PathPair> pairs_;  // of the touched paths
    std::vector<PathPair> kept_;   // of untouched ones where weighs_old()
    std::vector<PathId> probes_;
    std::vector<PathResult> probed_;
};

/// State of one thread, reused between chunks: reads each block of the graph once for all new scenes.
class Worker {
  public:
    std::vector<PairsOfScene> scenes;

    Worker(const Scene& old_scene, std::span<const GraphJob> jobs, const OldGraph& graph,
           const std::vector<StoredPaths>& passes, std::deque<Output>& outputs)
        : graph_(graph), passes_(passes), n_pixels_(old_scene.sensor.n_pixels()) {
        scenes.reserve(jobs.size());
        for (std::size_t i = 0; i < jobs.size(); ++i)
            scenes.emplace_back(old_scene, jobs[i], graph, passes, outputs[i]);
        for (const StoredPaths& pass : passes) first_hits_.emplace_back(pass);
    }

    void run(std::uint64_t begin, std::uint64_t end) {
        for (PairsOfScene& scene : scenes) scene.start(begin, end);
        for (std::size_t i = 0; i < passes_.size(); ++i)
            for (std::uint64_t s = 0; s < graph_.passes[i].tracing.samples_per_pixel; ++s) {
                const std::size_t first = s * n_pixels_ + begin;
                block_.start(passes_[i], first, first + (end - begin));
                for (PairsOfScene& scene : scenes) scene.follow(i, block_, first, first_hits_[i]);
            }
        for (PairsOfScene& scene : scenes) scene.finish();
    }

  private:
    const OldGraph& graph_;
    const std::vector<StoredPaths>& passes_;
    std::uint64_t n_pixels_;
    StoredBlock block_;
    std::vector<FirstHits> first_hits_;  // [pass]
};

}  // namespace

OldGraph read_old_graph(const std::vector<std::string>& files, const Scene& old_scene, const std::string& scene_name,
                        int max_depth) {
    OldGraph graph;
    std::vector<std::pair<std::string, PathGraph>> passes;
    for (const std::string& file : files) passes.emplace_back(file, read_path_graph(file, Check::structure));
    std::sort(passes.begin(), passes.end(), [](const auto& a, const auto& b) {
        return a.second.tracing.first_sample < b.second.tracing.first_sample;
    });
    for (auto& [file, pass] : passes) {
        check_pass(pass, file, old_scene, scene_name, max_depth);
        const PathOptions path = options_of(pass, file);
        if (graph.passes.empty()) {
            graph.path = path;
        } else {
            const PathGraph& before = graph.passes.back();
            if (!alike(graph.path, path))
                throw InputError(
                    fmt::format("{}: was not traced like {} (seed, sampler, roulette)", file, graph.files[0]));
            if (end_of(before) > pass.tracing.first_sample)
                throw InputError(fmt::format("{}: has samples from {} on, which {} has too (to {})", file,
                                             pass.tracing.first_sample, graph.files.back(), end_of(before) - 1));
        }
        graph.spp += pass.tracing.samples_per_pixel;
        graph.files.push_back(file);
        graph.passes.push_back(std::move(pass));
    }
    if (graph.spp == 0) throw InputError(fmt::format("{}: has no paths", files[0]));
    return graph;
}

bool same_samples(const Image& old_picture, const std::string& file, const OldGraph& graph) {
    const Provenance& made = old_picture.provenance;
    // Other programs do not store their random streams.
    if (!made.stage.starts_with("loom-") || made.seed != graph.path.seed) return false;
    const auto picture = parse(made.command), traced = parse(graph.provenance().command);
    const std::uint64_t first = graph.passes.front().tracing.first_sample, last = end_of(graph.passes.back());
    const bool no_gap = last - first == graph.spp;
    if (made.stage == "loom-trace" && picture && traced && picture->rest == traced->rest && no_gap &&
        picture->first == first && picture->spp == graph.spp)
        return true;
    throw InputError(
        fmt::format("{}: has seed {} like {}, but other samples or options: its noise and that of the residual are "
                    "neither equal nor independent; trace the graph with another --seed, or exactly like the image",
                    file, made.seed, graph.files[0]));
}

std::vector<std::uint64_t> OldGraph::samples() const {
    std::vector<std::uint64_t> all;
    for (const PathGraph& pass : passes)
        for (std::uint64_t s = pass.tracing.first_sample; s < end_of(pass); ++s) all.push_back(s);
    return all;
}

std::string GraphResidual::summary() const {
    return fmt::format("{} of {} old paths traced again ({:.3g} %){}", touched, paths,
                       100.0 * double(touched) / double(std::max<std::uint64_t>(paths, 1)),
                       why_all.empty() ? "" : ": " + why_all);
}

std::vector<GraphResidual> render_residuals(const Scene& old_scene, std::span<const GraphJob> jobs,
                                            const OldGraph& graph, int threads, app::Report& report) {
    const std::uint64_t n_pixels = old_scene.sensor.n_pixels();
    std::vector<GraphReader> readers;
    for (const PathGraph& pass : graph.passes) readers.emplace_back(pass);
    std::vector<StoredPaths> passes;
    for (const GraphReader& reader : readers) passes.emplace_back(old_scene, reader, graph.path);
    std::deque<Output> outputs;
    for (const GraphJob& job : jobs) outputs.emplace_back(old_scene.sensor, graph, job, report);

    app::Progress progress(report, "tracing", n_pixels * graph.spp);
    tbb::enumerable_thread_specific<Worker> workers([&] { return Worker(old_scene, jobs, graph, passes, outputs); });
    // Large enough for full batches of touched paths where they are rare.
    constexpr std::uint64_t paths_per_chunk = 1 << 15;
    parallel_chunks(n_pixels, std::clamp<std::uint64_t>(paths_per_chunk / graph.spp, 16, paths_per_chunk), threads,
                    [&](std::uint64_t, std::uint64_t begin, std::uint64_t end) {
                        workers.local().run(begin, end);
                        progress.add((end - begin) * graph.spp);
                    });
    std::vector<GraphResidual> results;
    for (std::size_t i = 0; i < jobs.size(); ++i) {
        GraphResidual& out = outputs[i].result;
        out.paths = n_pixels * graph.spp;
        out.counts.nonfinite = outputs[i].old_nonfinite.count() + outputs[i].new_nonfinite.count();
        std::uint64_t probed = 0, others = 0;
        std::string other;
        for (const Worker& worker : workers) {
            const PairsOfScene& scene = worker.scenes[i];
            out.counts.add(scene.counts);
            out.touched += scene.touched;
            probed += scene.probed;
            others += scene.others;
            if (other.empty()) other = scene.other;
        }
        // A few probes may hit two coincident surfaces, and another of them than when the graph was made.
        if (100 * others > probed) throw InputError(other + ": graph and scene do not belong together");
        out.image = std::move(outputs[i].film).finish({});
        if (jobs[i].parts) jobs[i].parts->write(out.image, graph.spp);
        LedgerLink& link = out.image.ledger.emplace_back();
        link.method = old_graph_method;
        link.samples = graph.spp;
        link.seed = graph.path.seed;
        link.var_mean = mean_var_mean(out.image);
        results.push_back(std::move(out));
    }
    return results;
}

GraphResidual render_residual(const ScenePair& scenes, const EditReach& reach, const OldGraph& graph, int threads,
                              const Image* old_picture, app::Report& report, ControlSums* control, PartSums* parts) {
    const GraphJob job{scenes.new_scene, reach, old_picture, control, parts};
    return std::move(render_residuals(scenes.old_scene, {&job, 1}, graph, threads, report)[0]);
}

Image add_residual_of_same_samples(const Image& old_picture, const Image& residual, const GraphResidual& paths) {
    Image sum = residual;
    sum.scene = residual.ledger.back().scene;
    sum.ledger.clear();
    const double n = double(sum.samples);
    for (int c = 0; c < 3; ++c) {
        const auto before = old_picture.find(rgb[c]), var_before = old_picture.find(std::string("VarMean.") + rgb[c]);
        const auto mean = sum.add(rgb[c]);
        for (std::size_t i = 0; i < mean.size(); ++i) mean[i] += before[i];
        const auto difference = residual.find(rgb[c]);
        const auto var_mean = sum.add(std::string("VarMean.") + rgb[c]);
        for (std::size_t i = 0; i < var_mean.size(); ++i) {
            const double more = double(paths.squares[c][i]) - n * double(difference[i]) * difference[i];
            var_mean[i] = float(std::max(0.0, double(var_before[i]) + more / (n * (n - 1))));
        }
    }
    return sum;
}

}  // namespace loom::residual
