#include "stages/compare/compare.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <limits>
#include <map>
#include <numeric>
#include <optional>
#include <tuple>

#include "formats/image.h"
#include "formats/io/error.h"
#include "formats/io/field_checker.h"
#include "formats/transient_cube.h"
#include "stages/compare/by_frame.h"
#include "stages/compare/difference.h"
#include "stages/compare/inputs.h"
#include "stages/compare/sequence.h"
#include "stages/core/app/command.h"
#include "stages/core/plot/false_colours.h"

namespace loom::compare {
namespace {

namespace fs = std::filesystem;
constexpr double unknown = std::numeric_limits<double>::quiet_NaN();

/// An image to compare: RGB and the variance of its pixels, empty where unknown. For a cube [y, x, bin, rgb], in units
/// of `scale`, with the sums over its bins.
struct Picture {
    std::size_t width = 0, height = 0;
    std::uint64_t samples = 0;
    std::vector<float> rgb, var_mean;
    TransientCubeHeader cube;  // n_bins = 0: an image
    std::vector<float> sums, var_sums;
    double scale = 1;

    bool is_cube() const { return cube.time.n_bins > 0; }
    std::size_t n_bins() const { return std::max<std::size_t>(cube.time.n_bins, 1); }
};

std::vector<float> sums_over_bins(std::span<const float> bins, std::size_t n_bins) {
    std::vector<float> sums(bins.size() / n_bins);
    for (std::size_t pixel = 0; 3 * pixel < sums.size(); ++pixel) {
        double sum[3]{};
        for (std::size_t i = 0; i < 3 * n_bins; ++i) sum[i % 3] += double(bins[pixel * 3 * n_bins + i]);
        for (std::size_t c = 0; c < 3; ++c) sums[3 * pixel + c] = float(sum[c]);
    }
    return sums;
}

/// in:      parameter  its derivative is compared in place of the radiance; empty: the radiance
Picture read_cube(const std::string& file, const std::string& parameter) {
    const TransientCube cube = parameter.empty() ? read_any_cube(file) : read_any_derivative(file, parameter);
    const bool has_variance = cube.film.samples_per_pixel != 1;
    for (const auto& [name, values, needed] :
         {std::tuple{parameter.empty() ? "radiance" : "derivative", std::span<const float>(cube.radiance), true},
          std::tuple{parameter.empty() ? "var_mean" : "derivative_var_mean", std::span<const float>(cube.var_mean),
                     has_variance}})
        if (const std::size_t n = count_nonfinite(values); n > 0 && needed)
            throw InputError(fmt::format("{}: values that are NaN or infinite: {} of {}", file, n, name));
    Picture picture{cube.film.width,
                    cube.film.height,
                    cube.film.samples_per_pixel,
                    {cube.radiance.begin(), cube.radiance.end()},
                    {},
                    cube,
                    {},
                    {}};
    picture.sums = sums_over_bins(picture.rgb, picture.n_bins());
    if (picture.samples != 1) {
        picture.var_mean.assign(cube.var_mean.begin(), cube.var_mean.end());
        picture.var_sums = sums_over_bins(picture.var_mean, picture.n_bins());
    }
    return picture;
}

Picture read_picture(const std::string& file, const std::string& parameter = {}) {
    if (fs::path(file).extension() == ".h5") return read_cube(file, parameter);
    if (!parameter.empty())
        throw InputError(fmt::format("--parameter: compares derivatives of transient cubes, but {} is an image", file));
    NoisyImage image = read_noisy_image(file);
    return {image.width, image.height, image.samples, std::move(image.rgb), std::move(image.var_mean), {}, {}, {}};
}

void check_fit(const Picture& picture, const std::string& file, const Picture& other, const std::string& name) {
    if (picture.is_cube() != other.is_cube())
        throw InputError(fmt::format("{}: is {}, but {} is {}", file,
                                     picture.is_cube() ? "a transient cube" : "an image", name,
                                     other.is_cube() ? "a transient cube" : "an image"));
    if (picture.width != other.width || picture.height != other.height) {
        throw InputError(fmt::format("{}: is {} x {}, but {} is {} x {}", file, picture.width, picture.height, name,
                                     other.width, other.height));
    }
    // Programs start lengths at different points (a near plane); a tenth of a bin is tolerated.
    if (!picture.is_cube()) return;
    if (const std::string why = difference_in_words(picture.cube, other.cube, 0.1); !why.empty())
        throw InputError(fmt::format("{}: {} (of {})", file, why, name));
}

/// Returns the mean magnitude of the nonzero bins. Errors of bins are relative to it, as to 1 for images.
double scale_of(const Picture& reference) {
    if (!reference.is_cube()) return 1;
    double sum = 0, n = 0;
    for (float value : reference.rgb)
        if (value != 0) sum += std::abs(double(value)), ++n;
    return sum > 0 ? sum / n : 1;
}

void set_scale(Picture& picture, double scale) {
    picture.scale = scale;
    if (scale == 1) return;
    for (float& value : picture.rgb) value = float(double(value) / scale);
    for (float& value : picture.var_mean) value = float(double(value) / (scale * scale));
}

Picture read_reference(const Options& options, const std::string& file) {
    Picture reference = read_picture(file, options.parameter);
    if (!options.reference_variance.empty()) {
        if (reference.is_cube()) throw InputError("--reference-variance: is for images; a cube has its own");
        const Picture variance = read_picture(options.reference_variance);
        check_fit(variance, options.reference_variance, reference, file);
        reference.var_mean = variance.rgb;
    }
    set_scale(reference, scale_of(reference));
    return reference;
}

/// A limit on a metric.
struct Limit {
    const Column* column;
    double value;
    bool is_upper;
    std::string text;
};

void parse_limits(const std::vector<std::string>& texts, bool is_upper, std::vector<Limit>& limits) {
    for (const std::string& text : texts) {
        const std::size_t at = text.find('=');
        const auto value = at == std::string::npos ? std::nullopt : app::parse_number<double>(text.substr(at + 1));
        const auto known = std::find_if(columns().begin(), columns().end(),
                                        [&](const Column& c) { return text.substr(0, at) == c.name; });
        if (!value || known == columns().end()) {
            std::string names;
            for (const Column& column : columns()) names += (names.empty() ? "" : ", ") + std::string(column.name);
            throw InputError(fmt::format("'{}': must be METRIC=NUMBER, METRIC one of {}", text, names));
        }
        limits.push_back({&*known, *value, is_upper, text});
    }
}

Measured measure(const Picture& picture, const Picture& reference, const Options& options) {
    const std::span<const float> x = picture.rgb, r = reference.rgb;
    const std::size_t w = picture.width, h = picture.height, n_channels = 3 * picture.n_bins();
    const Correlation correlation = error_correlation(x, r, w, h, n_channels);
    Measured m{};
    m.samples = picture.samples;
    m.mse = picture.scale * picture.scale * mean_squared(x, r);
    m.rmse = std::sqrt(m.mse);
    m.relmse = mean_squared_relative(x, r);
    m.relmse_trimmed = trimmed_mean_squared_relative(x, r, n_channels);
    m.mape = mean_absolute_relative(x, r);
    if (picture.is_cube()) {
        // A cube has no display range; its largest magnitude is the peak.
        const auto [least, most] = std::minmax_element(r.begin(), r.end());
        m.psnr = 20 * std::log10(picture.scale * double(std::max(std::abs(*least), std::abs(*most))) / m.rmse);
        m.ssim = unknown;
    } else {
        const std::vector<float> shown = displayed(x, options.exposure_ev), shown_r = displayed(r, options.exposure_ev);
        m.psnr = psnr_db(shown, shown_r);
        m.ssim = ssim(luma(shown), luma(shown_r), w, h);
    }
    m.corr_right = correlation.right;
    m.corr_down = correlation.down;
    m.corr_near = correlation.near;
    m.cpu_s = m.wall_s = m.render_s = m.rays = m.peak_memory_bytes = unknown;
    m.p_pixels = m.p_bins = m.z_rms = unknown;
    return m;
}

void add_tile_errors(std::vector<double>& sums, const Picture& picture, const Picture& reference, double weight) {
    std::vector<float> squares(picture.rgb.size());
    for (std::size_t i = 0; i < squares.size(); ++i) {
        const double r = double(reference.rgb[i]), d = double(picture.rgb[i]) - r;
        squares[i] = float(d * d / (r * r + relative_floor));
    }
    if (picture.is_cube()) squares = sums_over_bins(squares, picture.n_bins());
    const Regions regions = regions_of(squares, picture.width, picture.height);
    sums.resize(n_tiles * n_tiles);
    for (std::size_t t = 0; t < sums.size(); ++t)
        for (std::size_t c = 0; c < 3; ++c) sums[t] += weight * regions.sum[c][1 + t];
}

/// A group and its images, while they are needed.
struct Loaded {
    Group group;
    std::vector<std::vector<float>> rgb, sums;  // sums: of cubes
    std::vector<float> var_mean;                // of cubes: sum over the replicates
    Picture first;                              // its rgb and sums are in `rgb` and `sums`
};

/// Tests the pooled bins of the mean of the replicates.
void test_bins(Loaded& loaded, const Picture& reference, const Options& options) {
    Group& group = loaded.group;
    const double R = double(loaded.rgb.size());
    double p_pixels = unknown, p_bins = unknown, z_rms = unknown;
    const Estimators estimators = options.parameter.empty() ? Estimators::alike : Estimators::different;
    if (R > 1 || !loaded.first.var_sums.empty())
        p_pixels = test_pixels(loaded.sums, loaded.first.var_sums, double(group.samples()), reference.sums,
                               reference.var_sums, double(reference.samples), estimators);
    if (!loaded.var_mean.empty()) {
        std::vector<float> mean(reference.rgb.size()), var_mean = std::move(loaded.var_mean);
        for (std::size_t i = 0; i < mean.size(); ++i) {
            double sum = 0;
            for (const auto& cube : loaded.rgb) sum += double(cube[i]);
            mean[i] = float(sum / R);
            var_mean[i] = float(double(var_mean[i]) / (R * R));
        }
        for (const Pooling pooling : {Pooling::pixels, Pooling::image})
            group.pools.push_back(test_pools({mean, var_mean, R * double(group.samples())},
                                             {reference.rgb, reference.var_mean, double(reference.samples)},
                                             reference.width, reference.height, reference.n_bins(), pooling,
                                             options.pool_error, estimators));
        p_bins = corrected_p(std::min(group.pools[0].p, group.pools[1].p), 2);
        z_rms = group.pools[0].rms_z;
    }
    for (Measured& m : group.replicates) m.p_pixels = p_pixels, m.p_bins = p_bins, m.z_rms = z_rms;
}

void finish(Loaded& loaded, const Picture& reference, const Options& options) {
    Group& group = loaded.group;
    const std::span<const float> var_mean = loaded.first.var_mean;
    const Decomposition parts = decompose(loaded.rgb, var_mean, reference.rgb, reference.var_mean);
    if (reference.is_cube()) {
        group.significance = test_means({loaded.sums, loaded.first.var_sums}, reference.sums, reference.var_sums,
                                        reference.width, reference.height);
        test_bins(loaded, reference, options);
    } else {
        group.significance =
            test_means({loaded.rgb, var_mean}, reference.rgb, reference.var_mean, reference.width, reference.height);
    }
    const double n = double(reference.var_mean.size()),  // 0: unknown
        reference_mse = reference.scale * reference.scale *
                        std::accumulate(reference.var_mean.begin(), reference.var_mean.end(), 0.0) / n;
    for (Measured& m : group.replicates) {
        m.bias2 = parts.bias2;
        m.variance = parts.variance;
        m.reference_noise = reference.var_mean.empty() ? unknown : parts.reference;
        m.relmse_net = m.relmse - m.reference_noise;
        m.mse_net = m.mse - reference_mse;
        m.p_image = group.significance.p_image;
        m.p_tiles = group.significance.p_tiles;
    }
}

void add_cost(Measured& m) {
    const Cost total = total_of(chain_cost(m.file)).cost;
    m.cpu_s = total.cpu_s;
    m.render_s = total.cpu_s - total.load_s;
    m.wall_s = total.wall_s;
    m.rays = double(total.rays);
    m.peak_memory_bytes = double(total.peak_memory_bytes);
}

void write_difference(const Options& options, const Loaded& loaded, const Picture& reference,
                      const Provenance& provenance, app::Report& report) {
    // For cubes use the sums over their bins.
    const auto& pictures = reference.is_cube() ? loaded.sums : loaded.rgb;
    const auto& of_reference = reference.is_cube() ? reference.sums : reference.rgb;
    std::vector<float> mean(of_reference.size());
    for (std::size_t i = 0; i < mean.size(); ++i) {
        double sum = 0;
        for (const auto& picture : pictures) sum += double(picture[i]);
        mean[i] = float(sum / double(pictures.size()));
    }
    Image image = difference_image(mean, of_reference, reference.width, reference.height, loaded.group.significance);
    image.provenance = provenance;
    write_image(image, options.difference);
    fs::path png = options.difference;
    write_png(false_colours(image, "Relative", options.reach), png.replace_extension(".png"));
    png.replace_extension();
    png += "-tiles.png";
    write_png(false_colours(image, "Tile", options.reach), png);
    report.info("{}: difference of {}, false colours beside it", options.difference, loaded.group.method());
}

int judge(const std::vector<Limit>& limits, const Comparison& comparison, app::Report& report) {
    int code = app::exit_done;
    for (const Limit& limit : limits) {
        for (const Group& group : comparison.groups) {
            const double value = group.estimate(limit.column->value).mean;
            // An unknown value does not pass.
            if (limit.is_upper ? value <= limit.value : value >= limit.value) continue;
            report.error("{}: {} is {:.6g}, the {} limit is {:.6g}", group.method(), limit.column->name, value,
                         limit.is_upper ? "upper" : "lower", limit.value);
            code = app::exit_no;
        }
    }
    return code;
}

/// Returns the samples per pixel from the header, if there is one.
std::uint64_t samples_of(const std::string& file) {
    if (!fs::exists(file)) return 0;
    if (fs::path(file).extension() == ".h5")
        return is_transient_cube(file) ? read_transient_cube(file).film.samples_per_pixel : 0;
    if (fs::path(file).extension() != ".exr") return 0;
    for (const auto& [name, value] : exr_attributes(file))
        if (name == "samples") return app::parse_number<std::uint64_t>(value).value_or(0);
    return 0;
}

void report_costs(const Options& options, app::Report& report) {
    std::vector<InputCost> costs;
    std::map<std::pair<std::string, std::uint64_t>, std::uint64_t> replicates;
    for (const Input& input : inputs_of(options.inputs)) {
        InputCost cost{options.scene, input.label, input.file, samples_of(input.file), 0, chain_cost(input.file)};
        cost.replicate = replicates[{cost.method, cost.samples}]++;
        costs.push_back(std::move(cost));
    }
    report.answer(options.json ? json_of(costs) : options.tsv ? tsv_of(costs) : text_of(costs));
}

}  // namespace

std::span<const Column> columns() {
    static constexpr Column all[] = {
        {"mse", &Measured::mse, false},
        {"relmse", &Measured::relmse, false},
        {"relmse_trimmed", &Measured::relmse_trimmed, false},
        {"relmse_net", &Measured::relmse_net, false},
        {"mse_net", &Measured::mse_net, false},
        {"mape", &Measured::mape, false},
        {"rmse", &Measured::rmse, false},
        {"psnr", &Measured::psnr, false},
        {"ssim", &Measured::ssim, false},
        {"corr_right", &Measured::corr_right, false},
        {"corr_down", &Measured::corr_down, false},
        {"corr_near", &Measured::corr_near, false},
        {"bias2", &Measured::bias2, true},
        {"variance", &Measured::variance, true},
        {"reference_noise", &Measured::reference_noise, true},
        {"p_image", &Measured::p_image, true},
        {"p_tiles", &Measured::p_tiles, true},
        {"p_pixels", &Measured::p_pixels, true},
        {"p_bins", &Measured::p_bins, true},
        {"z_rms", &Measured::z_rms, true},
        {"cpu_s", &Measured::cpu_s, false},
        {"wall_s", &Measured::wall_s, false},
        {"render_s", &Measured::render_s, false},
        {"rays", &Measured::rays, false},
        {"peak_memory_bytes", &Measured::peak_memory_bytes, false},
    };
    return all;
}

Estimate Group::estimate(double Measured::*value) const {
    std::vector<double> values;
    for (const Measured& m : replicates) values.push_back(m.*value);
    Estimate estimate = estimate_of(values);
    // The running mean of equal values may round; that of one infinite value would be NaN.
    if (values.size() == 1) return {values[0], unknown, 0};
    if (!std::isfinite(estimate.mean)) estimate = {values[0], unknown, 0};
    return estimate;
}

Gain gain_of(const Group& first, const Group& group) {
    std::vector<double> a, b;
    for (const Measured& m : first.replicates) a.push_back(m.relmse);
    for (const Measured& m : group.replicates) b.push_back(m.relmse);
    Gain gain;
    gain.error = a.size() > 1 && b.size() > 1 ? ratio_of(a, b) : ratio_of_tiles(first.tile_errors, group.tile_errors);
    gain.equal_cpu = gain.error.value * first.estimate(&Measured::cpu_s).mean / group.estimate(&Measured::cpu_s).mean;
    return gain;
}

void declare(app::Command& command, Options& options) {
    command
        .labelled_files("inputs", options.inputs,
                        "images (EXR) or transient cubes (.h5); those with the same label and samples per pixel are "
                        "replicates of one method")
        .required();
    command.file_or_sequence(
        "-r,--reference", options.reference,
        "reference image (EXR) or cube (.h5; of another program: with mean and var_mean); default for two "
        "inputs: the second");
    command.file("--reference-variance", options.reference_variance,
                 "EXR with the variance of the reference's pixels as RGB (default: its VarMean layer)");
    command.option("--scene", options.scene, "name of the scene in the tables");
    command.option("--exposure", options.exposure_ev, "exposure of the images before psnr and ssim",
                   app::Range<double>{-40, 40, "EV"});
    command.option("--parameter", options.parameter,
                   "compare the derivatives of cubes by this parameter, in place of the radiance");
    command.option("--pool-error", options.pool_error, "relative standard error up to which bins of cubes are pooled",
                   app::Range<double>{1e-6, 1e6});
    command.flag("--cost", options.cost,
                 "add the cost of each input along its chain of parents; without --reference: costs by stage only");
    command.flag(
        "--sequence", options.sequence,
        "inputs and --reference are frames of animations, their names with a % for the number: print error and "
        "flicker; with --tsv a row per frame");
    command.flag("--spectrum", options.spectrum,
                 "the same; print a TSV table of the power of the errors by frequency in time");
    command.flag(
        "--by-frame", options.by_frame,
        "inputs are frames of animations, names with a % or with the number of the frame at their end: print a TSV "
        "table of the cost and the expected error of each");
    command.flag("--json", options.json, "print JSON instead of text");
    command.flag("--tsv", options.tsv, "print a TSV table for loom-chart, a row per input");
    command.output("--difference", options.difference,
                   "write the difference of a single method as EXR, and as PNG beside it");
    command.option("--reach", options.reach, "largest value of the false colours in the PNG; 0: the 99th percentile",
                   app::Range<double>{0, 1e30});
    command.option("--fail-above", options.fail_above, "METRIC=VALUE: exit with 1 when a method is above VALUE");
    command.option("--fail-below", options.fail_below, "METRIC=VALUE: exit with 1 when a method is below VALUE");
    command.example("loom-compare pt=a.exr pt=b.exr graph=c.exr graph=d.exr --reference reference.exr --cost");
    command.example("loom-compare --sequence pt=pt/frame-%.exr hybrid=frame-%.exr --reference reference/frame-%.exr");
}

namespace {

/// File of the reference: without --reference the second of two inputs, which is then taken from them.
std::string take_reference(const Options& options, std::vector<Input>& inputs) {
    if (!options.reference.empty()) return options.reference;
    if (inputs.size() != 2) throw InputError("--reference: missing; only two inputs can do without it");
    std::string file = inputs[1].file;
    inputs.pop_back();
    return file;
}

/// Measures inputs one after the other, a group for each method and number of samples.
class Loader {
  public:
    Loader(const Options& options, const Picture& reference, const std::string& reference_file)
        : options_(options), reference_(reference), reference_file_(reference_file) {}

