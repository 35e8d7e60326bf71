#include "stages/learn/grid.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <ranges>

#include "formats/io/error.h"
#include "stages/core/app/report.h"
#include "stages/core/cache/grid_cache.h"
#include "stages/core/compute/parallel.h"
#include "stages/core/graph/graph_reader.h"
#include "stages/core/scattering/lobe_width.h"

namespace loom::learn {
namespace {

constexpr std::uint64_t chunk_size = 4096;

/// Vertices of all graphs to learn from.
struct Chosen {
    struct Vertex {
        std::uint32_t graph_idx, vertex;
    };
    std::vector<Vertex> vertices;
    std::uint64_t nonfinite = 0;
};

/// in:      most  number of samples that will be trained on: no more vertices are needed
Chosen choose(const std::vector<LearnInput>& inputs, const LearnOptions& options, std::uint64_t most) {
    Chosen chosen;
    for (std::size_t g = 0; g < inputs.size(); ++g) {
        const LearnInput& in = inputs[g];
        const GraphReader reader(in.graph);
        const PreferredVertices preferred(in);
        struct Part {
            std::vector<std::uint32_t> vertices;
            std::uint64_t nonfinite = 0;
        };
        std::vector<Part> parts((in.graph.n_vertices() + chunk_size - 1) / chunk_size);
        parallel_chunks(in.graph.n_vertices(), chunk_size, options.threads,
                        [&](std::uint64_t chunk, std::uint64_t begin, std::uint64_t end) {
                            Part& part = parts[chunk];
                            for (std::uint64_t j = begin; j < end; ++j) {
                                const Bsdf<float> bsdf = reader.bsdf(j);
                                if (!is_cached(bsdf, options.smallest_roughness) || !preferred(j, bsdf) ||
                                    is_held_back(options.seed, g, j))
                                    continue;
                                if (!all_finite(rgb(in.radiance.L, j))) {
                                    ++part.nonfinite;
                                    continue;
                                }
                                part.vertices.push_back(std::uint32_t(j));
                            }
                        });
        for (const Part& part : parts) {
            for (const std::uint32_t j : part.vertices) chosen.vertices.push_back({std::uint32_t(g), j});
            chosen.nonfinite += part.nonfinite;
        }
    }
    if (chosen.vertices.size() <= most) return chosen;
    const double share = double(most) / double(chosen.vertices.size());
    const std::uint64_t seed = streams::training_subset(options.seed);
    std::size_t kept = 0;
    for (std::size_t i = 0; i < chosen.vertices.size(); ++i)
        if (streams::selection(seed, i) < share) chosen.vertices[kept++] = chosen.vertices[i];
    chosen.vertices.resize(std::max<std::size_t>(kept, 1));
    return chosen;
}

/// Sets the cube around the quantiles of the vertices' positions.
void set_domain(const std::vector<LearnInput>& inputs, const std::vector<Chosen::Vertex>& vertices,
                RadianceCache& cache) {
    constexpr std::size_t enough = 100'000;
    const std::size_t step = std::max<std::size_t>(vertices.size() / enough, 1);
    cache.domain.size = 0;
    for (std::size_t axis = 0; axis < 3; ++axis) {
        std::vector<float> x;
        for (std::size_t i = 0; i < vertices.size(); i += step)
            x.push_back(inputs[vertices[i].graph_idx].graph.vertices.p[3 * std::size_t(vertices[i].vertex) + axis]);
        std::sort(x.begin(), x.end());
        const std::size_t cut = x.size() / 1000;
        cache.domain.lo[axis] = x[cut];
        cache.domain.size = std::max(cache.domain.size, x[x.size() - 1 - cut] - x[cut]);
    }
    if (!(cache.domain.size > 0)) cache.domain.size = 1;
}

/// Fills rows in random order, with labels in units of their mean.
/// returns: the mean
float fill_rows(const std::vector<LearnInput>& inputs, const std::vector<Chosen::Vertex>& vertices,
                const RadianceCache& cache, const GridInputs& network_inputs, const LearnOptions& options,
                TrainingRows& rows) {
    std::vector<GraphReader> readers;
    for (const LearnInput& in : inputs) readers.emplace_back(in.graph);
    const std::vector<std::uint32_t> place = shuffled_places(vertices.size(), options.seed);
    std::vector<double> sums((vertices.size() + chunk_size - 1) / chunk_size);
    parallel_chunks(
        vertices.size(), chunk_size, options.threads, [&](std::uint64_t chunk, std::uint64_t begin, std::uint64_t end) {
            for (std::uint64_t i = begin; i < end; ++i) {
                const auto [g, j] = vertices[i];
                const CacheQuery query = cache_query(readers[g].vertex(j));
                Spectrum label = rgb(inputs[g].radiance.L, j);
                if (cache.demodulated) label = label / demodulator(query.reflectance);
                const std::span<float> row = rows[place[i]];
                for (int c = 0; c < 3; ++c) {
                    row[std::size_t(c)] = (query.p[c] - cache.domain.lo[std::size_t(c)]) / cache.domain.size;
                    row[std::size_t(3 + c)] = label[c];
                    sums[chunk] += double(label[c]) / 3;
                }
                network_inputs.fill(query, row.data() + TrainingRows::first_extra);
            }
        });
    double sum = 0;
    for (const double part : sums) sum += part;
    const double mean = sum / double(vertices.size());
    const float unit = mean > 0 ? float(mean) : 1.0f;
    parallel_chunks(rows.size(), chunk_size, options.threads,
                    [&](std::uint64_t, std::uint64_t begin, std::uint64_t end) {
                        for (std::uint64_t i = begin; i < end; ++i)
                            for (std::size_t c = 0; c < 3; ++c) rows[i][3 + c] /= unit;
                    });
    return unit;
}

/// Number of batches that take so many seconds of CPU time, from a trainer of its own.
std::uint64_t batches_in(double seconds, const TrainingRows& rows, const neural::NetworkShape& shape,
                         const LearnOptions& options, app::Report& report) {
    Trainer trainer(rows, shape, {.n_batches = 1'000'000, .seed = options.seed}, options.threads);
    trainer.step();
    const double start = report.usage().cpu_s;
    const std::uint64_t before = trainer.n_steps();
    double spent = 0;
    while (spent < 0.25 || trainer.n_steps() < before + 4) {
        trainer.step();
        spent = report.usage().cpu_s - start;
    }
    const double per_batch = spent / double(trainer.n_steps() - before);
    return std::max<std::uint64_t>(std::uint64_t(seconds / per_batch), 1);
}

}  // namespace

bool needs_directions(const PathGraph& graph) {
    const auto& m = graph.materials;
    for (std::size_t i = 0; i < m.kind.size(); ++i) {
        const auto kind = BsdfKind(m.kind[i]);
        if (narrowest_lobe(kind, m.alpha[2 * i], m.alpha[2 * i + 1], m.exponent[i]) > 0 &&
            specular_alpha(kind, m.alpha[2 * i], m.alpha[2 * i + 1], m.exponent[i]) < 1)
            return true;
    }
    return false;
}

bool needs_demodulation(const PathGraph& graph) {
    return std::ranges::any_of(graph.materials.textured, [](std::uint8_t bits) {
        return (bits & (textured_parameter::diffuse | textured_parameter::specular)) != 0;
    });
}

void fill_grid(const std::vector<LearnInput>& inputs, const LearnOptions& options, RadianceCache& cache,
               app::Report* shown) {
    app::Report silent;
    silent.set_quiet(true);
    app::Report& report = shown ? *shown : silent;
    const auto graphs =
        inputs | std::views::transform([](const LearnInput& in) -> const PathGraph& { return in.graph; });

    // Choose the vertices.
    constexpr std::uint64_t all = ~std::uint64_t{0} / 2;
    const std::uint64_t most = options.seconds ? all : options.samples.value_or(default_samples(all));
    const Chosen chosen = choose(inputs, options, most);
    cache.settings.nonfinite = chosen.nonfinite;
    if (chosen.vertices.empty()) return;
    cache.demodulated = std::ranges::any_of(graphs, needs_demodulation) ? 1 : 0;
    set_domain(inputs, chosen.vertices, cache);
    const GridInputs network_inputs(std::ranges::any_of(graphs, needs_directions));

    // Fill in the rows to train on.
    const std::uint64_t bytes = chosen.vertices.size() * TrainingRows::bytes_per_row(network_inputs.size());
    report.info("training rows of {} vertices: {}", chosen.vertices.size(), app::bytes_text(bytes));
    TrainingRows rows(chosen.vertices.size(), network_inputs.size());
    const float unit = fill_rows(inputs, chosen.vertices, cache, network_inputs, options, rows);

    // Train.
    const neural::NetworkShape shape{neural::grid_levels(8, 17, 16, 1.6), network_inputs.size()};
    TrainingPlan plan;
    plan.seed = options.seed;
    plan.epsilon = 0.01f / sqr(unit);
    const std::uint64_t n_samples = options.samples.value_or(default_samples(chosen.vertices.size()));
    plan.n_batches = (n_samples + batch_size - 1) / batch_size;
    if (options.seconds) {
        plan.n_batches = batches_in(*options.seconds, rows, shape, options, report);
        report.info("{} s of CPU time: --samples {} learns the same again", *options.seconds,
                    plan.n_batches * batch_size);
    }
    Trainer trainer(rows, shape, plan, options.threads);
    constexpr std::uint64_t n_snapshots = 64;
    const std::uint64_t per_snapshot = (plan.n_batches + n_snapshots - 1) / n_snapshots;
    std::vector<double> loss;
    std::vector<std::uint64_t> samples;
    app::Progress progress(report, "training", plan.n_batches * batch_size);
    double sum = 0;
    std::uint64_t summed = 0;
    while (trainer.n_steps() < plan.n_batches) {
        sum += trainer.step(), ++summed;
        progress.add(batch_size);
        if (summed < per_snapshot && trainer.n_steps() < plan.n_batches) continue;
        loss.push_back(sum / double(summed) / 3);
        samples.push_back(trainer.n_steps() * batch_size);
        sum = 0, summed = 0;
    }

    // Store the network, with outputs in the units of the radiance.
    neural::Network network = trainer.network();
    network.scale_outputs(unit);
    store_network(network, network_inputs, cache);
    cache.settings.samples = plan.n_batches * batch_size;
    cache.settings.batches = plan.n_batches;
    cache.training.loss = std::move(loss);
    cache.training.samples = std::move(samples);
}

}  // namespace loom::learn
