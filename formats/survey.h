#pragma once
// Contents of any HDF5 or EXR file, of this project or not, for display.

#include <cstdint>
#include <filesystem>
#include <string>
#include <utility>
#include <vector>

namespace loom {

/// Statistics of all numbers of a dataset or channel; min, mean and max cover the finite ones only.
struct Statistics {
    std::uint64_t n = 0, n_nan = 0, n_inf = 0;
    double min = 0, mean = 0, max = 0;
};

struct DatasetSummary {
    std::string name, type, units, axes, description;
    std::vector<std::size_t> extents;
    std::uint64_t bytes = 0;  // size of its numbers, uncompressed
    std::string storage;      // "contiguous", "chunked", "compact"
    bool is_number = false;
    Statistics statistics;            // only when is_number
    std::vector<std::string> values;  // the first few texts, or single numbers
};

using NamedTexts = std::vector<std::pair<std::string, std::string>>;

struct Survey {
    enum class Kind { hdf5, exr } kind = Kind::hdf5;
    NamedTexts attributes;  // of the root, or of the EXR header
    std::vector<DatasetSummary> datasets;
    std::uint64_t file_bytes = 0;

    /// Returns the value of an attribute; empty when it is absent.
    std::string attribute(std::string_view name) const;
};

/// Reads the survey of a file.
/// throws:  InputError when the file is neither HDF5 nor EXR, truncated or damaged
Survey survey_file(const std::filesystem::path& path);

}  // namespace loom
