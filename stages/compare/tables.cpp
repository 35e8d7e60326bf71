#include <fmt/format.h>

#include <cmath>

#include "formats/io/json.h"
#include "stages/compare/compare.h"
#include "stages/core/app/report.h"
#include "stages/core/app/values.h"

namespace loom::compare {
namespace {

/// Formats "0.0123 ±0.0004"; the error only where it is known.
std::string with_error(const Estimate& e) {
    return std::isnan(e.se) ? fmt::format("{:.4g}", e.mean) : fmt::format("{:.4g} ±{:.1g}", e.mean, e.se);
}

/// Aligns the first column left, the others right; the first row is the header.
std::string aligned(const std::vector<std::vector<std::string>>& rows) {
    // Width in characters, not in bytes: "±" has two bytes.
    const auto length = [](const std::string& s) {
        std::size_t n = 0;
        for (char c : s) n += (c & 0xc0) != 0x80;
        return n;
    };
    std::vector<std::size_t> widths(rows[0].size());
    for (const auto& row : rows)
        for (std::size_t k = 0; k < row.size(); ++k) widths[k] = std::max(widths[k], length(row[k]));
    std::string text;
    for (const auto& row : rows) {
        for (std::size_t k = 0; k < row.size(); ++k) {
            const std::string space(widths[k] - length(row[k]), ' ');
            text += k == 0 ? row[k] + space : fmt::format("  {}{}", space, row[k]);
        }
        text.erase(text.find_last_not_of(' ') + 1);
        text += '\n';
    }
    return text;
}

std::string p_text(double p) {
    return std::isnan(p) ? "-" : p < 1e-4 ? fmt::format("{:.0e}", p) : fmt::format("{:.4f}", p);
}

std::string samples_text(std::uint64_t samples) {
    return samples == 0 ? "-" : fmt::format("{}", samples);
}

std::string gain_line(const Comparison& comparison, const Group& group) {
    const Group& first = comparison.groups[0];
    const Gain gain = gain_of(first, group);
    const auto name = [](const Group& g) {
        return g.samples() == 0 ? g.method() : fmt::format("{} at {} spp", g.method(), g.samples());
    };
    const auto [ratio, low, high] = gain.error;
    const bool better = !(ratio < 1);
    std::string line = fmt::format("{} is {:.3g} times {} than {}", name(group), better ? ratio : 1 / ratio,
                                   better ? "better" : "worse", name(first));
    if (!std::isnan(low))
        line += fmt::format(" ({:.3g} to {:.3g}, 95 %)", better ? low : 1 / high, better ? high : 1 / low);
    if (!std::isnan(gain.equal_cpu)) {
        line += fmt::format("; {:.3g} times {} at equal CPU time, if relMSE falls as 1/time",
                            gain.equal_cpu < 1 ? 1 / gain.equal_cpu : gain.equal_cpu,
                            gain.equal_cpu < 1 ? "worse" : "better");
    }
    return line + "\n";
}

/// Returns the rows of the tests of cubes' bins.
std::vector<std::vector<std::string>> pool_rows(const Comparison& comparison) {
    std::vector<std::vector<std::string>> rows{
        {"method", "spp", "tests", "n", "mean z", "rms z", "worst z", "bin", "pixel", "channel", "p"}};
    for (const Group& group : comparison.groups) {
        const Measured& m = group.replicates[0];
        for (const PoolTests& tests : group.pools)
            rows.push_back({group.method(), samples_text(group.samples()), tests.name, fmt::format("{}", tests.n),
                            fmt::format("{:.3f}", tests.mean_z), fmt::format("{:.3f}", tests.rms_z),
                            fmt::format("{:.2f}", tests.worst_z), fmt::format("{}", tests.worst_bin),
                            fmt::format("{}:{}", tests.worst_x, tests.worst_y),
                            std::string(1, "RGB"[tests.worst_channel]), p_text(tests.p)});
        rows.push_back({group.method(), samples_text(group.samples()), "sums of pixels",
                        fmt::format("{}", 3 * comparison.width * comparison.height), "", "", "", "", "", "",
                        p_text(m.p_pixels)});
    }
    return rows;
}

/// Writes the members of a JSON object, by column.
void members(JsonWriter& json, const Measured& m, bool of_group) {
    for (const Column& column : columns())
        if (column.of_group == of_group) json.number(column.name, m.*column.value);
}

std::string peak_text(double bytes) {
    return std::isnan(bytes) ? "-" : app::bytes_text(std::uint64_t(bytes));
}

}  // namespace

std::string text_of(const Comparison& comparison) {
    std::vector<std::vector<std::string>> errors{
        {"method", "spp", "n", "relMSE", "trimmed", "MSE", "MAPE %", "PSNR dB", "SSIM"}};
    std::vector<std::vector<std::string>> parts{{"method", "spp", "bias^2", "variance", "reference", "corr right",
                                                 "down", "2-8 px", "test", "p image", "p tiles"}};
    std::vector<std::vector<std::string>> costs{{"method", "spp", "CPU s", "wall s", "rays", "peak memory"}};
    bool has_cost = false;
    for (const Group& group : comparison.groups) {
        const auto mean = [&](double Measured::*value) { return group.estimate(value).mean; };
        const std::string spp = samples_text(group.samples());
        errors.push_back(
            {group.method(), spp, fmt::format("{}", group.replicates.size()),
             with_error(group.estimate(&Measured::relmse)), with_error(group.estimate(&Measured::relmse_trimmed)),
             with_error(group.estimate(&Measured::mse)), fmt::format("{:.2f}", 100 * mean(&Measured::mape)),
             fmt::format("{:.2f}", mean(&Measured::psnr)), fmt::format("{:.4f}", mean(&Measured::ssim))});
        const auto number = [&](double Measured::*value) {
            const double x = mean(value);
            return std::isnan(x) ? std::string("-") : fmt::format("{:.3g}", x);
        };
        parts.push_back({group.method(), spp, number(&Measured::bias2), number(&Measured::variance),
                         number(&Measured::reference_noise), number(&Measured::corr_right),
                         number(&Measured::corr_down), number(&Measured::corr_near), group.significance.kind,
                         p_text(mean(&Measured::p_image)), p_text(mean(&Measured::p_tiles))});
        has_cost = has_cost || !std::isnan(mean(&Measured::cpu_s));
        costs.push_back({group.method(), spp, with_error(group.estimate(&Measured::cpu_s)),
                         with_error(group.estimate(&Measured::wall_s)), fmt::format("{:.4g}", mean(&Measured::rays)),
                         peak_text(mean(&Measured::peak_memory_bytes))});
    }
    std::string text =
        fmt::format("reference {}, {} x {}{}\n\n", comparison.reference, comparison.width, comparison.height,
                    comparison.n_bins > 0 ? fmt::format(", {} bins", comparison.n_bins) : "");
    text += fmt::format("{}\n{}", aligned(errors), aligned(parts));
    if (comparison.n_bins > 0) text += fmt::format("\n{}", aligned(pool_rows(comparison)));
    if (has_cost) text += fmt::format("\n{}", aligned(costs));
    if (comparison.groups.size() > 1) text += "\n";
    for (std::size_t k = 1; k < comparison.groups.size(); ++k) text += gain_line(comparison, comparison.groups[k]);
    return text;
}

std::string json_of(const Comparison& comparison) {
    JsonWriter json;
    json.begin_object();
    json.text("scene", comparison.scene);
    json.text("reference", comparison.reference);
    json.integer("width", comparison.width);
    json.integer("height", comparison.height);
    if (comparison.n_bins > 0) json.integer("n_bins", comparison.n_bins);
    json.begin_array("methods");
    for (const Group& group : comparison.groups) {
        json.begin_object();
        json.text("method", group.method());
        json.integer("samples", group.samples());
        members(json, group.replicates[0], true);
        json.text("test", group.significance.kind);
        json.integer("worst_tile", group.significance.worst_tile);
        for (const auto& [name, values] :
             {std::pair{"difference", &RegionTest::difference}, std::pair{"difference_se", &RegionTest::se},
              std::pair{"p_value", &RegionTest::p_value}}) {
            json.begin_object(name);
            for (std::size_t c = 0; c < 3; ++c) {
                // The image first, then its tiles row by row.
                json.begin_array(std::string(1, "RGB"[c]));
                for (const RegionTest& test : group.significance.tests[c]) json.number({}, test.*values);
                json.end_array();
            }
            json.end_object();
        }
        if (comparison.n_bins > 0) {
            json.begin_array("pools");
            for (const PoolTests& tests : group.pools) {
                json.begin_object();
                json.text("tests", tests.name);
                json.integer("n", tests.n);
                json.number("mean_z", tests.mean_z);
                json.number("rms_z", tests.rms_z);
                json.number("worst_z", tests.worst_z);
                json.integer("worst_bin", tests.worst_bin);
                json.integer("worst_x", tests.worst_x);
                json.integer("worst_y", tests.worst_y);
                json.integer("worst_channel", tests.worst_channel);
                json.number("p", tests.p);
                json.end_object();
            }
            json.end_array();
        }
        const Gain gain = gain_of(comparison.groups[0], group);
        json.begin_object("times_better_than_first");
        json.number("relmse", gain.error.value);
        json.number("low", gain.error.low);
        json.number("high", gain.error.high);
        json.number("equal_cpu", gain.equal_cpu);
        json.end_object();
        json.begin_array("replicates");
        for (const Measured& m : group.replicates) {
            json.begin_object();
            json.text("file", m.file);
            members(json, m, false);
            json.end_object();
        }
        json.end_array();
        json.end_object();
    }
    json.end_array();
    json.end_object();
    return json.str();
}

std::string tsv_of(const Comparison& comparison) {
    std::string text = "scene\tmethod\tsamples\treplicate\tfile";
    for (const Column& column : columns()) text += fmt::format("\t{}", column.name);
    text += "\n";
    for (const Group& group : comparison.groups) {
        for (const Measured& m : group.replicates) {
            text += fmt::format("{}\t{}\t{}\t{}\t{}", comparison.scene, m.method, m.samples, m.replicate, m.file);
            for (const Column& column : columns()) text += fmt::format("\t{}", m.*column.value);
            text += "\n";
        }
    }
    return text;
}

std::string text_of(std::span<const InputCost> costs) {
    std::string text;
    for (const InputCost& input : costs) {
        std::vector<std::vector<std::string>> rows{
            {"stage", "files", "wall s", "CPU s", "rays", "samples", "peak memory", "written"}};
        const auto add = [&](const StageCost& s) {
            rows.push_back({s.cost.stage, fmt::format("{}", s.n_files), fmt::format("{:.3f}", s.cost.wall_s),
                            fmt::format("{:.3f}", s.cost.cpu_s), fmt::format("{}", s.cost.rays),
                            fmt::format("{}", s.cost.samples), app::bytes_text(s.cost.peak_memory_bytes),
                            app::bytes_text(s.cost.bytes_written)});
        };
        for (const StageCost& stage : input.stages) add(stage);
        add(total_of(input.stages));
        text += fmt::format("{}{}\n{}", text.empty() ? "" : "\n",
                            input.method == input.file ? input.file : input.method + ", " + input.file, aligned(rows));
    }
    return text;
}

std::string json_of(std::span<const InputCost> costs) {
    JsonWriter json;
    json.begin_array();
    for (const InputCost& input : costs) {
        json.begin_object();
        json.text("scene", input.scene);
        json.text("method", input.method);
        json.integer("samples", input.samples);
        json.integer("replicate", input.replicate);
        json.text("file", input.file);
        json.begin_array("stages");
        std::vector<StageCost> stages = input.stages;
        stages.push_back(total_of(input.stages));
        for (const StageCost& s : stages) {
            json.begin_object();
            json.text("stage", s.cost.stage);
            json.integer("files", s.n_files);
            json.number("wall_s", s.cost.wall_s);
            json.number("cpu_s", s.cost.cpu_s);
            json.integer("rays", s.cost.rays);
            json.integer("work", s.cost.samples);
            json.integer("peak_memory_bytes", s.cost.peak_memory_bytes);
            json.integer("bytes_written", s.cost.bytes_written);
            json.end_object();
        }
        json.end_array();
        json.end_object();
    }
    json.end_array();
    return json.str();
}

std::string tsv_of(std::span<const InputCost> costs) {
    std::string text =
        "scene\tmethod\tsamples\treplicate\tfile\tstage\tfiles\twall_s\tcpu_s\trays\twork\tpeak_memory_bytes\tbytes_"
        "written\trender_s\n";
    for (const InputCost& input : costs) {
        for (const StageCost& s : input.stages) {
            text += fmt::format("{}\t{}\t{}\t{}\t{}\t{}\t{}\t{}\t{}\t{}\t{}\t{}\t{}\t{}\n", input.scene, input.method,
                                input.samples, input.replicate, input.file, s.cost.stage, s.n_files, s.cost.wall_s,
                                s.cost.cpu_s, s.cost.rays, s.cost.samples, s.cost.peak_memory_bytes,
                                s.cost.bytes_written, s.cost.cpu_s - s.cost.load_s);
        }
    }
    return text;
}

}  // namespace loom::compare
