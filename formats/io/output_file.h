#pragma once
#include <cstdio>
#include <filesystem>
#include <optional>
#include <stdexcept>
#include <string>
#include <string_view>

namespace loom {

/// Whether the bytes must be on the device before the name appears. `no` is for timed runs only.
enum class Sync { no, yes };

/// An output that holds values which are not finite. It is kept under not_finite_name().
class NonfiniteError : public std::runtime_error {
    using std::runtime_error::runtime_error;
};
/// "x.exr" -> "x.not-finite.exr"
std::filesystem::path not_finite_name(const std::filesystem::path& output);

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
    /// NEEDS the partial file to be closed by whoever wrote it. Removes what an earlier writer of the name kept as
    /// not finite.
    /// in:      nonfinite  which values are NaN or infinite, as text; empty when none is
    /// throws:  NonfiniteError, after keeping the file under not_finite_name(), when `nonfinite` is not empty
    void commit(Sync sync = Sync::yes, std::string_view nonfinite = {});

  private:
    std::filesystem::path path_, partial_;
    bool committed_ = false;
};

/// Buffered writes to the partial file of an output. Every failure is reported, the last one by close().
class OutputStream {
  public:
    /// throws:  std::runtime_error, as write() and close() do, with the name of the output
    explicit OutputStream(const OutputFile& output);
    ~OutputStream();
    OutputStream(const OutputStream&) = delete;
    OutputStream& operator=(const OutputStream&) = delete;

    std::FILE* get() const { return file_; }
    void write(const void* bytes, std::size_t n);
    /// Flushes and closes. Throws also when an earlier write failed and its caller ignored that.
    void close();

  private:
    [[noreturn]] void fail() const;
    std::filesystem::path path_;
    std::FILE* file_;
    int error_ = 0;  // errno of the first failure
};

/// The check that OutputFile makes, for a stage to make before it starts to compute.
/// throws:  InputError
void check_output_path(const std::filesystem::path& path);

/// Writes a small text file by write-then-rename.
/// in:      modified  its modification time; none: now
void write_text_file(const std::filesystem::path& path, std::string_view text,
                     std::optional<std::filesystem::file_time_type> modified = std::nullopt);

}  // namespace loom
