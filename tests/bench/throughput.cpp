#include <fmt/format.h>
#include <unistd.h>

#include <array>
#include <cmath>
#include <filesystem>
#include <functional>

#include "stages/core/app/report.h"
#include "stages/core/scene/build.h"
#include "stages/trace/trace.h"
#include "tests/bench/bare_tracer.h"
#include "tests/bench/bench.h"

namespace loom::bench {
namespace {

namespace fs = std::filesystem;

std::vector<fs::path> scene_files(const Options& options) {
    if (!options.scenes.empty()) return {options.scenes.begin(), options.scenes.end()};
    const fs::path root = LOOM_SOURCE_DIR;
    std::vector<fs::path> files{root / "scenes/cornell-box.xml", root / "scenes/glossy-box.xml"}, shared;
    std::error_code not_there;
    for (const auto& folder : fs::directory_iterator(root / "../shared/scenes", not_there))
        if (fs::exists(folder.path() / "scene_v3.xml")) shared.push_back(folder.path() / "scene_v3.xml");
    std::sort(shared.begin(), shared.end());
    files.insert(files.end(), shared.begin(), shared.end());
    return files;
}

std::string name_of(const fs::path& file) {
    const std::string name = file.stem().string();
    return name.starts_with("scene") ? file.parent_path().filename().string() + "/" : name;
}

/// The film of the scene made as large as the paths allow at one sample per pixel.
void resize_film(Sensor& sensor, std::uint64_t paths) {
    const double scale = std::sqrt(double(paths) / double(sensor.n_pixels()));
    sensor.width = std::uint32_t(std::max(1.0, std::round(sensor.width * scale)));
    sensor.height = std::uint32_t(std::max(1.0, std::round(sensor.height * scale)));
    sensor.prepare();
}

}  // namespace

void throughput(const Options& options, app::Report& report) {
    report.answer(fmt::format(
        "Throughput, Mpaths/s at 1 sample per pixel, fastest of {} rounds in turns; roulette by albedo; in brackets\n"
        "over that of the bare loop (diffuse, no textures, no multiple importance sampling, nothing kept).\n"
        "{:16}{:>9}{:>16}{:>16}{:>16}{:>15}\n",
        options.rounds, "scene", "bare", "image", "graph", "graph, file", "vertices/path"));
    app::Report silent;
    silent.set_quiet(true);
    const fs::path file = fs::temp_directory_path() / fmt::format("loom-bench-{}.h5", getpid());
    for (const fs::path& scene_file : scene_files(options)) {
        const auto scene = load_scene(scene_file);
        resize_film(scene->sensor, options.paths);
        const BareTracer bare(*scene);
        PathOptions path;
        path.max_depth = scene->max_depth;
        const trace::Work work{0, 1, options.threads};
        const double n_paths = double(scene->sensor.n_pixels());
        trace::Counts counts;
        BareTracer::Result bare_result;
        const std::array<std::function<void()>, 4> runs{
            [&] { bare_result = bare.render(1, options.threads); },
            [&] { trace::render_image(*scene, path, work, silent, counts); },
            [&] { trace::render_graph(*scene, path, work, silent, counts); },
            [&] { write_path_graph(trace::render_graph(*scene, path, work, silent, counts), file, Sync::no); }};
        std::array<double, 4> fastest;
        fastest.fill(INFINITY);
        for (int round = 0; round < options.rounds; ++round)
            for (std::size_t i = 0; i < runs.size(); ++i) fastest[i] = std::min(fastest[i], seconds_of(runs[i]));
        std::string line = fmt::format("{:16}{:9.2f}", name_of(scene_file), n_paths / fastest[0] / 1e6);
        for (std::size_t i = 1; i < runs.size(); ++i)
            line += fmt::format("{:9.2f} ({:.2f})", n_paths / fastest[i] / 1e6, fastest[0] / fastest[i]);
        report.answer(line + fmt::format("{:8.1f}/{:.1f}\n", double(bare_result.vertices) / n_paths,
                                         double(counts.vertices) / n_paths));
    }
    fs::remove(file);
    report.answer("vertices/path: of the bare loop / of loom.\n\n");
}

}  // namespace loom::bench
