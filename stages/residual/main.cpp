#include "stages/core/app/command.h"
#include "stages/residual/residual.h"

int main(int argc, char** argv) {
    using namespace loom;
    residual::Options options;
    app::Command command{"residual: find the edit between two scenes and render only the difference that it makes"};
    residual::declare(command, options);
    return command.execute(argc, argv, [&] { residual::run(options, command.report); });
}
