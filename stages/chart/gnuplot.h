#pragma once
#include <filesystem>
#include <map>
#include <string>
#include <vector>

namespace loom::chart {

/// Text files and the pictures that gnuplot makes from them, put in place together: when anything fails, none of
/// them appears or changes.
///   "chart.svg" -> chart.tsv …, chart.gp, chart.svg, chart.png; `gnuplot chart.gp` in that folder makes them again
/// in:      svg      the picture's path; the others lie beside it
/// in:      files    texts by name, the commands among them
/// in:      commands name of the command file, which makes `pictures`
/// throws:  InputError when gnuplot is not installed; std::runtime_error with its words when it fails
void plot(const std::filesystem::path& folder, const std::map<std::string, std::string>& files,
          const std::string& commands, const std::vector<std::string>& pictures);

}  // namespace loom::chart
