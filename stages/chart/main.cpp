#include "stages/chart/chart.h"
#include "stages/core/app/command.h"

int main(int argc, char** argv) {
    using namespace loom;
    chart::Options options;
    app::Command command{"chart: error against cost, and time by stage, from tables of loom-compare"};
    chart::declare(command, options);
    return command.execute(argc, argv, [&] { return chart::run(options, command.report); });
}
