#pragma once
// Images and their labels, as the command line names them.

#include <cstdint>
#include <map>
#include <string>
#include <vector>

namespace loom::compare {

struct Input {
    std::string label, file;  // label: the file where none is given
};
/// Splits [LABEL=]FILE.
/// throws:  InputError for a label that no table can hold
std::vector<Input> inputs_of(const std::vector<std::string>& texts);

/// An image with what it says of its noise.
struct NoisyImage {
    std::size_t width = 0, height = 0;
    std::uint64_t samples = 0;         // per pixel; 0: unknown
    std::vector<float> rgb, var_mean;  // [y, x, rgb]; var_mean: empty: unknown
};
/// throws:  InputError for a file without pixels, or with NaN or infinite values
NoisyImage read_noisy_image(const std::string& file);

/// Returns the files of a sequence by the numbers of its frames.
/// in:      pattern  a name with a % for the number
/// throws:  InputError without a %, without files, or with two files of one number
std::map<std::uint64_t, std::string> files_of_sequence(const std::string& pattern);

}  // namespace loom::compare
