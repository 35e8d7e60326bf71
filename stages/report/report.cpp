#include "stages/report/report.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <cmath>
#include <fstream>
#include <iterator>
#include <limits>
#include <optional>

#include "formats/image.h"
#include "formats/io/error.h"
#include "formats/io/json.h"
#include "formats/io/output_file.h"
#include "report_page.h"
#include "stages/core/app/command.h"
#include "stages/core/stats/student.h"
#include "stages/core/table/table.h"
#include "stages/report/animation.h"
#include "stages/report/html.h"
#include "stages/report/pixels.h"
#include "stages/report/tour.h"

namespace loom::report {
namespace {

namespace fs = std::filesystem;
constexpr double unknown = std::numeric_limits<double>::quiet_NaN();

struct Picture {
    std::string label, file;
    std::uint64_t samples = 0;
    std::uint32_t width = 0, height = 0;
    Pixels pixels;
    std::vector<Made> lineage;  // empty: made by another program
    double relmse = unknown;    // mean over its replicates

    std::string name() const { return samples == 0 ? label : fmt::format("{}, {} spp", label, samples); }
    double cpu_s() const { return lineage.empty() ? unknown : cpu_s_of(lineage); }
};

Picture read_picture(const std::string& label, const std::string& file, const Options& options) {
    const Image image = read_image(file);
    if (image.n_pixels() == 0) throw InputError(fmt::format("{}: has no pixels", file));
    require_finite(image, {""}, file);
    Picture picture{label, file, image.samples, image.width, image.height, {}, {}, unknown};
    picture.pixels = pixels_of(image, std::size_t(options.longest_side));
    return picture;
}

/// Replicates of one setting in a table of errors.
struct Group {
    std::string method, samples;
    std::vector<std::size_t> rows;
};

std::vector<Group> groups_of(const Table& errors) {
    std::vector<Group> groups;
    const std::size_t method = errors.column("method"), samples = errors.column("samples");
    for (std::size_t row = 0; row < errors.rows.size(); ++row) {
        const auto& cells = errors.rows[row];
        auto group = std::find_if(groups.begin(), groups.end(), [&](const Group& g) {
            return g.method == cells[method] && g.samples == cells[samples];
        });
        if (group == groups.end()) group = groups.insert(groups.end(), {cells[method], cells[samples], {}});
        group->rows.push_back(row);
    }
    return groups;
}

Estimate estimate(const Table& errors, const Group& group, const char* column) {
    std::vector<double> values;
    for (std::size_t row : group.rows) values.push_back(errors.number(row, errors.column(column)));
    const bool finite = std::all_of(values.begin(), values.end(), [](double v) { return std::isfinite(v); });
    return values.size() < 2 || !finite ? Estimate{values[0], unknown, 0} : estimate_of(values);
}

std::string with_error(const Table& errors, const Group& group, const char* column, double scale = 1) {
    const Estimate e = estimate(errors, group, column);
    return number(scale * e.mean, scale * e.se);
}

std::string p_value(double p) {
    return std::isnan(p) ? "–" : p < 1e-4 ? "&lt;\u202f0.0001" : fmt::format("{:.4f}", p);
}

std::string samples_text(const Group& group) {
    return group.samples == "0" ? "–" : escaped(group.samples);
}

std::string error_table(const Table& errors) {
    std::vector<Cells> rows;
    for (const Group& group : groups_of(errors)) {
        rows.push_back({escaped(group.method), samples_text(group), std::to_string(group.rows.size()),
                        with_error(errors, group, "relmse"), with_error(errors, group, "relmse_trimmed"),
                        with_error(errors, group, "mape", 100), number(estimate(errors, group, "psnr").mean),
                        fmt::format("{:.4f}", estimate(errors, group, "ssim").mean)});
    }
    return table({"method", "spp", "n", "relMSE", "trimmed", "MAPE %", "PSNR dB", "SSIM"}, rows);
}

std::string parts_table(const Table& errors) {
    std::vector<Cells> rows;
    for (const Group& group : groups_of(errors)) {
        const auto mean = [&](const char* column) { return estimate(errors, group, column).mean; };
        rows.push_back({escaped(group.method), samples_text(group), number(mean("bias2")), number(mean("variance")),
                        number(mean("reference_noise")), number(mean("corr_right")), number(mean("corr_near")),
                        p_value(mean("p_image")), p_value(mean("p_tiles"))});
    }
    return table({"method", "spp", "bias²", "variance", "reference", "right", "2 to 8 px", "p image", "p tiles"}, rows);
}

std::string cost_table(const Table& errors) {
    std::vector<Cells> rows;
    for (const Group& group : groups_of(errors)) {
        rows.push_back({escaped(group.method), samples_text(group), with_error(errors, group, "cpu_s"),
                        with_error(errors, group, "render_s"), with_error(errors, group, "wall_s"),
                        counted(estimate(errors, group, "rays").mean),
                        bytes(estimate(errors, group, "peak_memory_bytes").mean)});
    }
    return table({"method", "spp", "CPU s", "render s", "wall s", "rays", "peak memory"}, rows);
}

std::string words_for(const std::string& column) {
    static const std::map<std::string, std::string> words{
        {"cpu_s", "CPU time"},        {"wall_s", "wall time"},
        {"render_s", "render time"},  {"rays", "number of rays"},
        {"relmse", "relMSE"},         {"relmse_trimmed", "trimmed relMSE"},
        {"relmse_net", "net relMSE"}, {"mse", "MSE"},
        {"mse_net", "net MSE"},       {"mape", "MAPE"}};
    const auto at = words.find(column);
    return at == words.end() ? column : at->second;
}

/// Rows of loom-chart's equal-cost or equal-error table: the column that is equal, and the compared column.
struct Matches {
    Table rows;
    std::string equal, compared;
    double value(std::size_t row, const char* column) const { return rows.number(row, rows.column(column)); }
    const std::string& text(std::size_t row, const char* column) const { return rows.rows[row][rows.column(column)]; }
    std::string unit(const std::string& column) const { return column.ends_with("_s") ? " s" : ""; }
};

/// Reads a table of matches; nothing where it has no rows because no two curves overlap.
std::optional<Matches> read_matches(const std::string& file) {
    if (file.empty()) return std::nullopt;
    std::ifstream in(file);
    std::string head, first;
    if (!in || !std::getline(in, head)) throw InputError(fmt::format("{}: cannot be read", file));
    if (!std::getline(in, first)) return std::nullopt;
    Matches matches{read_tables({file}), {}, {}};
    for (const std::string& name : matches.rows.names) {
        if (name.starts_with("equal_")) matches.equal = name.substr(6);
        if (name.ends_with("_first")) matches.compared = name.substr(0, name.size() - 6);
    }
    if (matches.equal.empty() || matches.compared.empty())
        throw InputError(fmt::format("{}: is no table of equal costs or errors of loom-chart", file));
    return matches;
}

std::string match_table(const Matches& matches) {
    std::vector<Cells> rows;
    const std::string first = matches.compared + "_first", method = matches.compared + "_method",
                      equal = "equal_" + matches.equal;
    for (std::size_t row = 0; row < matches.rows.rows.size(); ++row) {
        const double low = matches.value(row, "low"), high = matches.value(row, "high"),
                     ratio = matches.value(row, "times_better");
        rows.push_back({escaped(matches.text(row, "method")), escaped(matches.text(row, "first")),
                        number(matches.value(row, equal.c_str())), number(matches.value(row, method.c_str())),
                        number(matches.value(row, first.c_str())),
                        fmt::format("<b class=\"{}\">{}\u202f×</b>",
                                    low < 1 && high > 1 ? "noise"
                                    : ratio < 1         ? "worse"
                                                        : "better",
                                    number(ratio)),
                        std::isnan(low) ? "–" : fmt::format("{} to {}", number(low), number(high))});
    }
    return table({"method", "beside", escaped("equal " + words_for(matches.equal)),
                  escaped(words_for(matches.compared)), escaped("of the other"), "times better", "95 %"},
                 rows);
}

/// Makes a sentence for each method against the first, at the highest common level.
std::string headline(const std::optional<Matches>& matches) {
    if (!matches) return {};
    std::vector<std::string> methods;
    std::map<std::string, std::size_t> furthest;
    const std::string equal = "equal_" + matches->equal;
    for (std::size_t row = 0; row < matches->rows.rows.size(); ++row) {
        const std::string& method = matches->text(row, "method");
        const auto [at, is_new] = furthest.try_emplace(method, row);
        if (is_new) methods.push_back(method);
        if (matches->value(row, equal.c_str()) > matches->value(at->second, equal.c_str())) at->second = row;
    }
    std::string out;
    for (const std::string& method : methods) {
        const std::size_t row = furthest.at(method);
        const double ratio = matches->value(row, "times_better"), low = matches->value(row, "low"),
                     high = matches->value(row, "high");
        const bool better = ratio >= 1, is_noise = low < 1 && high > 1;
        const std::string range = std::isnan(low) ? ""
                                                  : fmt::format(" ({} to {})", number(better ? low : 1 / high),
                                                                number(better ? high : 1 / low));
        const std::string where =
            fmt::format("{}{}", number(matches->value(row, equal.c_str())), matches->unit(matches->equal));
        out += fmt::format("{} <em>{}</em> has ",
                           out.empty() ? fmt::format("At an equal {} of {},", words_for(matches->equal), where)
                                       : fmt::format(" At {},", where),
                           escaped(method));
        out += fmt::format("<strong>{} times {}</strong> {} than <em>{}</em>{}{}.", number(better ? ratio : 1 / ratio),
                           better ? "less" : "more", words_for(matches->compared), escaped(matches->text(row, "first")),
                           range, is_noise ? ", which may be noise" : "");
    }
    return out;
}

struct Figure {
    std::string title, text;
};

/// Returns the figure of a known chart name; else a figure with the name as its caption.
Figure figure_of(const std::string& stem) {
    static const std::map<std::string, Figure> known{
        {"error-cost",
         {"Error against cost",
          "A point is the mean over images that differ in their random numbers only; the band reaches from the best to "
          "the worst of them. Lower and further left is better. A method without bias falls along a line of slope −1, "
          "twice the time for half the squared error; a curve that flattens out has reached its bias. Rings mark the "
          "Pareto front: of all that was measured, nothing has both less cost and less error."}},
        {"stages",
         {"Where the time goes",
          "Time of each stage for one sample of every pixel, along the whole chain of files that an image was made "
          "from. It shows what a method costs besides tracing paths, and which stage takes the most time."}},
        {"bias-variance",
         {"Bias and variance apart",
          "The two parts of the mean squared error, separated by images that differ in their random numbers only. "
          "Variance (filled) falls with every sample; squared bias (open, dashed) does not, unless the method itself "
          "gets better with more of them. Where squared bias came out at or below zero, as noise makes it for a bias "
          "too small to measure, there is no point."}},
        {"convergence",
         {"Convergence of the refinement",
          "How much the radiance of all vertices changes from one step of the refinement to the next, as a share of "
          "the whole. A straight line on this axis is a constant factor per step. Once the change is far below the "
          "noise of the image, further steps are wasted time."}},
    };
    const auto at = known.find(stem);
    return at == known.end() ? Figure{stem, ""} : at->second;
}

std::string chart_figures(const Options& options, int next_figure) {
    std::string out;
    for (std::size_t k = 0; k < options.charts.size(); ++k) {
        const Figure figure = figure_of(fs::path(options.charts[k]).stem());
        out +=
            chart_figure(options.charts[k], fmt::format("chart{}", k), next_figure + int(k), figure.title, figure.text);
    }
    return out;
}

/// Formats any table unchanged, with readable numbers.
std::string plain_table(const Table& t) {
    Cells head;
    for (const std::string& name : t.names) head.push_back(escaped(name));
    std::vector<Cells> rows;
    for (const auto& cells : t.rows) {
        Cells row;
        for (const std::string& cell : cells) {
            const auto value = app::parse_number<double>(cell);
            const bool is_whole = app::parse_number<std::int64_t>(cell).has_value();
            row.push_back(value && !is_whole ? number(*value) : escaped(cell));
        }
        rows.push_back(std::move(row));
    }
    return table(head, rows);
}

std::string lineage_section(const Picture& picture, bool is_reference) {
    return lineage_details(is_reference ? "Reference" : escaped(picture.name()), picture.lineage, !is_reference);
}

/// Returns the JSON that the page's script reads.
std::string data_of(const std::vector<const Picture*>& pictures) {
    JsonWriter json;
    json.begin_object();
    json.begin_array("pictures");
    for (const Picture* picture : pictures) {
        json.begin_object();
        json.text("name", picture->name());
        json.integer("width", picture->pixels.width);
        json.integer("height", picture->pixels.height);
        json.text("halves", picture->pixels.data);
        json.end_object();
    }
    json.end_array();
    json.end_object();
    return embedded_json(json.str());
}

std::string figure_for(std::size_t index, const Picture& picture, bool is_reference) {
    const std::string caption =
        is_reference
            ? fmt::format("<b>Reference</b>{}", picture.samples == 0 ? "" : fmt::format(" {} spp", picture.samples))
            : fmt::format(
                  "<b>{}</b> {}{}{}", escaped(picture.label),
                  picture.samples == 0 ? "" : fmt::format("{} spp", picture.samples),
                  std::isnan(picture.relmse) ? "" : fmt::format("<br>relMSE {}", number(picture.relmse)),
                  std::isnan(picture.cpu_s()) ? "" : fmt::format("<br>{}\u202fs of CPU time", number(picture.cpu_s())));
    return fmt::format("<div class=\"cell\"><canvas data-picture=\"{}\"></canvas>{}<p>{}</p></div>\n", index,
                       is_reference
                           ? "<div class=\"legend\"><canvas id=\"legend\"></canvas><p><span data-reach=\"-1\"></span>"
                             "<span>0</span><span data-reach=\"1\"></span></p><p class=\"hint\">too dark · right · too "
                             "bright</p></div>"
                           : fmt::format("<canvas data-picture=\"{}\" data-error></canvas>", index),
                       caption);
}

std::string subsection(const std::string& title, const std::string& text, const std::string& body) {
    return fmt::format("<h3>{}</h3>\n<p>{}</p>\n{}", title, text, body);
}

/// Reads the images of the page, all of the reference's size, with their lineage.
std::vector<Picture> read_pictures(const Options& options, const Picture& reference) {
    std::vector<Picture> pictures;
    for (const std::string& text : options.pictures) {
        const auto [label, file] = app::split_label(text);
        pictures.push_back(read_picture(label.empty() ? app::base_name(file) : label, file, options));
        const Picture& picture = pictures.back();
        if (picture.width != reference.width || picture.height != reference.height) {
            throw InputError(fmt::format("{}: is {} x {}, but {} is {} x {}", file, picture.width, picture.height,
                                         options.reference, reference.width, reference.height));
        }
        pictures.back().lineage = lineage_of(file);
    }
    return pictures;
}

/// Sets the relMSE of each image from the table of errors.
void set_errors(const Table& errors, std::vector<Picture>& pictures) {
    for (const Group& group : groups_of(errors))
        for (Picture& picture : pictures)
            if (picture.label == group.method && std::to_string(picture.samples) == group.samples)
                picture.relmse = estimate(errors, group, "relmse").mean;
}

std::string tables_of_errors(const Table& errors) {
    std::string tables;
    tables +=
        subsection("Errors",
                   "Means over n images that differ in their random numbers only, with the standard error of that "
                   "mean. relMSE is the mean of (x − r)² / (r² + 0.01). <i>Trimmed</i> leaves out the 0.1 % worst "
                   "pixels, which may dominate the mean. PSNR and SSIM compare what a display shows.",
                   error_table(errors));
    tables += subsection(
        "Bias, variance and grain",
        "The relMSE in three parts: squared bias, variance, and the noise of the reference itself. Squared bias is "
        "an estimate and falls below zero where there is none to measure. Then the correlation of the error with "
        "that of the pixel to the right and of pixels 2 to 8 away: 0 for grain, towards 1 for blotches. The p "
        "values test whether the means of the image, and of its 8 × 8 tiles, differ from the reference by more "
        "than noise; without bias, a value below p has probability p.",
        parts_table(errors));
    tables += subsection("Costs",
                         "Cost of the whole chain of files that an image was made from, each file once. Render time is "
                         "CPU time without reading the scene, which would dominate for small images of large scenes.",
                         cost_table(errors));
    return tables;
}

std::string tables_of_matches(const std::optional<Matches>& equal_cost, const std::optional<Matches>& equal_error,
                              const Options& options) {
    std::string tables;
    if (equal_cost) {
        tables += subsection("At equal " + escaped(words_for(equal_cost->equal)),
                             "Error of each method at the same cost as the other, between measured points along a "
                             "straight line in the logarithms, never beyond their ends.",
                             match_table(*equal_cost));
    }
    if (equal_error) {
        tables += subsection("At equal " + escaped(words_for(equal_error->equal)),
                             "Cost of each method at the same error as the other.", match_table(*equal_error));
    }
    if (!options.peers.empty()) {
        tables += subsection("Beside other renderers",
                             "The same scene file with the same depth, roulette and threads, timed in turn; paths per "
                             "second without loading and compiling. Equal paths are not equal errors.",
                             plain_table(read_tables({options.peers})));
    }
    return tables;
}

}  // namespace

std::string page_of(const Options& options) {
    Picture reference = read_picture("Reference", options.reference, options);
    std::vector<Picture> pictures = read_pictures(options, reference);
    if (fs::exists(cost_path(options.reference))) reference.lineage = lineage_of(options.reference);
    const auto equal_cost = read_matches(options.equal_cost), equal_error = read_matches(options.equal_error);
    std::string tables;
    if (!options.errors.empty()) {
        const Table errors = read_tables({options.errors});
        set_errors(errors, pictures);
        tables += tables_of_errors(errors);
    }
    tables += tables_of_matches(equal_cost, equal_error, options);

    std::vector<const Picture*> shown;
    std::string cells, lineage;
    std::size_t factor = reference.pixels.factor;
    std::uint64_t n_clipped = reference.pixels.n_clipped;
    for (std::size_t k = 0; k < pictures.size(); ++k) {
        shown.push_back(&pictures[k]);
        cells += figure_for(k, pictures[k], false);
        lineage += lineage_section(pictures[k], false);
        n_clipped += pictures[k].pixels.n_clipped;
    }
    shown.push_back(&reference);
    cells += figure_for(pictures.size(), reference, true);
    lineage += lineage_section(reference, true);

    std::string facts = fmt::format("{} × {} pixels", reference.width, reference.height);
    std::string reduced;
    if (factor > 1) {
        reduced = fmt::format(
            " The images are shown reduced {0} times, each pixel being the mean of {0} × {0}; the tables are of the "
            "full size.",
            factor);
    }
    if (n_clipped > 0) reduced += fmt::format(" {} values above 65504 are shown as 65504.", n_clipped);
    const std::string lead = headline(equal_cost);
    return filled(
        page_html,
        {{"title", escaped(options.title.empty() ? "Images and their errors" : options.title)},
         {"css", page_css},
         {"pixels", pixels_js},
         {"js", page_js},
         {"lead", lead.empty() ? "" : fmt::format("<p class=\"lead\">{}</p>", lead)},
         {"facts", facts},
         {"reduced", reduced},
         {"cells", cells},
         {"columns", std::to_string(shown.size())},
         {"charts", section("charts", "Speed against accuracy", chart_figures(options, 3))},
         {"tables", section("tables", "Tables", tables)},
         {"lineage", section("lineage", "Plan and lineage",
                             "<p>Each file was made by one stage from the files named beside it. A row stands for all "
                             "files of a kind; <i>plan</i> says what the stage switched on for the scene.</p>\n" +
                                 lineage)},
         {"made_by", options.made_by.empty()
                         ? ""
                         : fmt::format("<p>This page again: <code>{}</code></p>", escaped(options.made_by))},
         {"release", escaped(fmt::format("Pathloom {}", build_release()))},
         {"data", data_of(shown)}});
}

void declare(app::Command& command, Options& options) {
    command.labelled_files("images", options.pictures, "images (EXR) with their .cost.json, one per method");
    command.file("-r,--reference", options.reference, "reference image (EXR)");
    command.file("--tour", options.tour,
                 "table of figures for a page without a reference: section, text, figure, caption, output, command");
    command.output("-o,--output", options.output, "output page (.html)").required();
    command.file("--errors", options.errors, "table of loom-compare --reference R --cost --tsv");
    command.file("--equal-cost", options.equal_cost,
                 "table of loom-chart at equal cost (.equal-cost.tsv), even one with a header line only");
    command.file("--equal-error", options.equal_error, "table of loom-chart at equal error (.equal-error.tsv)");
    command.files("--chart", options.charts, "charts (SVG) of loom-chart, in their order on the page");
    command.files("--animation", options.animation,
                  "frames of an animation in their order, for a page without a reference");
    command.file("--by-frame", options.by_frame, "table of loom-compare --by-frame of these frames");
    command.option("--movie", options.movie, "movie of them, which the page links to");
    command.option("--fps", options.fps, "frames that the page plays per second", app::Range<double>{0.1, 1000});
    command.file("--peers", options.peers, "table of make peers");
    command.option("--title", options.title, "title of the page, for example the scene");
    command.option("--made-by", options.made_by, "command that makes the page, shown at its end");
    command.option("--longest-side", options.longest_side,
                   "longest side of an image on the page; larger ones are reduced", app::Range<int>{16, 4096, "px"});
    command.example(
        "loom-report pt=a.exr pathgraph=b.exr -r r.exr --errors errors.tsv --chart error-cost.svg -o "
        "report.html");
}

void run(const Options& options, app::Report& report) {
    if (fs::path(options.output).extension() != ".html")
        throw InputError(fmt::format("{}: the output must end in .html", options.output));
    if (!options.tour.empty() + !options.animation.empty() + !options.pictures.empty() > 1)
        throw InputError("images, --tour, --animation: a page shows one of them");
    if (options.tour.empty() && options.animation.empty() && (options.pictures.empty() || options.reference.empty()))
        throw InputError("images and --reference: missing; only a page of a --tour or an --animation needs none");
    if (options.animation.empty() && !(options.by_frame.empty() && options.movie.empty()))
        throw InputError("--by-frame, --movie: need --animation");
    check_output_path(options.output);
    if (!options.tour.empty()) {
        const std::string page = tour_page(options.tour, options.title);
        write_text_file(options.output, page);
        report.done("{}: {}", options.output, app::bytes_text(page.size()));
        return;
    }
    if (!options.animation.empty()) {
        const std::string page = animation_page(options);
        write_text_file(options.output, page);
        report.done("{}: {} frames, {}", options.output, options.animation.size(), app::bytes_text(page.size()));
        return;
    }
    const std::string page = page_of(options);
    write_text_file(options.output, page);
    report.done("{}: {} images, {}", options.output, options.pictures.size(), app::bytes_text(page.size()));
}

}  // namespace loom::report
