#pragma once
#include <filesystem>
#include <functional>
#include <string>

#include "formats/path_graph.h"

namespace loom::testing {

/// A graph of 2 x 1 pixels with two samples each, made by hand: every column is there, one path escapes at
/// once, one has two vertices, and each technique and ending occurs.
PathGraph tiny_graph();
/// The same, with what its vertices asked for and did not get, of each kind one.
PathGraph tiny_graph_with_misses();

/// The same, with materials whose exponent, index and coat each vertex has for itself.
PathGraph tiny_graph_with_own_lobes();

/// n vertices in paths of one vertex each: columns long enough to be mapped.
PathGraph large_graph(std::uint32_t n);

/// An empty folder of its own for the running test; removed when destroyed.
class ScratchFolder {
  public:
    ScratchFolder();
    ~ScratchFolder();
    std::filesystem::path operator/(const std::string& name) const { return folder_ / name; }
    /// Temporary files of writers in it.
    int n_partial() const;

  private:
    std::filesystem::path folder_;
};

std::string file_bytes(const std::filesystem::path& path);
void write_bytes(const std::filesystem::path& path, std::string_view bytes);

/// Runs a writer of `path` whose output holds NaN or infinity, and puts what it kept at `path`.
void write_nonfinite(const std::filesystem::path& path, const std::function<void()>& write);
/// The message of the InputError that `body` throws; "nothing was thrown" when it returns.
std::string input_error_of(const std::function<void()>& body);

}  // namespace loom::testing
