#include "stages/core/app/command.h"
#include "stages/denoise/denoise.h"

int main(int argc, char** argv) {
    using namespace loom;
    denoise::Options options;
    app::Command command{"denoise: remove the noise of an image"};
    denoise::declare(command, options);
    return command.execute(argc, argv, [&] { denoise::run(options, command.report); });
}
