#include "stages/core/app/command.h"
#include "stages/trace/trace.h"

int main(int argc, char** argv) {
    using namespace loom;
    trace::Options options;
    app::Command command{"trace: sample paths of a Mitsuba scene; write a path graph (.h5) or an image (.exr)"};
    trace::declare(command, options);
    return command.execute(argc, argv, [&] { trace::run(options, command.report); });
}
