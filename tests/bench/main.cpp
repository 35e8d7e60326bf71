#include "stages/core/app/command.h"
#include "tests/bench/bench.h"

int main(int argc, char** argv) {
    using namespace loom;
    using Table = bench::Options::Table;
    bench::Options options;
    app::Command command{
        "bench: throughput of the tracers, cost of their kernels, error of the samplers, cost of edge samples"};
    command.files("scenes", options.scenes, "scene files; none: the project's own, and ../shared/scenes");
    command.option("--paths", options.paths, "paths of one run", app::Range<std::uint64_t>{1000, 1u << 30});
    command.option("--rounds", options.rounds, "runs of each; the fastest counts", app::Range<int>{1, 1000});
    command.choice("--table", options.table, "which table to print",
                   {{"all", Table::all},
                    {"throughput", Table::throughput},
                    {"kernels", Table::kernels},
                    {"samplers", Table::samplers},
                    {"edges", Table::edges}});
    command.threads(options.threads);
    return command.execute(argc, argv, [&] {
        const auto wanted = [&](Table table) { return options.table == Table::all || options.table == table; };
        if (wanted(Table::throughput)) bench::throughput(options, command.report);
        if (wanted(Table::kernels)) bench::kernels(options, command.report);
        if (wanted(Table::samplers)) bench::samplers(options, command.report);
        if (wanted(Table::edges)) bench::edge_sampling(options, command.report);
    });
}
