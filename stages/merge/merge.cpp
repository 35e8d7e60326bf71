#include "stages/merge/merge.h"

#include <fmt/format.h>

#include <algorithm>
#include <filesystem>
#include <numeric>

#include "formats/io/cost.h"
#include "formats/io/error.h"
#include "stages/core/app/command.h"
#include "stages/merge/blend.h"
#include "stages/merge/two_level.h"

namespace loom::merge {
namespace {

/// Share of the pixels above which a refused blend is a warning.
constexpr double distrust_to_warn = 0.01;

constexpr std::string_view variance_layer = "VarMean.";

void check_fit(const Image& first, const Image& part, const std::string& first_name, const std::string& name) {
    if (part.samples == 0)
        throw InputError(
            fmt::format("{}: has no number of samples per pixel (attribute samples), which weighs the parts", name));
    if (part.ledger.size() > 1)
        throw InputError(fmt::format(
            "{}: is an image plus {}, whose samples have different weights; merge passes of the residual instead", name,
            part.ledger.size() == 2 ? "an edit" : fmt::format("{} edits", part.ledger.size() - 1)));
    if (part.width != first.width || part.height != first.height) {
        throw InputError(fmt::format("{}: is {} x {}, but {} is {} x {}", name, part.width, part.height, first_name,
                                     first.width, first.height));
    }
    for (const auto& channel : first.channels) {
        if (part.find(channel.name).empty()) {
            throw InputError(fmt::format("{}: has no channel {}, but {} has", name, channel.name, first_name));
        }
    }
    if (part.channels.size() != first.channels.size()) {
        throw InputError(fmt::format("{}: has {} channels, but {} has {}", name, part.channels.size(), first_name,
                                     first.channels.size()));
    }
}

/// Attributes of a part beside its pixels.
struct Labels {
    InputId scene;  // scene of the image; of a difference, the new scene
    Ledger ledger;  // of a residual, its only link
    std::uint64_t samples;
};

/// Returns the common scene of all parts; none where they differ.
InputId common_scene(std::span<const Labels> parts) {
    const bool agree = std::all_of(parts.begin(), parts.end(),
                                   [&](const Labels& part) { return part.scene.hash == parts[0].scene.hash; });
    return agree ? parts[0].scene : InputId();
}

/// Returns one link for the passes of one residual; none where the parts are no such passes.
Ledger link_of_passes(std::span<const Labels> parts, const Image& merged) {
    const auto is_pass = [&](const Labels& part) {
        return part.ledger.size() == 1 && part.ledger[0].scene.hash == parts[0].ledger[0].scene.hash &&
               part.ledger[0].method == parts[0].ledger[0].method;
    };
    if (parts[0].ledger.size() != 1 || !std::all_of(parts.begin(), parts.end(), is_pass)) return {};
    LedgerLink link = parts[0].ledger[0];
    link.samples = merged.samples;
    link.var_mean = mean_var_mean(merged);
    link.var_sample = 0;
    for (const Labels& part : parts)
        link.var_sample += part.ledger[0].var_sample * double(part.samples) / double(merged.samples);
    return {link};
}

/// Returns one channel of all parts.
std::vector<PartOf> parts_of(std::span<const Image> images, std::string_view mean_channel,
                             std::string_view variance_channel = {}) {
    std::vector<PartOf> parts;
    for (const Image& image : images)
        parts.push_back({image.samples, image.find(mean_channel),
                         variance_channel.empty() ? std::span<const float>() : image.find(variance_channel)});
    return parts;
}

}  // namespace

std::vector<double> pooled_mean(std::span<const PartOf> parts) {
    std::vector<double> mean(parts[0].mean.size());
    double n_all = 0;
    for (const PartOf& part : parts) {
        const auto n = static_cast<double>(part.samples);
        n_all += n;
        for (std::size_t i = 0; i < mean.size(); ++i) mean[i] += n * static_cast<double>(part.mean[i]);
    }
    for (double& value : mean) value /= n_all;
    return mean;
}

std::vector<double> pooled_var_mean(std::span<const PartOf> parts) {
    const std::vector<double> mean = pooled_mean(parts);
    std::vector<double> squares(mean.size());
    double n_all = 0;
    for (const PartOf& part : parts) {
        const auto n = static_cast<double>(part.samples);
        n_all += n;
        for (std::size_t i = 0; i < mean.size(); ++i) {
            const double shift = static_cast<double>(part.mean[i]) - mean[i];
            // A single sample has no variance estimate, even if its file has one.
            const double inside = part.samples == 1 ? 0.0 : (n - 1) * n * static_cast<double>(part.var_mean[i]);
            squares[i] += inside + n * shift * shift;
        }
    }
    for (double& value : squares) value /= n_all > 1 ? (n_all - 1) * n_all : 1.0;
    return squares;
}

Image merge_images(std::span<const Image> parts, std::span<const std::string> names) {
    Image merged;
    for (std::size_t k = 0; k < parts.size(); ++k) {
        check_fit(parts[0], parts[k], names[0], names[k]);
        merged.samples += parts[k].samples;
    }
    merged.width = parts[0].width;
    merged.height = parts[0].height;
    for (const auto& channel : parts[0].channels) {
        const std::string_view name = channel.name;
        std::vector<double> values;
        if (name.starts_with(variance_layer)) {
            const std::string_view mean_channel = name.substr(variance_layer.size());
            if (parts[0].find(mean_channel).empty()) {
                throw InputError(fmt::format("{}: has {} but no {}", names[0], name, mean_channel));
            }
            values = pooled_var_mean(parts_of(parts, mean_channel, name));
        } else {
            values = pooled_mean(parts_of(parts, name));
        }
        merged.channels.push_back({channel.name, std::vector<float>(values.begin(), values.end())});
    }
    return merged;
}

Image difference_of(const Image& after, const Image& before, const std::string& after_name,
                    const std::string& before_name) {
    check_fit(after, before, after_name, before_name);
    if (after.samples != before.samples)
        throw InputError(fmt::format("{}: has {} samples per pixel, but {} has {}", before_name, before.samples,
                                     after_name, after.samples));
    Image difference = after;
    difference.scene = {};
    std::erase_if(difference.channels,
                  [](const Image::Channel& channel) { return channel.name.starts_with(variance_layer); });
    for (Image::Channel& channel : difference.channels) {
        const bool of_surfaces =
            channel.name.starts_with("Albedo.") || channel.name.starts_with("N.") || channel.name.starts_with("Depth.");
        if (of_surfaces) continue;
        const auto subtracted = before.find(channel.name);
        for (std::size_t i = 0; i < subtracted.size(); ++i) channel.values[i] -= subtracted[i];
    }
    return difference;
}

void declare(app::Command& command, Options& options) {
    command
        .files("parts", options.parts,
               "images (EXR with attribute samples) of one size, or transient cubes (.h5) of one window, in the order "
               "of the sum")
        .required();
    command.files("--minus", options.minus,
                  "for each part, the image of the old scene with the same random numbers; merges the differences, "
                  "VarMean from the spread between them");
    command.option("--quotient", options.quotient,
                   "NAME=LOW:HIGH: write the difference quotient of cubes by this parameter, from the parts, traced at "
                   "HIGH, and --minus, traced at LOW with the same random numbers");
    command.output("-o,--output", options.output, "merged image or cube");
    command.flag("--zip", options.zip, "compress the output image");
    command.file(
        "--direct", options.direct,
        "image (.exr) of emission and direct light from further samples (loom-trace --max-depth 2), for the blend");
    command.flag("--no-blend", options.no_blend,
                 "do not blend the shared estimates of path graphs with those of their own paths");
    command.option(
        "--unbiased", options.unbiased,
        "correct the mean of all parts by the own paths of the first N parts, which removes the bias; 0: off",
        app::Range<std::uint64_t>{0, 1u << 20});
    command.flag("--plan-direct", options.plan_direct,
                 "print the number of direct-light samples per pixel that pays off in the blend, and stop");
    command.example("loom-merge pass-0.exr pass-1.exr -o image.exr");
}

namespace {

/// Returns the cost of a direct-light sample over that of a path graph sample, from fixed figures and counts of rays.
/// Measured times would change the output's bytes. A ray of a path that is traced, clustered, refined and gathered
/// costs about five times a ray of a direct-light image, whose sample takes three (camera, light, BSDF). Measured: 7
/// times in cornell-box, 5 in dining-room and staircase, 4 in sponza.
double cost_of_direct(const std::string& part) {
    constexpr double rays_of_direct = 3, graph_over_picture = 5;
    // The rays of a part are those of its graph, whose cost file remains even where the graph is deleted.
    std::filesystem::path file = part;
    for (Cost cost = read_cost(file);; cost = read_cost(file)) {
        if (cost.stage == "loom-trace")
            return rays_of_direct / (graph_over_picture * double(cost.rays) / double(cost.samples));
        if (cost.parents.empty()) throw InputError(fmt::format("{}: has no path graph among its parents", part));
        file = file.parent_path() / cost.parents[0];
    }
}

void say_direct(const Options& options, app::Report& report) {
    if (options.parts.size() < min_blend_parts)
        throw InputError(
            fmt::format("--plan-direct: only a blend uses direct light; give {} or more parts", min_blend_parts));
    const double cost = cost_of_direct(options.parts[0]);
    const DirectPlan plan = plan_direct(
        options.parts.size(),
        [&](std::size_t i) {
            Image image = read_image(options.parts[i]);
            if (!has_estimates(image))
                throw InputError(fmt::format("{}: has no estimates (loom-gather --estimates)", options.parts[i]));
            return image;
        },
        cost);
    report.info(
        "plan: {} samples of direct light; its error falls from {:.3g} to {:.3g} (all other light: {:.3g}), each at "
        "{:.3f} of the cost of a path",
        plan.samples, plan.direct, plan.direct_with, plan.indirect, cost);
    report.answer(fmt::format("{}\n", plan.samples));
}

/// Merges the images of one run.
class ImageMerger {
  public:
    ImageMerger(const Options& options, app::Report& report)
        : options_(options),
          report_(report),
          differences_(!options.minus.empty()),
          two_levels_(options.unbiased > 0),
          labels_(options.parts.size()) {}

