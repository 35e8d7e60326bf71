#include "stages/core/app/command.h"
#include "stages/merge/merge.h"

int main(int argc, char** argv) {
    using namespace loom;
    merge::Options options;
    app::Command command{"merge: combine images, or transient cubes, of one scene with different samples"};
    merge::declare(command, options);
    return command.execute(argc, argv, [&] { return merge::run(options, command.report); });
}
