#include "stages/frames/movie.h"

#include <fmt/format.h>

#include <algorithm>
#include <fstream>
#include <iterator>
#include <optional>
#include <stdexcept>
#include <string>
#include <vector>

#include "formats/io/output_file.h"
#include "stages/core/app/report.h"
#include "stages/core/plot/gnuplot.h"

namespace loom::frames {

namespace fs = std::filesystem;

void clear_frames(const fs::path& folder) {
    fs::create_directories(folder);
    for (const auto& entry : fs::directory_iterator(folder)) {
        const std::string name = entry.path().filename();
        if (name.starts_with("frame-") && (name.ends_with(".png") || name.ends_with(".exr"))) fs::remove(entry.path());
    }
}

fs::path frame_path(const fs::path& folder, std::size_t frame_idx, const char* ending) {
    return folder / fmt::format("frame-{:04}{}", frame_idx, ending);
}

bool write_movie(const fs::path& frames, std::size_t width, std::size_t height, double fps, const fs::path& movie,
                 app::Report& report) {
    OutputFile output(movie);
    const std::size_t zoom = std::max<std::size_t>(1, 480 / std::min(width, height));
    // Encoders require even sides.
    const std::string size =
        fmt::format("scale={}:{}:flags=neighbor", (zoom * width + 1) / 2 * 2, (zoom * height + 1) / 2 * 2);
    const fs::path log = fs::absolute(output.partial()).native() + ".log";
    const auto encode = [&](const std::vector<std::string>& codec) {
        std::vector<std::string> words{
            "ffmpeg",         "-y",  "-loglevel", "error", "-framerate", fmt::format("{}", fps), "-i",
            "frame-%04d.png", "-vf", size};
        words.insert(words.end(), codec.begin(), codec.end());
        for (const char* word : {"-pix_fmt", "yuv420p", "-threads", "1", "-fflags", "+bitexact", "-flags:v",
                                 "+bitexact", "-movflags", "+faststart", "-f", "mp4"})
            words.push_back(word);
        words.push_back(fs::absolute(output.partial()).native());
        return plot::run_program(fs::absolute(frames), words, log);
    };
    std::optional<int> status = encode({"-c:v", "libx264", "-crf", "16"});
    if (status && *status != 0) status = encode({"-c:v", "mpeg4", "-q:v", "2"});
    std::ifstream in(log);
    const std::string said(std::istreambuf_iterator<char>(in), {});
    fs::remove(log);
    if (status != 0) fs::remove(movie);  // of other frames
    if (!status) {
        report.info("no movie: ffmpeg is not installed (Debian: apt install ffmpeg)");
        return false;
    }
    if (*status != 0) throw std::runtime_error(fmt::format("{}: ffmpeg failed:\n{}", movie.native(), said));
    output.commit();
    return true;
}

}  // namespace loom::frames
