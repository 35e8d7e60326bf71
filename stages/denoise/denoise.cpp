#include "stages/denoise/denoise.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <filesystem>
#include <optional>
#include <utility>

#include "formats/io/error.h"
#include "stages/core/app/command.h"
#include "stages/denoise/filter.h"
#include "stages/denoise/oidn.h"

namespace loom::denoise {
namespace {

/// Replaces non-finite values by their neighbours (see prepare); by zeros where there are none.
/// out:     the replaced pixels
std::vector<std::size_t> mend(std::vector<float>& values, std::uint32_t width, std::uint32_t height) {
    std::vector<std::size_t> bad;
    for (std::size_t i = 0; i < values.size(); ++i)
        if (!std::isfinite(values[i])) bad.push_back(i);
    std::vector<float> mended(bad.size());
    const std::int64_t w = width, h = height;
    for (std::size_t k = 0; k < bad.size(); ++k) {
        const std::int64_t x = std::int64_t(bad[k]) % w, y = std::int64_t(bad[k]) / w;
        for (std::int64_t r = 1, n = 0; n == 0 && r < 2 * std::max(w, h); r *= 2) {
            double sum = 0;
            for (std::int64_t j = std::max<std::int64_t>(0, y - r); j <= std::min(h - 1, y + r); ++j) {
                for (std::int64_t i = std::max<std::int64_t>(0, x - r); i <= std::min(w - 1, x + r); ++i) {
                    const float value = values[std::size_t(j * w + i)];
                    if (std::isfinite(value)) sum += double(value), ++n;
                }
            }
            if (n > 0) mended[k] = float(sum / double(n));
        }
    }
    for (std::size_t k = 0; k < bad.size(); ++k) values[bad[k]] = mended[k];
    return bad;
}

/// Describes what runs and why, without paths, because the text becomes part of the output.
std::string plan_of(const Layers& layers, const std::optional<Oidn>& oidn, Method method, std::uint64_t samples) {
    std::string on, off;
    const auto say = [](std::string& list, const std::string& item) { list += (list.empty() ? "" : ", ") + item; };
    const bool albedo = !layers.albedo[0].empty(), normal = !layers.normal[0].empty();
    if (oidn) {
        say(on, fmt::format("Open Image Denoise {}", oidn->version()));
        say(off, "built-in filter");
    } else {
        say(on, "built-in filter");
        say(off, method == Method::filter ? "Open Image Denoise (not requested)" : "Open Image Denoise (not found)");
        if (layers.var_mean[0].empty()) {
            say(on, "variance from neighbours");
            say(off, samples == 1 ? "VarMean (one sample has none)" : "VarMean (not in the image)");
        } else {
            say(on, "VarMean");
        }
    }
    say(albedo ? on : off, albedo ? "albedo" : "albedo (not in the image)");
    const bool normal_used = normal && (!oidn || albedo);
    say(normal_used ? on : off, normal_used ? "normal"
                                : normal    ? "normal (used only with albedo)"
                                            : "normal (not in the image)");
    if (layers.depth.empty())
        say(off, "depth (not in the image)");
    else
        say(oidn ? off : on, oidn ? "depth (not used)" : "depth");
    const bool negative = std::any_of(layers.color, layers.color + 3, [](std::span<const float> channel) {
        return std::any_of(channel.begin(), channel.end(), [](float x) { return x < 0; });
    });
    if (negative) say(on, oidn ? "signed: positive and negative part apart" : "signed");
    return fmt::format("on: {}; off: {}", on, off);
}

}  // namespace

Prepared prepare(const Image& image) {
    Prepared prepared;
    Layers& layers = prepared.layers;
    layers.width = image.width;
    layers.height = image.height;
    prepared.storage.reserve(13);  // reserved, because spans into its elements must stay valid
    const auto take = [&](const std::string& name) {
        const auto values = image.find(name);
        prepared.storage.emplace_back(values.begin(), values.end());
    };
    const auto take_layer = [&](const std::string& prefix, const char* axes, std::span<const float>(&to)[3]) {
        for (int c = 0; c < 3; ++c)
            if (image.find(prefix + axes[c]).empty()) return;
        for (int c = 0; c < 3; ++c) {
            take(prefix + axes[c]);
            std::vector<float>& values = prepared.storage.back();
            prepared.n_bad_values += mend(values, image.width, image.height).size();
            if (&to == &layers.var_mean)
                for (float& x : values) x = std::max(x, 0.0f);
            to[c] = values;
        }
    };

    std::vector<bool> bad(image.n_pixels());
    for (int c = 0; c < 3; ++c) {
        take(std::string(1, "RGB"[c]));
        std::vector<float>& values = prepared.storage.back();
        const auto replaced = mend(values, image.width, image.height);
        if (replaced.size() == values.size()) throw InputError(fmt::format("channel {} has no finite value", "RGB"[c]));
        for (const std::size_t i : replaced) bad[i] = true;
        layers.color[c] = values;
    }
    prepared.n_bad_pixels = std::uint64_t(std::count(bad.begin(), bad.end(), true));
    if (image.samples != 1) take_layer("VarMean.", "RGB", layers.var_mean);
    take_layer("Albedo.", "RGB", layers.albedo);
    take_layer("N.", "XYZ", layers.normal);
    if (!image.find("Depth.Z").empty()) {
        take("Depth.Z");
        prepared.n_bad_values += mend(prepared.storage.back(), image.width, image.height).size();
        layers.depth = prepared.storage.back();
    }
    return prepared;
}

namespace {

constexpr const char* rgb[] = {"R", "G", "B"};

/// Means over the square of 2 radius + 1 pixels around each pixel, cut at the border.
std::vector<double> box_means(const std::vector<double>& values, std::uint32_t width, std::uint32_t height,
                              int radius) {
    const auto means = [&](const std::vector<double>& in, std::size_t n_lines, std::size_t n, std::size_t line_step,
                           std::size_t step) {
        std::vector<double> out(in.size());
        for (std::size_t line = 0; line < n_lines; ++line)
            for (std::size_t i = 0; i < n; ++i) {
                const std::size_t begin = i > std::size_t(radius) ? i - std::size_t(radius) : 0,
                                  end = std::min(n, i + std::size_t(radius) + 1);
                double sum = 0;
                for (std::size_t k = begin; k < end; ++k) sum += in[line * line_step + k * step];
                out[line * line_step + i * step] = sum / double(end - begin);
            }
        return out;
    };
    return means(means(values, height, width, width, 1), width, height, 1, width);
}

}  // namespace

OldPart old_part_of(const Image& image, Image base) {
    OldPart part{std::move(base), {}, {}, std::vector<float>(image.n_pixels()), 0};
    std::vector<double> of_difference(image.n_pixels()), of_fresh(image.n_pixels()), lost(image.n_pixels());
    // Variance of as many old paths as there are in the difference.
    const double n_per_pair =
        double(part.base.samples) /
        double(std::max<std::uint64_t>(image.ledger.empty() ? 1 : image.ledger.back().samples, 1));
    for (int c = 0; c < 3; ++c) {
        const std::string var_mean = std::string("VarMean.") + rgb[c];
        const auto weight = image.find(fmt::format("{}.{}", weight_layer, rgb[c]));
        part.weight[c].assign(image.n_pixels(), 1);
        if (!weight.empty()) part.weight[c].assign(weight.begin(), weight.end());
        const auto old_var = part.base.find(var_mean), var = image.find(var_mean);
        for (std::size_t i = 0; i < var.size(); ++i) {
            const double w = double(part.weight[c][i]), v = double(old_var[i]);
            of_difference[i] += std::max(double(var[i]) - w * w * v, 0.0);
            of_fresh[i] += v * n_per_pair;
            lost[i] = std::max(lost[i], 1 - w);
        }
    }
    const int radius = FilterParameters{}.window_radius;
    const std::vector<double> lost_around = box_means(lost, image.width, image.height, radius);
    of_difference = box_means(of_difference, image.width, image.height, radius);
    of_fresh = box_means(of_fresh, image.width, image.height, radius);
    for (std::size_t i = 0; i < part.share_of_sum.size(); ++i) {
        const double ratio = of_difference[i] > 0 ? of_difference[i] / of_fresh[i] : 0;
        part.share_of_sum[i] = float(std::clamp(std::max({lost[i], 2 * lost_around[i], ratio}), 0.0, 1.0));
        part.mean_share += double(part.share_of_sum[i]) / double(image.n_pixels());
    }
    return part;
}

std::string OldPart::plan() const {
    if (!needs_difference()) return "; as a whole: the difference from the old image is as noisy";
    return fmt::format("; the old image and the difference apart{}",
                       needs_sum() ? fmt::format(", the whole image as {:.2g} % of them", 100 * mean_share) : "");
}

Image difference_of(const Image& image, const OldPart& part) {
    Image out = image;
    for (int c = 0; c < 3; ++c) {
        const std::string var_mean = std::string("VarMean.") + rgb[c];
        const auto old = part.base.find(rgb[c]), old_var = part.base.find(var_mean);
        const auto values = out.add(rgb[c]), variances = out.add(var_mean);
        for (std::size_t i = 0; i < values.size(); ++i) {
            const float w = part.weight[c][i];
            values[i] -= w * old[i];
            variances[i] = std::max(variances[i] - w * w * old_var[i], 0.0f);
        }
    }
    return out;
}

namespace {

Filtered denoise(const Layers& layers, const std::optional<Oidn>& oidn, const FilterParameters& parameters,
                 int threads) {
    if (!oidn) return filter(layers, parameters, threads);
    Filtered out;
    oidn->denoise(layers, threads, out.color);
    return out;
}

/// Adds the denoised old image and the denoised difference to what is denoised as a whole.
/// in, out: denoised  of the whole image, or empty
void denoise_in_parts(const Image& image, const OldPart& part, const std::optional<Oidn>& oidn, int threads,
                      Filtered& denoised) {
    const Prepared prepared = prepare(difference_of(image, part));
    // Where few paths differ, a difference is made of single pixels among zeros: none of them is an outlier.
    FilterParameters unbounded;
    unbounded.outlier_limit = 0;
    const Filtered difference = denoise(prepared.layers, oidn, unbounded, threads);
    Filtered of_base;
    if (part.denoised[0].empty()) of_base = denoise(prepare(part.base).layers, oidn, {}, threads);
    for (int c = 0; c < 3; ++c) {
        const std::vector<float>& base = part.denoised[0].empty() ? of_base.color[c] : part.denoised[c];
        std::vector<float>& out = denoised.color[c];
        const auto noisy = image.find(rgb[c]);
        const bool has_whole = !out.empty();
        out.resize(noisy.size());
        for (std::size_t i = 0; i < out.size(); ++i) {
            float x = part.weight[c][i] * base[i] + difference.color[c][i];
            if (noisy[i] >= 0) x = std::max(x, 0.0f);
            const float share = has_whole ? part.share_of_sum[i] : 0;
            out[i] = has_whole ? share * out[i] + (1 - share) * x : x;
        }
    }
}

bool is_made_of(const Image& image, const std::string& file) {
    const std::string hash = identify(file).hash;
    return std::any_of(image.provenance.inputs.begin(), image.provenance.inputs.end(),
                       [&](const InputId& input) { return input.hash == hash; });
}

/// Reads --base and --denoised-base.
/// throws:  InputError where the image is no sum with that base, or the denoised base is another's
std::optional<OldPart> read_old_part(const Options& options, const Image& image) {
    if (options.base.empty()) {
        if (!options.denoised_base.empty()) throw InputError("--denoised-base: needs --base");
        return std::nullopt;
    }
    if (image.ledger.size() < 2 || image.ledger.back().method != old_graph_method)
        throw InputError(fmt::format(
            "{}: is no new image from a graph of the old scene (loom-residual --old-graph, --new); leave out --base",
            options.image));
    if (!is_made_of(image, options.base))
        throw InputError(fmt::format("{}: is not made from {}", options.image, options.base));
    Image base = read_image(options.base);
    require_finite(base, {"", "VarMean"}, options.base);
    if (base.width != image.width || base.height != image.height)
        throw InputError(fmt::format("{}: is {} x {}, but {} is {} x {}", options.base, base.width, base.height,
                                     options.image, image.width, image.height));
    for (const auto& [file, has] : {std::pair(&options.base, !base.find("VarMean.R").empty()),
                                    std::pair(&options.image, !image.find("VarMean.R").empty())})
        if (!has) throw InputError(fmt::format("{}: has no variance (VarMean)", *file));
    OldPart part = old_part_of(image, std::move(base));
    if (options.denoised_base.empty()) return part;
    const Image clean = read_image(options.denoised_base);
    if (clean.provenance.stage != "loom-denoise" || !is_made_of(clean, options.base))
        throw InputError(fmt::format("{}: is not {}, denoised", options.denoised_base, options.base));
    require_finite(clean, {""}, options.denoised_base);
    for (int c = 0; c < 3; ++c) {
        const auto values = clean.find(rgb[c]);
        part.denoised[c].assign(values.begin(), values.end());
    }
    return part;
}

}  // namespace

void declare(app::Command& command, Options& options) {
    command.file("image", options.image, "image with layers (.exr)").required();
    command.output("-o,--output", options.output, "denoised image (.exr)");
    command.output("--png", options.png, "also write an sRGB preview (.png)");
    command.option("--exposure", options.exposure_ev, "exposure of the preview", app::Range<double>{-40, 40, "EV"});
    command.choice("--method", options.method, "auto: Open Image Denoise if it is found, else the built-in filter",
                   {{"auto", Method::automatic}, {"oidn", Method::oidn}, {"filter", Method::filter}});
    command.option(
        "--oidn", options.oidn,
        "libOpenImageDenoise.so.2 or its folder (default: $LOOM_OIDN, else that of `make oidn`, else the system's)");
    command.file("--base", options.base,
                 "image that the new image was made from (loom-residual --old, with --old-graph): denoise it and the "
                 "difference apart, and add them");
    command.file("--denoised-base", options.denoised_base, "that image, denoised already");
    command.threads(options.threads);
    command.flag("--plan", options.plan, "print the plan and stop");
    command.example("loom-denoise image.exr -o clean.exr --png clean.png");
}

void run(const Options& options, app::Report& report) {
    if (!options.plan) {
        if (options.output.empty()) throw InputError("--output: missing (an .exr file)");
        check_output_path(options.output);
    }
    Image image = read_image(options.image);
    std::optional<OldPart> part = read_old_part(options, image);
    const Prepared prepared = prepare(image);
    const Layers& layers = prepared.layers;

    std::optional<Oidn> oidn;
    std::string missing;
    if (options.method != Method::filter) oidn = Oidn::load(options.oidn, missing);
    if (options.method == Method::oidn && !oidn)
        throw InputError(fmt::format("--method oidn: {} (see `make oidn` and --oidn)", missing));
    const std::string plan = plan_of(layers, oidn, options.method, image.samples) + (part ? part->plan() : "");
    if (options.plan) {
        report.answer(plan + "\n");
        return;
    }
    report.info("plan: {}", plan);
    if (prepared.n_bad_pixels > 0)
        report.warn("{}: {} pixels were not finite and are replaced by their neighbours", options.image,
                    prepared.n_bad_pixels);
    if (prepared.n_bad_values > 0)
        report.warn("{}: {} values of other layers were not finite and are replaced by their neighbours", options.image,
                    prepared.n_bad_values);

    // Denoise the image as a whole, or in parts.
    Filtered denoised;
    if (!part || part->needs_sum()) denoised = denoise(layers, oidn, {}, options.threads);
    if (part && part->needs_difference()) denoise_in_parts(image, *part, oidn, options.threads, denoised);

    Image clean;
    clean.width = image.width;
    clean.height = image.height;
    clean.samples = image.samples;
    clean.scene = image.scene;
    if (image.ledger.size() == 1) clean.ledger = image.ledger;  // a residual stores the scene that it leads to
    for (int c = 0; c < 3; ++c) clean.channels.push_back({std::string(1, "RGB"[c]), std::move(denoised.color[c])});
    // Neither the variance of the noisy image nor the layers for a blend apply to the denoised one.
    const auto of_noisy = [](const std::string& name) {
        const std::string layer = name.substr(0, name.find('.'));
        return layer == "VarMean" || layer == weight_layer ||
               std::find(estimate_layers.begin(), estimate_layers.end(), layer) != estimate_layers.end();
    };
    for (auto& channel : image.channels)
        if (clean.find(channel.name).empty() && !of_noisy(channel.name)) clean.channels.push_back(std::move(channel));
    std::vector<InputId> inputs = {identify(options.image)};
    for (const std::string* file : {&options.base, &options.denoised_base})
        if (!file->empty()) inputs.push_back(identify(*file));
    clean.provenance = report.provenance(image.provenance.seed, inputs, plan);
    write_image(clean, options.output);
    if (!options.png.empty()) write_png(clean, options.png, options.exposure_ev);

    write_cost_of(options.output, report.cost(plan), {options.image, options.base, options.denoised_base});
    report.done(
        "{}: {} x {} pixels by {}", options.output, clean.width, clean.height,
        oidn ? "Open Image Denoise" : fmt::format("the built-in filter, {} outliers bounded", denoised.n_outliers));
}

}  // namespace loom::denoise
