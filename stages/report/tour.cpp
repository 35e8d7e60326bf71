#include "stages/report/tour.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <filesystem>
#include <set>
#include <sstream>
#include <vector>

#include "formats/chain.h"
#include "formats/io/error.h"
#include "formats/io/mapped_file.h"
#include "formats/io/provenance.h"
#include "report_page.h"
#include "stages/core/app/report.h"
#include "stages/core/table/table.h"
#include "stages/report/html.h"

namespace loom::report {
namespace {

struct Figure {
    std::string section, text, figure, caption, output, command;
};

std::vector<Figure> read_figures(const std::string& file) {
    const Table table = read_tables({file});
    std::vector<Figure> figures;
    for (const std::vector<std::string>& row : table.rows) {
        const auto cell = [&](const char* name) { return row[table.column(name)]; };
        figures.push_back(
            {cell("section"), cell("text"), cell("figure"), cell("caption"), cell("output"), cell("command")});
    }
    return figures;
}

/// Embeds an image into the page.
std::string embedded(const std::string& file, const std::string& caption, std::size_t index) {
    const MappedFile mapped(file);
    const auto bytes = mapped.bytes();
    const std::span content(reinterpret_cast<const std::uint8_t*>(bytes.data()), bytes.size());
    const std::string_view text(reinterpret_cast<const char*>(bytes.data()), bytes.size());
    if (text.starts_with("\x89PNG\r\n\x1a\n"))
        return fmt::format("<img src=\"data:image/png;base64,{}\" alt=\"{}\">", base64(content), escaped(caption));
    if (std::filesystem::path(file).extension() == ".svg") return inline_svg(text, fmt::format("chart{}", index), file);
    throw InputError(fmt::format("{}: is neither a PNG nor an SVG", file));
}

/// Formats the time of a figure's files and all their ancestors, each once.
std::string time_of(const std::string& outputs) {
    if (outputs.empty()) return {};
    double wall_s = 0, cpu_s = 0;
    std::set<std::filesystem::path> counted;
    std::istringstream names(outputs);
    for (std::string output; names >> output;) {
        for (const ChainFile& made : read_chain(output)) {
            if (!counted.insert(made.file.lexically_normal()).second) continue;
            wall_s += made.cost.wall_s;
            cpu_s += made.cost.cpu_s;
        }
    }
    return fmt::format("{} ({} of CPU time)", app::duration_text(wall_s), app::duration_text(cpu_s));
}

std::string figure_of(const Figure& figure, std::size_t index) {
    const bool chart = std::filesystem::path(figure.figure).extension() == ".svg";
    const std::string time = time_of(figure.output);
    return fmt::format("<figure class=\"{}\">\n{}\n<figcaption>{}{}</figcaption>\n</figure>\n",
                       chart ? "chart" : "shown", embedded(figure.figure, figure.caption, index),
                       escaped(figure.caption),
                       time.empty() ? "" : fmt::format("<br><span class=\"took\">{}</span>", escaped(time)));
}

}  // namespace

std::string tour_page(const std::string& file, const std::string& title) {
    const std::vector<Figure> figures = read_figures(file);
    std::string sections;
    for (std::size_t begin = 0, end = 0; begin < figures.size(); begin = end) {
        const Figure& first = figures[begin];
        std::string row;
        std::vector<std::string> commands;
        for (; end < figures.size() && figures[end].section == first.section; ++end) {
            row += figure_of(figures[end], end);
            const std::string& command = figures[end].command;
            if (!command.empty() && std::find(commands.begin(), commands.end(), command) == commands.end())
                commands.push_back(command);
        }
        sections += fmt::format(
            "<section>\n<h2>{}</h2>\n<p>{}</p>\n<div class=\"cells\" style=\"--columns: {}\">\n{}</div>\n"
            "<pre><code>{}</code></pre>\n</section>\n",
            escaped(first.section), escaped(first.text), end - begin, row,
            escaped(fmt::format("{}", fmt::join(commands, "\n"))));
    }
    return filled(tour_html, {{"title", escaped(title.empty() ? "Pathloom" : title)},
                              {"css", page_css},
                              {"sections", sections},
                              {"release", escaped(fmt::format("Pathloom {}", build_release()))}});
}

}  // namespace loom::report
