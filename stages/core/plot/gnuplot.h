#pragma once
#include <filesystem>
#include <map>
#include <optional>
#include <string>
#include <vector>

namespace loom::plot {

/// Text files and the pictures that gnuplot makes from them, put in place together: when anything fails, none of
/// them appears or changes.
///   "chart.svg" -> chart.tsv …, chart.gp, chart.svg, chart.png; `gnuplot chart.gp` in that folder makes them again
/// in:      folder   where all lie
/// in:      files    texts by name, the commands among them
/// in:      commands name of the command file, which makes `pictures`
/// in:      passing  further files that the commands read, and that go with them
/// throws:  InputError when gnuplot is not installed; std::runtime_error with its words when it fails
void make_pictures(const std::filesystem::path& folder, const std::map<std::string, std::string>& files,
                   const std::string& commands, const std::vector<std::string>& pictures,
                   const std::map<std::string, std::string>& passing = {});

/// A text as gnuplot quotes it.
std::string in_quotes(const std::string& text);

/// Runs a program in a folder, its output in `log` there, in the C locale and with none of the user's variables but
/// PATH and those of fonts and caches: equal inputs give equal bytes.
/// out:     its exit status (-1: killed); nothing when it is not installed
/// throws:  std::runtime_error when it cannot be started
std::optional<int> run_program(const std::filesystem::path& folder, std::vector<std::string> words,
                               const std::filesystem::path& log);

}  // namespace loom::plot
