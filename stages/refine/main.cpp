#include "stages/core/app/command.h"
#include "stages/refine/refine.h"

int main(int argc, char** argv) {
    using namespace loom;
    refine::Options options;
    app::Command command{"refine: let neighbouring vertices of a path graph share their samples"};
    refine::declare(command, options);
    return command.execute(argc, argv, [&] { refine::run(options, command.report); });
}
