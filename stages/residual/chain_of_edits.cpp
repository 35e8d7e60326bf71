#include "stages/residual/chain_of_edits.h"

#include <fmt/format.h>

#include "formats/io/error.h"
#include "stages/core/app/report.h"

namespace loom::residual {

Ledger ledger_of(const Image& picture) {
    if (!picture.ledger.empty()) return picture.ledger;
    LedgerLink first;
    first.scene = picture.scene;
    first.what = picture.provenance.stage;
    first.samples = picture.samples;
    first.seed = picture.provenance.seed;
    first.var_mean = mean_var_mean(picture);
    first.var_sample = first.var_mean * double(picture.samples);
    return {first};
}

LedgerLink link_of_residual(const Image& residual) {
    if (residual.ledger.size() == 1) return residual.ledger[0];
    LedgerLink link;
    link.method = residual.provenance.stage;
    link.samples = residual.samples;
    link.seed = residual.provenance.seed;
    link.var_mean = mean_var_mean(residual);
    return link;
}

void check_numbers(const Ledger& before, const std::string& method, std::uint64_t seed) {
    LedgerLink edit;
    edit.method = method;
    edit.seed = seed;
    for (std::size_t i = 0; i < before.size(); ++i)
        if (share_numbers(before[i], edit))
            throw InputError(fmt::format(
                "--old: {} has the random numbers of this residual ({}, seed {}), so that their variances would not "
                "add up; make it with another --seed",
                i == 0 ? "the image before all edits" : fmt::format("its edit {} ({})", i, before[i].method), method,
                seed));
}

Standing standing_of(const Ledger& ledger) {
    Standing s;
    s.var_mean = accumulated_var_mean(ledger, ledger.size());
    s.var_mean_of_edits = s.var_mean - ledger.front().var_mean;
    s.worth = worth_samples(ledger, ledger.size());
    s.base_samples = ledger.front().samples;
    s.edit_paths = 2 * ledger.back().samples;
    for (std::size_t i = 1; i < ledger.size(); ++i) s.all_edit_paths += 2 * ledger[i].samples;
    return s;
}

void say_standing(const Ledger& ledger, const Options& options, app::Report& report) {
    const Standing s = standing_of(ledger);
    if (s.worth == 0 || s.var_mean == 0) return;
    report.info(
        "ledger: {} ({} paths per pixel) since an image of {} samples per pixel; {:.3g} % of the variance is theirs; "
        "as noisy as a fresh image of {:.3g} samples per pixel",
        ledger.size() == 2 ? "one edit" : fmt::format("{} edits", ledger.size() - 1), s.all_edit_paths, s.base_samples,
        100 * s.var_mean_of_edits / s.var_mean, s.worth);
    if (!s.rebase()) return;
    std::string fresh = "loom-trace " + (options.new_scene.empty() ? options.old_scene : options.new_scene);
    for (const auto* defines : {&options.defines, &options.new_defines})
        for (const std::string& d : *defines) fresh += fmt::format(" -D '{}'", d);
    if (!options.sensor.empty()) fresh += fmt::format(" --sensor '{}'", options.sensor);
    if (options.max_depth) fresh += fmt::format(" --max-depth {}", *options.max_depth);
    const std::string than = 2 * s.worth < double(s.base_samples)
                                 ? fmt::format("less than half of the {} that the chain began with", s.base_samples)
                                 : fmt::format("fewer than the {} paths of this edit", s.edit_paths);
    report.warn(
        "{}: as noisy as a fresh image of {:.3g} samples per pixel, {} (variance {:.3g}, {:.3g} of it by edits); "
        "re-base: {} --spp {} -o FRESH.exr",
        options.new_picture, s.worth, than, s.var_mean, s.var_mean_of_edits, fresh, s.base_samples);
}

}  // namespace loom::residual
