#include "stages/core/app/command.h"
#include "stages/report/report.h"

int main(int argc, char** argv) {
    using namespace loom;
    report::Options options;
    app::Command command{"report: write one HTML page of images by several methods, their errors, costs and lineage"};
    report::declare(command, options);
    return command.execute(argc, argv, [&] { return report::run(options, command.report); });
}
