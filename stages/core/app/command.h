#pragma once
// The command line of a stage: options bound to the fields of a plain struct, exit codes, the log.
//
//   int main(int argc, char** argv) {
//       trace::Options options;
//       app::Command command{"trace: sample paths, write a path graph"};
//       trace::declare(command, options);
//       return command.execute(argc, argv, [&] { return trace::run(options, command.report); });
//   }

#include <functional>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <type_traits>
#include <utility>
#include <vector>

#include "stages/core/app/report.h"
#include "stages/core/app/values.h"

namespace CLI {
class App;
class Option;
}  // namespace CLI

namespace loom::app {

/// Exit codes: 0 done, 1 the answer is no, 2 the command line or an input is wrong, 3 any other failure.
enum Exit : int { exit_done = 0, exit_no = 1, exit_wrong_input = 2, exit_failed = 3 };

/// Options and body of one stage. A function that declares an option binds it to a field that holds the default. The
/// field must outlive the Command. Names are CLI11's: "--spp", "-o,--output", "scene" (positional).
class Command {
  public:
    /// Handle of a declared option.
    class Option {
      public:
        /// Makes the absence of the option an error.
        void required();

      private:
        friend class Command;
        explicit Option(CLI::Option* option) : option_(option) {}
        CLI::Option* option_;
    };

    /// in:      about  "NAME: what the stage does"; the program's name is then loom-NAME
    explicit Command(const std::string& about);
    ~Command();

    /// Declares a number, or an optional number (omitted from the command's text while unset).
    template <class T>
    requires Number<typename value_of<T>::type> Option
    option(const std::string& names, T& field, const std::string& help,
           std::optional<Range<typename value_of<T>::type>> range = std::nullopt);
    /// Declares a text, or a list of texts, one per use of the flag (`-D a=1 -D b=2`).
    Option option(const std::string& names, std::string& field, const std::string& help);
    Option option(const std::string& names, std::vector<std::string>& field, const std::string& help);
    Option flag(const std::string& names, bool& field, const std::string& help);
    /// Declares one value of a closed set, by name.
    template <class Enum>
    Option choice(const std::string& names, Enum& field, const std::string& help,
                  std::vector<std::pair<std::string, Enum>> values);

    /// Declares an input that must exist; `files` takes one or more. The command's text has base names only.
    Option file(const std::string& names, std::string& field, const std::string& help);
    Option files(const std::string& names, std::vector<std::string>& field, const std::string& help);
    /// Declares an input whose name may hold a % for the numbers of its files. The body checks that they exist.
    Option file_or_sequence(const std::string& names, std::string& field, const std::string& help);
    /// Declares one or more inputs with an optional label, LABEL=FILE (see split_label). The body checks that they
    /// exist.
    Option labelled_files(const std::string& names, std::vector<std::string>& field, const std::string& help);
    /// Declares a file to write; its folder must exist. Not in the command's text.
    Option output(const std::string& names, std::string& field, const std::string& help);
    /// Declares --threads; 0: all. Not in the command's text.
    Option threads(int& field);
    /// Adds an example command line to the end of the help.
    void example(const std::string& line);

    /// Parses, prints the resolved options, runs the body and maps its outcome to an exit code. The body returns an
    /// exit code or nothing, and throws InputError for a wrong input.
    template <class Body>
    int execute(int argc, char** argv, Body&& body) {
        if constexpr (std::is_void_v<std::invoke_result_t<Body&>>)
            return execute_body(argc, argv, [&]() -> int { return body(), exit_done; });
        else
            return execute_body(argc, argv, [&]() -> int { return body(); });
    }

    /// Returns the resolved options as text, defaults included.
    /// in:      for_output  omit what must not reach an output: folders, names of outputs, threads
    std::string text(bool for_output) const;

    Report report;

  private:
    enum class Kind { value, input, labelled_input, place };  // place: location or speed, no effect on the result
    struct Declared {
        Kind kind;
        std::string flag;                               // empty for a positional
        std::function<std::vector<std::string>()> get;  // empty while unset
        bool is_flag = false;
        bool is_output = false;
    };

    Option declare(const std::string& names, const std::string& help, const std::string& type, Kind kind,
                   std::function<void(const std::string&)> set, std::function<std::vector<std::string>()> get);
    void check_files() const;
    int execute_body(int argc, char** argv, const std::function<int()>& body);
    [[noreturn]] static void refuse(const std::string& message);

    std::unique_ptr<CLI::App> app_;  // a pointer, because its headers are slow to compile
    std::vector<Declared> declared_;
};

template <class T>
requires Number<typename value_of<T>::type> Command::Option Command::option(
    const std::string& names, T& field, const std::string& help,
    std::optional<Range<typename value_of<T>::type>> range) {
    using Value = typename value_of<T>::type;
    const std::string kind = std::floating_point<Value> ? "number" : "whole number";
    std::string type = std::floating_point<Value> ? "NUMBER" : "INT";
    if (range) {
        type += range->high == std::numeric_limits<Value>::max() ? fmt::format(" >= {}", range->low)
                                                                 : fmt::format(" {}..{}", range->low, range->high);
        if (!range->unit.empty()) type += " " + range->unit;
    }
    const auto set = [&field, range, kind](const std::string& text) {
        const std::optional<Value> value = parse_number<Value>(text);
        if (!value) {
            // A number too large for the type is reported as out of range, not as "no number".
            refuse(fmt::format("'{}' is not a {}{}", text, kind,
                               range ? fmt::format(" from {} to {}", range->low, range->high) : ""));
        }
        if (range && (*value < range->low || *value > range->high))
            refuse(fmt::format("{} is not in {} to {}", text, range->low, range->high));
        field = *value;
    };
    const auto get = [&field]() -> std::vector<std::string> {
        if constexpr (is_optional<T>::value) {
            if (!field) return {};
            return {number_text(*field)};
        } else {
            return {number_text(field)};
        }
    };
    return declare(names, help, type, Kind::value, set, get);
}

template <class Enum>
Command::Option Command::choice(const std::string& names, Enum& field, const std::string& help,
                                std::vector<std::pair<std::string, Enum>> values) {
    std::string allowed;
    for (const auto& [name, value] : values) allowed += (allowed.empty() ? "" : "|") + name;
    const auto set = [&field, values, allowed](const std::string& text) {
        for (const auto& [name, value] : values) {
            if (name == text) {
                field = value;
                return;
            }
        }
        refuse(fmt::format("'{}' is not one of {}", text, allowed));
    };
    const auto get = [&field, values]() -> std::vector<std::string> {
        for (const auto& [name, value] : values)
            if (value == field) return {name};
        return {};
    };
    return declare(names, help, allowed, Kind::value, set, get);
}

/// Returns the command that makes one part of the output of `command`. For each of `changes`, the first occurrence of
/// its first text is replaced by its second.
std::string command_of_part(std::string command, std::span<const std::pair<std::string, std::string>> changes);
inline std::string command_of_part(std::string command,
                                   std::initializer_list<std::pair<std::string, std::string>> changes) {
    return command_of_part(std::move(command), std::span(changes.begin(), changes.size()));
}

/// Returns the command that makes one frame of a table alone.
/// in:      command  with --frames TABLE, and --only ONLY where that is not empty
std::string command_of_frame(std::string command, const std::string& table, const std::string& only,
                             const std::string& only_this);

}  // namespace loom::app
