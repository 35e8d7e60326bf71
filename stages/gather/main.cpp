#include "stages/core/app/command.h"
#include "stages/gather/gather.h"

int main(int argc, char** argv) {
    using namespace loom;
    gather::Options options;
    app::Command command{"gather: turn a path graph into an image"};
    gather::declare(command, options);
    return command.execute(argc, argv, [&] { gather::run(options, command.report); });
}