    /// in:  hash  of the file
    void add(const Input& input, const std::string& hash) {
        Picture picture = read_picture(input.file, options_.parameter);
        check_fit(picture, input.file, reference_, reference_file_);
        set_scale(picture, reference_.scale);
        const auto [at, is_new] = group_by_key_.try_emplace({input.label, picture.samples}, loaded.size());
        if (is_new) loaded.emplace_back();
        // The same noise twice is no replicate. Two methods may well give the same bytes.
        const auto [known, first_time] = name_by_hash_.try_emplace(hash + std::to_string(at->second), input.file);
        if (!first_time) throw InputError(fmt::format("{}: holds the same samples as {}", input.file, known->second));
        add_replicate(input, std::move(picture), is_new, loaded[at->second]);
    }

    std::vector<Loaded> loaded;

  private:
    void add_replicate(const Input& input, Picture picture, bool is_first, Loaded& into) {
        Measured m = measure(picture, reference_, options_);
        m.method = input.label;
        m.file = input.file;
        m.replicate = into.group.replicates.size();
        if (options_.cost) add_cost(m);
        into.group.replicates.push_back(std::move(m));
        add_tile_errors(into.group.tile_errors, picture, reference_, 1);
        into.rgb.push_back(std::move(picture.rgb));
        if (picture.is_cube()) {
            into.sums.push_back(std::move(picture.sums));
            if (is_first)
                into.var_mean = picture.var_mean;
            else
                for (std::size_t i = 0; i < into.var_mean.size(); ++i) into.var_mean[i] += picture.var_mean[i];
        }
        if (is_first) into.first = std::move(picture);
    }

