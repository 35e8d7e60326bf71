#include "stages/cluster/cluster.h"
#include "stages/core/app/command.h"

int main(int argc, char** argv) {
    using namespace loom;
    cluster::Options options;
    app::Command command{"cluster: group the vertices of a path graph that share their samples"};
    cluster::declare(command, options);
    return command.execute(argc, argv, [&] { cluster::run(options, command.report); });
}