    void run() {
        if (differences_ && options_.minus.size() != options_.parts.size())
            throw InputError(
                fmt::format("--minus: {} images for {} parts", options_.minus.size(), options_.parts.size()));
        // Read the first part, which decides how the parts are merged.
        std::vector<InputId> inputs = identify_parts(options_.parts);
        if (differences_)
            for (InputId& id : identify_parts(options_.minus)) inputs.push_back(std::move(id));
        first_ = read_part(0);
        estimates_ = has_estimates(first_);
        blend_ = estimates_ && !options_.no_blend && !two_levels_ && options_.parts.size() >= min_blend_parts;
        if (two_levels_) check_unbiased();
        if (!options_.direct.empty()) {
            read_direct();
            inputs.push_back(identify(options_.direct));
        }

        // Merge.
        Image merged = merge();
        report_distrust(merged);
        const std::string how = plan();
        if (!how.empty()) report_.info("plan: {}", how);
        merged.provenance = report_.provenance(first_.provenance.seed, std::move(inputs),
                                               (how.empty() ? first_.provenance.plan : how) +
                                                   (differences_ ? "; differences of pairs, new minus old" : ""));
        set_origin(merged);

        // Write.
        write_image(merged, options_.output, options_.zip ? Compression::zip : Compression::none);
        std::vector<std::string> parents = options_.parts;
        parents.insert(parents.end(), options_.minus.begin(), options_.minus.end());
        parents.push_back(options_.direct);
        write_cost_of(options_.output, report_.cost(merged.provenance.plan), parents);
        report_.done("{}: {} parts, {} samples per pixel", options_.output, options_.parts.size(), merged.samples);
    }