    const Options& options_;
    const Picture& reference_;
    const std::string& reference_file_;
    std::map<std::string, std::string> name_by_hash_;
    std::map<std::pair<std::string, std::uint64_t>, std::size_t> group_by_key_;
};

void warn_of_noise(const Group& group, app::Report& report) {
    const double noise = group.replicates[0].reference_noise, relmse = group.estimate(&Measured::relmse).mean;
    if (noise > 0.1 * relmse)
        report.warn("{}: {:.0f} % of the relMSE is the reference's own noise; see relmse_net", group.method(),
                    100 * noise / relmse);
}

}  // namespace

int run(const Options& options, app::Report& report) {
    if (options.json && options.tsv) throw InputError("--json, --tsv: give only one of them");
    if (options.by_frame) {
        report.answer(table_by_frame(options));
        return app::exit_done;
    }
    if (is_sequence(options)) {
        report.answer(compare_sequences(options));
        return app::exit_done;
    }
    std::vector<Limit> limits;
    parse_limits(options.fail_above, true, limits);
    parse_limits(options.fail_below, false, limits);
    std::vector<Input> inputs = inputs_of(options.inputs);

    // Costs alone need no reference.
    if (options.cost && options.reference.empty()) {
        if (!limits.empty() || !options.difference.empty())
            throw InputError(
                "--cost: compares nothing without --reference; give a reference or leave out --difference and "
                "--fail-*");
        report_costs(options, report);
        return app::exit_done;
    }

    // Read the reference.
    const std::string reference_file = take_reference(options, inputs);
    if (!options.difference.empty() && fs::path(options.difference).extension() != ".exr")
        throw InputError(fmt::format("{}: the difference must end in .exr", options.difference));
    const Picture reference = read_reference(options, reference_file);
    if (reference.is_cube() && reference.var_mean.empty())
        throw InputError(
            fmt::format("{}: has no variance and cannot be a reference; a cube needs two samples per pixel or more",
                        reference_file));

    // Measure the inputs.
    Provenance provenance = report.provenance(0, {}, {});
    Loader loader(options, reference, reference_file);
    for (const Input& input : inputs) {
        provenance.inputs.push_back(identify(input.file));
        loader.add(input, provenance.inputs.back().hash);
    }
    if (!options.difference.empty() && loader.loaded.size() != 1)
        throw InputError(fmt::format("--difference: needs exactly one method, not {}", loader.loaded.size()));
    for (Loaded& one : loader.loaded) {
        for (double& error : one.group.tile_errors) error /= double(one.rgb.size());
        finish(one, reference, options);
        warn_of_noise(one.group, report);
    }

    // Write the results.
    provenance.inputs.push_back(identify(reference_file));
    if (!options.difference.empty()) write_difference(options, loader.loaded[0], reference, provenance, report);
    Comparison comparison{
        options.scene, reference_file, reference.width, reference.height, reference.cube.time.n_bins, {}};
    for (Loaded& one : loader.loaded) comparison.groups.push_back(std::move(one.group));
    report.answer(options.json ? json_of(comparison) : options.tsv ? tsv_of(comparison) : text_of(comparison));
    return judge(limits, comparison, report);
}

}  // namespace loom::compare
