#include "stages/core/app/command.h"
#include "stages/derive/derive.h"

int main(int argc, char** argv) {
    using namespace loom;
    derive::Options options;
    app::Command command{"derive: differentiate the light of a path graph by parameters of its scene"};
    derive::declare(command, options);
    return command.execute(argc, argv, [&] { derive::run(options, command.report); });
}
