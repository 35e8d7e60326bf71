#include "stages/core/app/command.h"
#include "stages/inspect/inspect.h"

int main(int argc, char** argv) {
    using namespace loom;
    inspect::Options options;
    app::Command command{
        "inspect: describe a file, print one path of a graph, write paths as lines or an image as a preview"};
    inspect::declare(command, options);
    return command.execute(argc, argv, [&] { return inspect::run(options, command.report); });
}
