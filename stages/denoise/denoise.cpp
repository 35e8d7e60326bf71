#include "stages/denoise/denoise.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <filesystem>
#include <optional>

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
    const Prepared prepared = prepare(image);
    const Layers& layers = prepared.layers;

    std::optional<Oidn> oidn;
    std::string missing;
    if (options.method != Method::filter) oidn = Oidn::load(options.oidn, missing);
    if (options.method == Method::oidn && !oidn)
        throw InputError(fmt::format("--method oidn: {} (see `make oidn` and --oidn)", missing));
    const std::string plan = plan_of(layers, oidn, options.method, image.samples);
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

    std::vector<float> color[3];
    std::uint64_t n_outliers = 0;
    if (oidn) {
        oidn->denoise(layers, options.threads, color);
    } else {
        Filtered filtered = filter(layers, {}, options.threads);
        for (int c = 0; c < 3; ++c) color[c] = std::move(filtered.color[c]);
        n_outliers = filtered.n_outliers;
    }

    Image clean;
    clean.width = image.width;
    clean.height = image.height;
    clean.samples = image.samples;
    clean.scene = image.scene;
    if (image.ledger.size() == 1) clean.ledger = image.ledger;  // a residual stores the scene that it leads to
    for (int c = 0; c < 3; ++c) clean.channels.push_back({std::string(1, "RGB"[c]), std::move(color[c])});
    // Neither the variance of the noisy image nor the layers for a blend apply to the denoised one.
    const auto of_noisy = [](const std::string& name) {
        const std::string layer = name.substr(0, name.find('.'));
        return layer == "VarMean" ||
               std::find(estimate_layers.begin(), estimate_layers.end(), layer) != estimate_layers.end();
    };
    for (auto& channel : image.channels)
        if (clean.find(channel.name).empty() && !of_noisy(channel.name)) clean.channels.push_back(std::move(channel));
    clean.provenance = report.provenance(image.provenance.seed, {identify(options.image)}, plan);
    write_image(clean, options.output);
    if (!options.png.empty()) write_png(clean, options.png, options.exposure_ev);

    write_cost_of(options.output, report.cost(plan), {options.image});
    report.done("{}: {} x {} pixels by {}", options.output, clean.width, clean.height,
                oidn ? "Open Image Denoise" : fmt::format("the built-in filter, {} outliers bounded", n_outliers));
}

}  // namespace loom::denoise
