#pragma once
#include <filesystem>
#include <optional>
#include <string_view>

namespace loom {

/// Whether the bytes must be on the device before the name appears. `no` is for timed runs only.
enum class Sync { no, yes };

/// Write-then-rename: the work goes to NAME.HOST-PID.partial in the same folder, where no other writer of NAME
/// is; commit() syncs it and gives it its name. A writer that throws, or never commits, leaves neither; what a
/// killed one left is removed by the next writer of NAME on that machine.
class OutputFile {
  public:
    /// throws:  InputError when the folder is missing or the path is a directory
    explicit OutputFile(std::filesystem::path path);
    ~OutputFile();
    OutputFile(const OutputFile&) = delete;
    OutputFile& operator=(const OutputFile&) = delete;

    const std::filesystem::path& path() const { return path_; }
    /// The temporary name to write to.
    const std::filesystem::path& partial() const { return partial_; }
    /// NEEDS the partial file to be closed by whoever wrote it.
    void commit(Sync sync = Sync::yes);

  private:
    std::filesystem::path path_, partial_;
    bool committed_ = false;
};

/// The check that OutputFile makes, for a stage to make before it starts to compute.
/// throws:  InputError
void check_output_path(const std::filesystem::path& path);

/// Writes a small text file by write-then-rename.
/// in:      modified  its modification time; none: now
void write_text_file(const std::filesystem::path& path, std::string_view text,
                     std::optional<std::filesystem::file_time_type> modified = std::nullopt);

}  // namespace loom
