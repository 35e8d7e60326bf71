#include "stages/compare/compare.h"
#include "stages/core/app/command.h"

int main(int argc, char** argv) {
    using namespace loom;
    compare::Options options;
    app::Command command{"compare: errors of images against a reference, their significance and their cost"};
    compare::declare(command, options);
    return command.execute(argc, argv, [&] { return compare::run(options, command.report); });
}
