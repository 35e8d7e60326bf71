#include "stages/core/app/command.h"
#include "stages/learn/learn.h"

int main(int argc, char** argv) {
    using namespace loom;
    learn::Options options;
    app::Command command{"learn: make a cache of the radiance of a scene from refined path graphs"};
    learn::declare(command, options);
    return command.execute(argc, argv, [&] { learn::run(options, command.report); });
}
