#include <fmt/format.h>

#include <filesystem>
#include <string>

#include "stages/core/app/report.h"
#include "stages/core/scene/build.h"
#include "stages/trace/trace.h"
#include "tests/bench/bench.h"

namespace loom::bench {
namespace {

constexpr const char* rgb[] = {"R", "G", "B"};

/// Mean over pixels and channels of the squared difference from the reference, less the reference's own error.
double squared_error(const Image& image, const Image& reference) {
    double sum = 0;
    for (const char* c : rgb) {
        const auto a = image.find(c), b = reference.find(c), var = reference.find(std::string("VarMean.") + c);
        for (std::size_t i = 0; i < a.size(); ++i) sum += sqr(double(a[i]) - b[i]) - var[i];
    }
    return sum / (3.0 * double(image.n_pixels()));
}

}  // namespace

void samplers(const Options& options, app::Report& report) {
    constexpr int seeds = 8;
    constexpr std::uint64_t reference_spp = 2048;  // independent, so that its error can be estimated
    report.answer(fmt::format(
        "Samplers, mean squared error over {} seeds against {} samples per pixel\n{:18}{:>6}{:>14}{:>14}{:>20}\n",
        seeds, reference_spp, "scene", "spp", "independent", "sobol", "independent/sobol"));
    app::Report silent;
    silent.set_quiet(true);
    for (const char* name : {"cornell-box", "glossy-box", "all-emitters", "environment-map"}) {
        const auto scene = load_scene(std::filesystem::path(LOOM_SOURCE_DIR) / "scenes" / (std::string(name) + ".xml"),
                                      {{"resx", "64"}, {"resy", "48"}});
        trace::Counts counts;
        PathOptions path;
        path.max_depth = scene->max_depth;
        path.sampler = SamplerKind::independent;
        path.seed = 1'000'000;
        const Image reference = trace::render_image(*scene, path, {0, reference_spp, options.threads}, silent, counts);
        for (const std::uint64_t spp : {1, 4, 16, 64}) {
            double errors[2]{};
            for (const SamplerKind kind : {SamplerKind::independent, SamplerKind::sobol})
                for (int seed = 0; seed < seeds; ++seed) {
                    path.sampler = kind;
                    path.seed = std::uint64_t(seed);
                    errors[kind == SamplerKind::sobol] +=
                        squared_error(trace::render_image(*scene, path, {0, spp, options.threads}, silent, counts),
                                      reference) /
                        seeds;
                }
            report.answer(fmt::format("{:18}{:6}{:14.3e}{:14.3e}{:20.2f}\n", name, spp, errors[0], errors[1],
                                      errors[0] / errors[1]));
        }
    }
}

}  // namespace loom::bench
