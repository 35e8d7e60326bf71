#pragma once
#include <cstdio>
#include <filesystem>
#include <optional>
#include <stdexcept>
#include <string>
#include <string_view>

namespace loom {

/// Whether the bytes must be on the device before the file is renamed. `no` is for timed runs only.
enum class Sync { no, yes };

/// Thrown for an output with NaN or infinite values. The file is kept under not_finite_name().
class NonfiniteError : public std::runtime_error {
    using std::runtime_error::runtime_error;
};
/// Returns the name of a rejected output: "x.exr" -> "x.not-finite.exr".
std::filesystem::path not_finite_name(const std::filesystem::path& output);

/// Write-then-rename: the bytes go to NAME.HOST-PID.partial in the same folder, a name unique to this writer. commit()
/// syncs the file and renames it to NAME. A writer that throws or never commits leaves no file. The next writer of NAME
/// on the same machine removes the partial file of a killed one.
class OutputFile {
  public:
    /// throws:  InputError when the folder is missing or the path is a directory
    explicit OutputFile(std::filesystem::path path);
    ~OutputFile();
    OutputFile(const OutputFile&) = delete;
    OutputFile& operator=(const OutputFile&) = delete;

    const std::filesystem::path& path() const { return path_; }
    /// Returns the temporary name to write to.
    const std::filesystem::path& partial() const { return partial_; }
    /// Renames the partial file to its final name, and removes a not_finite_name() file left by an earlier writer.
    /// needs:   the partial file is closed
    /// in:      nonfinite  text that names the NaN or infinite values; empty when there are none
    /// throws:  NonfiniteError, after keeping the file under not_finite_name(), when `nonfinite` is not empty
    void commit(Sync sync = Sync::yes, std::string_view nonfinite = {});

  private:
    std::filesystem::path path_, partial_;
    bool committed_ = false;
};

/// Buffered writes to the partial file of an output. Every failure is reported, at the latest by close().
class OutputStream {
  public:
    /// throws:  std::runtime_error with the name of the output, as write() and close() do
    explicit OutputStream(const OutputFile& output);
    ~OutputStream();
    OutputStream(const OutputStream&) = delete;
    OutputStream& operator=(const OutputStream&) = delete;

    std::FILE* get() const { return file_; }
    void write(const void* bytes, std::size_t n);
    /// Flushes and closes. Throws also when an earlier write failed and its caller ignored the failure.
    void close();

  private:
    [[noreturn]] void fail() const;
    std::filesystem::path path_;
    std::FILE* file_;
    int error_ = 0;  // errno of the first failure
};

/// Checks an output path as OutputFile does. A stage calls it before it starts to compute.
/// throws:  InputError
void check_output_path(const std::filesystem::path& path);

/// Writes a small text file by write-then-rename.
/// in:      modified  its modification time; none: now
void write_text_file(const std::filesystem::path& path, std::string_view text,
                     std::optional<std::filesystem::file_time_type> modified = std::nullopt);

}  // namespace loom