  private:
    /// Returns part i; with --minus its difference from the image before the edit.
    Image read_part(std::size_t i) {
        const std::string& file = options_.parts[i];
        Image image = read_image(file);
        labels_[i] = {image.scene, image.ledger, image.samples};
        if (!differences_) return image;
        const Image before = read_image(options_.minus[i]);
        if (image.provenance.seed != before.provenance.seed)
            throw InputError(
                fmt::format("{}: was made with seed {}, but {} with {}; trace both with the same --seed, so that their "
                            "noise cancels",
                            options_.minus[i], before.provenance.seed, file, image.provenance.seed));
        return difference_of(image, before, file, options_.minus[i]);
    }

    void check_unbiased() const {
        if (!estimates_)
            throw InputError(
                fmt::format("--unbiased: {} has no estimates of its own paths; make it with loom-gather --estimates",
                            options_.parts[0]));
        check_two_levels(options_.unbiased, options_.parts.size());
    }

    void read_direct() {
        const std::string& file = options_.direct;
        if (!blend_ || differences_)
            throw InputError(
                fmt::format("{}: only a blend uses --direct; give {} or more parts made with loom-gather --estimates, "
                            "and no --minus",
                            file, min_blend_parts));
        direct_ = read_image(file);
        if (direct_.width != first_.width || direct_.height != first_.height)
            throw InputError(fmt::format("{}: is {} x {}, but {} is {} x {}", file, direct_.width, direct_.height,
                                         options_.parts[0], first_.width, first_.height));
        if (direct_.find("VarMean.R").empty() || direct_.samples < 2)
            throw InputError(fmt::format("{}: has no variance (VarMean, from two samples per pixel or more)", file));
    }

