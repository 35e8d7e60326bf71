#pragma once
// Single frames as PNG, and a movie of them.

#include <cstddef>
#include <filesystem>

namespace loom::app {
class Report;
}

namespace loom::frames {

/// Creates the folder of single frames, and removes the frames of earlier runs.
void clear_frames(const std::filesystem::path& folder);
std::filesystem::path frame_path(const std::filesystem::path& folder, std::size_t frame_idx, const char* ending);

/// Encodes the frame-NNNN.png of a folder, of width x height pixels each; small ones are enlarged. Where ffmpeg is not
/// installed there is only a message, and a movie that was there is removed.
/// out:     whether there is a movie
bool write_movie(const std::filesystem::path& frames, std::size_t width, std::size_t height, double fps,
                 const std::filesystem::path& movie, app::Report& report);

}  // namespace loom::frames
