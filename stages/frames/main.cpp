#include "stages/core/app/command.h"
#include "stages/frames/frames.h"

int main(int argc, char** argv) {
    using namespace loom;
    frames::Options options;
    app::Command command{"frames: draw a transient cube as frames, streaks, times of the peak, curves or a movie"};
    frames::declare(command, options);
    return command.execute(argc, argv, [&] { frames::run(options, command.report); });
}
