#pragma once
#include <filesystem>
#include <map>
#include <optional>
#include <string>
#include <vector>

namespace loom::plot {

/// Writes text files and the images that gnuplot makes from them, all or none: on any failure no file appears or
/// changes.
///   "chart.svg" -> chart.tsv …, chart.gp, chart.svg, chart.png; `gnuplot chart.gp` in that folder makes them again
/// in:      folder   folder of all files
/// in:      files    texts by name, the command file included
/// in:      commands name of the command file, which makes `pictures`
/// in:      passing  further files that the commands read, written beside them
/// throws:  InputError when gnuplot is not installed; std::runtime_error with its message when it fails
void make_pictures(const std::filesystem::path& folder, const std::map<std::string, std::string>& files,
                   const std::string& commands, const std::vector<std::string>& pictures,
                   const std::map<std::string, std::string>& passing = {});

/// Quotes a text for gnuplot; control characters become blanks.
std::string in_quotes(const std::string& text);

/// Runs a program in a folder, its output in the file `log`. It runs in the C locale, and of the user's variables only
/// PATH and those of fonts and caches are set: equal inputs give equal bytes.
/// out:     its exit status (-1: killed); nothing when it is not installed
/// throws:  std::runtime_error when it cannot be started
std::optional<int> run_program(const std::filesystem::path& folder, std::vector<std::string> words,
                               const std::filesystem::path& log);

}  // namespace loom::plot
