#include "stages/report/animation.h"

#include <fmt/format.h>

#include <algorithm>
#include <cctype>
#include <cmath>
#include <filesystem>
#include <map>
#include <optional>

#include "formats/chain.h"
#include "formats/image.h"
#include "formats/io/error.h"
#include "formats/io/json.h"
#include "formats/io/provenance.h"
#include "report_page.h"
#include "stages/core/app/values.h"
#include "stages/core/table/table.h"
#include "stages/report/html.h"
#include "stages/report/pixels.h"
#include "stages/report/report.h"

namespace loom::report {
namespace {

namespace fs = std::filesystem;

/// Pixels of all frames that a page holds, eight bytes each: 32 MB.
constexpr std::size_t most_pixels = std::size_t(1) << 22;
constexpr std::size_t strip_frames = 12;

struct Frame {
    std::string number;
    Pixels pixels;
};

/// Returns the longest side of a frame on the page: the given one, or less so that all frames fit.
std::size_t longest_side(const Image& first, std::size_t n_frames, std::size_t wanted) {
    const std::size_t longest = std::max(first.width, first.height);
    std::size_t factor = (longest + wanted - 1) / wanted;
    while (first.n_pixels() / (factor * factor) * n_frames > most_pixels && factor < longest) ++factor;
    return (longest + factor - 1) / factor;
}

/// Returns the target of a link to a file: relative to the page, percent-encoded so that no part of it is a scheme.
std::string link_to(const std::string& file, const std::string& page) {
    const fs::path folder = fs::absolute(page).parent_path();
    std::string out;
    for (const char c : fs::absolute(file).lexically_relative(folder).generic_string()) {
        const auto byte = static_cast<unsigned char>(c);
        if ((byte < 0x80 && std::isalnum(byte)) ||
            (c != '\0' && std::string_view("-._~/").find(c) != std::string_view::npos))
            out += c;
        else
            out += fmt::format("%{:02X}", byte);
    }
    return out;
}

/// Sum of the costs of all files behind the frames, each once; nothing where a cost is unknown.
std::optional<double> cpu_s_of_all(const std::vector<std::string>& files) {
    std::map<fs::path, double> cpu_s;
    for (const std::string& file : files) {
        if (!fs::exists(cost_path(file))) return std::nullopt;
        for (const ChainFile& made : read_chain(file)) cpu_s[made.file.lexically_normal()] = made.cost.cpu_s;
    }
    double sum = 0;
    for (const auto& [file, seconds] : cpu_s) sum += seconds;
    return sum;
}

/// The table of --by-frame, a row per frame.
struct ByFrame {
    Table rows;
    double value(std::size_t row, const char* column) const { return rows.number(row, rows.column(column)); }
};

ByFrame read_by_frame(const std::string& file, const std::vector<std::string>& frames) {
    ByFrame table{read_tables({file})};
    if (table.rows.rows.size() != frames.size())
        throw InputError(fmt::format("{}: has {} rows, for {} frames; it must be of these frames alone", file,
                                     table.rows.rows.size(), frames.size()));
    return table;
}

std::string percent(double share) {
    return std::isnan(share) ? number(share) : number(100 * share);
}

std::string table_by_frame(const ByFrame& by_frame, const std::vector<Frame>& frames) {
    std::string body;
    for (std::size_t row = 0; row < frames.size(); ++row) {
        const auto cell = [&](const std::string& text) { return fmt::format("<td>{}</td>", text); };
        body += fmt::format(
            "<tr data-frame=\"{}\"><th scope=\"row\">{}</th>{}{}{}{}{}</tr>\n", row, escaped(frames[row].number),
            cell(number(by_frame.value(row, "cpu_s"))), cell(number(by_frame.value(row, "render_s"))),
            cell(percent(by_frame.value(row, "touched"))), cell(number(by_frame.value(row, "expected_relmse"))),
            cell(percent(by_frame.value(row, "static_share"))));
    }
    return fmt::format(
        "<h3>Frame by frame</h3>\n<p>CPU time of what a frame alone is made of, then without reading scenes; the share "
        "of the stored paths that were traced again; the relMSE that the image's own variance lets expect; the part of "
        "it that is noise of the static image. – is not known: a denoised frame holds no variance. Press a row to see "
        "its frame.</p>\n"
        "<div class=\"scroll\"><table>\n<thead><tr><th scope=\"col\">frame</th><th scope=\"col\">CPU s</th><th "
        "scope=\"col\">render s</th><th scope=\"col\">traced again %</th><th scope=\"col\">relMSE expected</th><th "
        "scope=\"col\">of the static image %</th></tr></thead>\n<tbody>\n{}</tbody></table></div>\n",
        body);
}

std::string data_of(const std::vector<Frame>& frames, double fps) {
    JsonWriter json;
    json.begin_object();
    json.integer("width", frames[0].pixels.width);
    json.integer("height", frames[0].pixels.height);
    json.number("fps", fps);
    json.begin_array("frames");
    for (const Frame& frame : frames) {
        json.begin_object();
        json.text("number", frame.number);
        json.text("halves", frame.pixels.data);
        json.end_object();
    }
    json.end_array();
    json.end_object();
    return embedded_json(json.str());
}

/// Returns buttons with the frames of the strip, evenly spaced.
std::string strip_of(const std::vector<Frame>& frames, std::size_t& n_shown) {
    n_shown = std::min(strip_frames, frames.size());
    std::string out;
    for (std::size_t k = 0; k < n_shown; ++k) {
        const std::size_t frame = n_shown == 1 ? 0 : (k * (frames.size() - 1) + (n_shown - 1) / 2) / (n_shown - 1);
        out += fmt::format("<button type=\"button\" data-frame=\"{}\"><canvas></canvas>{}</button>\n", frame,
                           escaped(frames[frame].number));
    }
    return out;
}

}  // namespace

std::string animation_page(const Options& options) {
    // Read the frames.
    std::vector<Frame> frames;
    std::uint32_t width = 0, height = 0;
    std::size_t longest = 0;
    std::uint64_t n_clipped = 0;
    for (const std::string& file : options.animation) {
        const Image image = read_image(file);
        if (image.n_pixels() == 0) throw InputError(fmt::format("{}: has no pixels", file));
        require_finite(image, {""}, file);
        if (frames.empty()) {
            width = image.width, height = image.height;
            longest = longest_side(image, options.animation.size(), std::size_t(options.longest_side));
        }
        if (image.width != width || image.height != height)
            throw InputError(fmt::format("{}: is {} x {}, but {} is {} x {}", file, image.width, image.height,
                                         options.animation[0], width, height));
        frames.push_back({std::to_string(app::number_at_end(file).value_or(frames.size())), pixels_of(image, longest)});
        n_clipped += frames.back().pixels.n_clipped;
    }
    std::optional<ByFrame> by_frame;
    if (!options.by_frame.empty()) {
        by_frame = read_by_frame(options.by_frame, options.animation);
        for (std::size_t k = 0; k < frames.size(); ++k)
            frames[k].number = by_frame->rows.rows[k][by_frame->rows.column("frame")];
    }

    // Sum up the costs.
    std::string facts = fmt::format("{} frames · {} × {} pixels", frames.size(), width, height);
    if (const std::optional<double> all = cpu_s_of_all(options.animation)) {
        facts += fmt::format(" · {}\u202fs of CPU time in all", number(*all));
        if (by_frame) {
            double own = 0;
            for (std::size_t k = 0; k < frames.size(); ++k) own += by_frame->value(k, "cpu_s");
            if (own < *all) facts += fmt::format(", {}\u202fs of it for what frames share", number(*all - own));
        }
    }
    std::string reduced;
    if (const std::size_t factor = frames[0].pixels.factor; factor > 1)
        reduced = fmt::format(" The frames are reduced {0} times, each pixel being the mean of {0} × {0}.", factor);
    if (n_clipped > 0) reduced += fmt::format(" {} values above 65504 are shown as 65504.", n_clipped);

    // Write the page.
    std::string costs;
    for (std::size_t k = 0; k < options.charts.size(); ++k)
        costs += chart_figure(options.charts[k], fmt::format("chart{}", k), 3 + int(k), "Cost and error by frame",
                              "CPU time of a frame without reading scenes and without what frames share; the share of "
                              "the stored paths that were traced again; the relMSE that its variance lets expect.");
    if (by_frame) costs += table_by_frame(*by_frame, frames);
    const bool has_cost = fs::exists(cost_path(options.animation[0]));
    std::size_t n_shown = 0;
    const std::string strip = strip_of(frames, n_shown);
    return filled(
        animation_html,
        {{"title", escaped(options.title.empty() ? "Animation" : options.title)},
         {"css", page_css},
         {"pixels", pixels_js},
         {"js", animation_js},
         {"facts", facts},
         {"last", std::to_string(frames.size() - 1)},
         {"fps", fmt::format("{:.4g}", options.fps)},
         {"reduced", reduced},
         {"movie", options.movie.empty() ? ""
                                         : fmt::format(" As a movie: <a href=\"{}\">{}</a>.",
                                                       escaped(link_to(options.movie, options.output)),
                                                       escaped(fs::path(options.movie).filename().string()))},
         {"columns", std::to_string(std::min<std::size_t>(n_shown, 6))},
         {"strip", strip},
         {"costs", section("costs", "Costs and errors", costs)},
         {"lineage",
          section("lineage", "Plan and lineage",
                  "<p>Each file was made by one stage from the files named beside it; <i>plan</i> says what the stage "
                  "switched on. Other frames are made as the first one.</p>\n" +
                      lineage_details("Frame " + escaped(frames[0].number),
                                      has_cost ? lineage_of(options.animation[0]) : std::vector<Made>{}, true))},
         {"made_by", options.made_by.empty()
                         ? ""
                         : fmt::format("<p>This page again: <code>{}</code></p>", escaped(options.made_by))},
         {"release", escaped(fmt::format("Pathloom {}", build_release()))},
         {"data", data_of(frames, options.fps)}});
}

}  // namespace loom::report
