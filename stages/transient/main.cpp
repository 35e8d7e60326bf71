#include "stages/core/app/command.h"
#include "stages/transient/transient.h"

int main(int argc, char** argv) {
    using namespace loom;
    transient::Options options;
    app::Command command{"transient: bin the paths of a graph by the arrival time of their light"};
    transient::declare(command, options);
    return command.execute(argc, argv, [&] { transient::run(options, command.report); });
}
