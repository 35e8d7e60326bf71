#include "stages/core/app/command.h"

#include <CLI/App.hpp>
#include <CLI/Config.hpp>
#include <CLI/Formatter.hpp>
#include <algorithm>
#include <csignal>
#include <exception>
#include <filesystem>
#include <new>
#include <sstream>

#include "formats/io/error.h"
#include "formats/io/output_file.h"
#include "version.h"

namespace loom::app {
namespace {

/// Upper bound for a list option; the command line's own length is the real limit.
constexpr int any_number = 1 << 20;

std::string program_of(const std::string& about) {
    return "loom-" + about.substr(0, about.find(':'));
}

/// Replaces absolute paths, alone or as the value of a definition, by base names, because they reveal the machine.
std::string without_place(const std::string& word) {
    const std::size_t value = word.find('=') == std::string::npos ? 0 : word.find('=') + 1;
    if (value >= word.size() || word[value] != '/') return word;
    return word.substr(0, value) + base_name(std::string_view(word).substr(value));
}

}  // namespace

std::optional<std::uint64_t> number_at_end(std::string_view path) {
    std::string_view stem = path.substr(path.rfind('/') + 1);  // npos + 1 is 0
    stem = stem.substr(0, stem.rfind('.'));
    return parse_number<std::uint64_t>(stem.substr(stem.find_last_not_of("0123456789") + 1));
}

std::string name_of_part(std::string name, std::string_view part) {
    const auto at = name.rfind('%');
    return at == std::string::npos ? name : name.replace(at, 1, part);
}

std::string base_name(std::string_view path) {
    return std::filesystem::path(path).filename().string();
}

Labelled split_label(const std::string& text) {
    const std::size_t at = text.find('=');
    std::error_code ignored;
    if (at == std::string::npos || std::filesystem::exists(text, ignored)) return {"", text};
    return {text.substr(0, at), text.substr(at + 1)};
}

std::string shell_word(std::string_view word) {
    const auto plain = [](char c) {
        return (c >= '0' && c <= '9') || (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') ||
               std::string_view("_-+./,:=@%").find(c) != std::string_view::npos;
    };
    if (!word.empty() && std::all_of(word.begin(), word.end(), plain)) return std::string(word);
    std::string out = "'";
    for (const char c : word) {
        if (c == '\'') out += "'\\'";
        out += c;
    }
    return out + "'";
}

Command::Command(const std::string& about)
    : report(program_of(about)), app_(std::make_unique<CLI::App>(about, program_of(about))) {
    app_->set_version_flag("--version", fmt::format("{} {} (commit {})", report.name(), LOOM_RELEASE, LOOM_COMMIT),
                           "print release and commit, and stop");
    app_->set_help_flag("-h,--help", "print this help and stop");
    app_->get_formatter()->column_width(34);
    app_->add_flag_callback(
        "--quiet", [this] { report.set_quiet(true); }, "print only warnings and errors on stderr");
}

Command::~Command() = default;

void Command::Option::required() {
    option_->required();
}

void Command::refuse(const std::string& message) {
    throw CLI::ValidationError(message);
}

Command::Option Command::declare(const std::string& names, const std::string& help, const std::string& type, Kind kind,
                                 std::function<void(const std::string&)> set,
                                 std::function<std::vector<std::string>()> get) {
    const std::string shown = names.substr(names.rfind(',') + 1);
    const auto callback = [set = std::move(set), shown](const CLI::results_t& texts) {
        for (const std::string& text : texts) {
            try {
                set(text);
            } catch (const CLI::ValidationError& wrong) {
                throw CLI::ValidationError(shown, wrong.what());
            }
        }
        return true;
    };
    CLI::Option* option = app_->add_option(names, callback, help);
    option->type_name(type);
    const std::vector<std::string> now = get();
    if (!now.empty()) option->default_str(now.front());
    // "-o,--output" is identified by its last name, the long one.
    declared_.push_back({kind, shown.starts_with('-') ? shown : "", std::move(get)});
    return Option(option);
}

Command::Option Command::option(const std::string& names, std::string& field, const std::string& help) {
    return declare(
        names, help, "TEXT", Kind::value, [&field](const std::string& text) { field = text; },
        [&field]() -> std::vector<std::string> {
            if (field.empty()) return {};
            return {field};
        });
}

Command::Option Command::option(const std::string& names, std::vector<std::string>& field, const std::string& help) {
    const Option list = declare(
        names, help, "TEXT", Kind::value, [&field](const std::string& text) { field.push_back(text); },
        [&field] { return field; });
    list.option_->take_all()->allow_extra_args(false);
    return list;
}

Command::Option Command::flag(const std::string& names, bool& field, const std::string& help) {
    const std::string shown = names.substr(names.rfind(',') + 1);
    declared_.push_back({Kind::value, shown,
                         [&field]() -> std::vector<std::string> {
                             if (!field) return {};
                             return {"true"};
                         },
                         true});
    return Option(app_->add_flag_callback(
        names, [&field] { field = true; }, help));
}

Command::Option Command::file(const std::string& names, std::string& field, const std::string& help) {
    const Option option = this->option(names, field, help);
    declared_.back().kind = Kind::input;
    option.option_->type_name("FILE");
    return option;
}

Command::Option Command::files(const std::string& names, std::vector<std::string>& field, const std::string& help) {
    const Option option = this->option(names, field, help);
    declared_.back().kind = Kind::input;
    option.option_->type_name("FILE")->expected(1, any_number)->allow_extra_args();
    return option;
}

Command::Option Command::file_or_sequence(const std::string& names, std::string& field, const std::string& help) {
    const Option option = file(names, field, help);
    declared_.back().kind = Kind::labelled_input;
    return option;
}

Command::Option Command::labelled_files(const std::string& names, std::vector<std::string>& field,
                                        const std::string& help) {
    const Option option = files(names, field, help);
    declared_.back().kind = Kind::labelled_input;
    option.option_->type_name("[LABEL=]FILE");
    return option;
}

Command::Option Command::output(const std::string& names, std::string& field, const std::string& help) {
    const Option option = this->option(names, field, help);
    declared_.back().kind = Kind::place;
    declared_.back().is_output = true;
    option.option_->type_name("FILE");
    return option;
}

Command::Option Command::threads(int& field) {
    const Option option = this->option("--threads", field, "threads; 0: one per core", Range<int>{0, 1024});
    declared_.back().kind = Kind::place;
    return option;
}

void Command::example(const std::string& line) {
    const std::string before = app_->get_footer();
    app_->footer((before.empty() ? "Example: " : before + "\n         ") + line);
}

std::string Command::text(bool for_output) const {
    std::string text = report.name();
    for (const Declared& option : declared_) {
        if (for_output && option.kind == Kind::place) continue;
        for (const std::string& value : option.get()) {
            if (!option.flag.empty()) text += " " + option.flag;
            if (option.is_flag) continue;
            if (!for_output)
                text += " " + shell_word(value);
            else if (option.kind == Kind::labelled_input) {
                const auto [label, file] = split_label(value);
                text += " " + shell_word(label.empty() ? base_name(file) : label + "=" + base_name(file));
            } else
                text += " " + shell_word(option.kind == Kind::input ? base_name(value) : without_place(value));
        }
    }
    return text;
}

std::string command_of_part(std::string command, std::span<const std::pair<std::string, std::string>> changes) {
    for (const auto& [from, to] : changes)
        if (const auto at = command.find(from); at != std::string::npos) command.replace(at, from.size(), to);
    return command;
}

std::string command_of_frame(std::string command, const std::string& table, const std::string& only,
                             const std::string& only_this) {
    const std::string this_one = " --only " + only_this, frames = " --frames " + shell_word(base_name(table));
    return command_of_part(std::move(command), {only.empty() ? std::pair(frames, frames + this_one)
                                                             : std::pair(" --only " + only, this_one)});
}

void Command::check_files() const {
    namespace fs = std::filesystem;
    for (const Declared& option : declared_) {
        for (const std::string& name : option.get()) {
            std::error_code ignored;
            if (option.kind == Kind::input) {
                if (!fs::exists(name, ignored)) throw InputError(fmt::format("{}: no such file", name));
                if (fs::is_directory(name, ignored)) throw InputError(fmt::format("{}: a folder, not a file", name));
            } else if (option.is_output) {
                check_output_path(name);
            }
        }
    }
}

int Command::execute_body(int argc, char** argv, const std::function<int()>& body) {
    std::signal(SIGXFSZ, SIG_IGN);  // a file at its size limit is a failed write, like a full disk
    try {
        app_->parse(argc, argv);
        report.set_command(text(true));
        report.info("{}", text(false));
        check_files();
        const int code = body();
        report.flush_answers();
        return code;
    } catch (const CLI::Success& asked) {  // --help, --version
        std::ostringstream text;
        app_->exit(asked, text, text);
        try {
            report.answer(text.str());
            report.flush_answers();
            return exit_done;
        } catch (const std::exception& failure) {
            report.error("{}", failure.what());
            return exit_failed;
        }
    } catch (const CLI::ParseError& wrong) {
        report.error("{}\n{}: see {} --help", wrong.what(), report.name(), report.name());
        return exit_wrong_input;
    } catch (const InputError& wrong) {
        report.error("{}", wrong.what());
        return exit_wrong_input;
    } catch (const std::bad_alloc&) {
        report.error("out of memory (peak so far {})", bytes_text(report.usage().peak_memory_bytes));
        return exit_failed;
    } catch (const std::exception& failure) {
        report.error("{}", failure.what());
        return exit_failed;
    }
}

}  // namespace loom::app