    Image merge() {
        const std::size_t n = options_.parts.size();
        if ((estimates_ || differences_) && n > 1) {
            const auto part = [&](std::size_t i) {
                Image image = read_part(i);
                check_fit(first_, image, options_.parts[0], options_.parts[i]);
                return image;
            };
            if (two_levels_) return two_level_image(n, options_.unbiased, part);
            if (blend_) return blend_images(n, part, options_.direct.empty() ? nullptr : &direct_, !differences_);
            return average_images(n, part);
        }
        std::vector<Image> parts;
        parts.push_back(first_);
        for (std::size_t i = 1; i < n; ++i) parts.push_back(read_part(i));
        if (differences_)
            report_.warn("{}: one difference has no spread, so the result has no VarMean; give two or more",
                         options_.output);
        return merge_images(parts, options_.parts);
    }

    void report_distrust(const Image& merged) {
        const auto distrust = merged.find("Blend.Distrust");
        if (distrust.empty()) return;
        const double share = std::accumulate(distrust.begin(), distrust.end(), 0.0) / double(distrust.size());
        const std::string text = fmt::format(
            "clusters look biased in {:.2f} % of the pixels (layer Blend.Distrust), which use the paths' own estimates "
            "alone",
            100 * share);
        if (share >= distrust_to_warn)
            report_.warn("{}", text);
        else
            report_.info("{}", text);
    }

    /// Returns the plan; empty where the parts have no estimates.
    std::string plan() const {
        if (two_levels_)
            return fmt::format("on: {} parts, corrected by the own paths of {}; off: blend", options_.parts.size(),
                               options_.unbiased);
        if (blend_)
            return fmt::format("on: blend with the paths' own estimates; off: {}",
                               options_.direct.empty() ? "further direct light (none given)" : "nothing");
        if (!estimates_) return "";
        if (options_.no_blend) return "off: blend with the paths' own estimates (--no-blend)";
        return fmt::format("off: blend with the paths' own estimates (fewer than {} parts)", min_blend_parts);
    }

    /// Sets scene and ledger of the merged image.
    void set_origin(Image& merged) const {
        const InputId scene = common_scene(labels_);
        if (!differences_) {
            merged.scene = !options_.direct.empty() && direct_.scene.hash != scene.hash ? InputId() : scene;
            merged.ledger = link_of_passes(labels_, merged);
        } else if (!merged.find("VarMean.R").empty()) {
            LedgerLink& link = merged.ledger.emplace_back();
            link.scene = scene;
            link.method = differences_method;
            link.samples = merged.samples;
            link.seed = merged.provenance.seed;
            link.var_mean = mean_var_mean(merged);
        }
    }

    const Options& options_;
    app::Report& report_;
    bool differences_, two_levels_, estimates_ = false, blend_ = false;
    std::vector<Labels> labels_;  // [part]
    Image first_, direct_;
};

}  // namespace

void run(const Options& options, app::Report& report) {
    if (options.plan_direct) {
        say_direct(options, report);
        return;
    }
    if (options.output.empty()) throw InputError("--output: missing (an .exr file, or .h5 for cubes)");
    if (options.parts.empty()) throw InputError("no input: give images (.exr) or transient cubes (.h5)");
    if (std::filesystem::path(options.parts[0]).extension() != ".h5") {
        if (!options.quotient.empty()) throw InputError("--quotient: is for transient cubes, not for images");
        ImageMerger(options, report).run();
        return;
    }
    if (options.zip || options.no_blend || !options.direct.empty() || options.unbiased > 0)
        throw InputError("--zip, --direct, --unbiased, --no-blend: are for images, not for cubes");
    if (options.minus.empty() != options.quotient.empty())
        throw InputError("--minus, --quotient: cubes need both or none");
    options.quotient.empty() ? run_cubes(options, report) : run_quotient(options, report);
}

}  // namespace loom::merge
