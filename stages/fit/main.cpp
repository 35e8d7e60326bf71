#include "stages/core/app/command.h"
#include "stages/fit/fit.h"

int main(int argc, char** argv) {
    using namespace loom;
    fit::Options options;
    app::Command command{"fit: one step of a fit of scene parameters to a measured transient cube"};
    fit::declare(command, options);
    return command.execute(argc, argv, [&] { return fit::run(options, command.report); });
}
