#pragma once
#include <filesystem>
#include <functional>
#include <string>

#include "formats/path_graph.h"

namespace loom::testing {

/// Returns a handmade graph of 2 x 1 pixels with two samples each. It has every column; one path escapes at once, one
/// has two vertices; each technique and ending occurs.
PathGraph tiny_graph();
/// Returns tiny_graph() with misses of its vertices, one of each kind.
PathGraph tiny_graph_with_misses();

/// Returns tiny_graph() with materials whose exponent, index and coat vary by vertex.
PathGraph tiny_graph_with_own_lobes();

/// Returns n vertices in paths of one vertex each: columns long enough to be mapped.
PathGraph large_graph(std::uint32_t n);

/// An empty folder of the running test; removed by the destructor.
class ScratchFolder {
  public:
    ScratchFolder();
    ~ScratchFolder();
    std::filesystem::path operator/(const std::string& name) const { return folder_ / name; }
    /// Counts the temporary files of writers in the folder.
    int n_partial() const;

  private:
    std::filesystem::path folder_;
};

std::string file_bytes(const std::filesystem::path& path);
void write_bytes(const std::filesystem::path& path, std::string_view bytes);

/// Runs a writer of `path` whose output has NaN or infinity, and moves the kept file to `path`.
void write_nonfinite(const std::filesystem::path& path, const std::function<void()>& write);
/// Reads a file with one byte damaged, or cut there, at every 97th byte: it is read, or refused with its name.
void read_damaged(const std::filesystem::path& file, const std::function<void(const std::filesystem::path&)>& read);
/// Returns the message of the InputError that `body` throws; "nothing was thrown" when it returns.
std::string input_error_of(const std::function<void()>& body);

}  // namespace loom::testing
