#include "stages/compare/by_frame.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <set>

#include "formats/chain.h"
#include "formats/image.h"
#include "formats/io/error.h"
#include "stages/compare/compare.h"
#include "stages/compare/inputs.h"
#include "stages/compare/metrics.h"
#include "stages/core/app/values.h"

namespace loom::compare {
namespace {

namespace fs = std::filesystem;

/// Returns the chain of an image; nothing without a cost file.
std::vector<ChainFile> chain_of(const std::string& file) {
    return fs::exists(cost_path(file)) ? read_chain(file) : std::vector<ChainFile>{};
}

double expected_relmse(const Image& image) {
    if (image.samples == 1 || image.find("VarMean.R").empty()) return FrameFacts::unknown;
    const std::vector<float> L = image.interleaved(""), var = image.interleaved("VarMean");
    double sum = 0;
    for (std::size_t i = 0; i < L.size(); ++i) sum += double(var[i]) / (double(L[i]) * double(L[i]) + relative_floor);
    return sum / double(L.size());
}

/// Sets what the ledger of a frame from a graph says.
/// in:      made  its file, and what it cost
void add_ledger(const Image& image, const Cost& made, FrameFacts& facts) {
    const Ledger& ledger = image.ledger;
    if (ledger.size() < 2 || ledger.back().method != old_graph_method) return;
    const double paths = double(image.n_pixels()) * double(ledger.back().samples);
    if (paths > 0) facts.touched = double(made.samples) / paths;
    const double all = accumulated_var_mean(ledger, ledger.size());
    if (all > 0) facts.static_share = accumulated_var_mean(ledger, ledger.size() - 1) / all;
}

std::string number_text(double x) {
    return std::isnan(x) ? "nan" : fmt::format("{:.6g}", x);
}

/// Returns the inputs as sequences by label, in the order of the labels' first inputs: those of a name with a %, or single
/// frames with numbers at the end of their names.
std::vector<std::pair<std::string, std::map<std::uint64_t, std::string>>> sequences_of(const Options& options) {
    std::vector<std::pair<std::string, std::map<std::uint64_t, std::string>>> sequences;
    for (const Input& input : inputs_of(options.inputs)) {
        auto sequence = std::find_if(sequences.begin(), sequences.end(),
                                     [&](const auto& known) { return known.first == input.label; });
        if (sequence == sequences.end()) sequence = sequences.insert(sequences.end(), {input.label, {}});
        std::map<std::uint64_t, std::string> files;
        if (input.file.find('%') != std::string::npos) {
            files = files_of_sequence(input.file);
        } else if (const auto number = app::number_at_end(input.file)) {
            files = {{*number, input.file}};
        } else {
            throw InputError(
                fmt::format("{}: --by-frame needs the number of a frame at the end of its name", input.file));
        }
        for (const auto& [number, file] : files)
            if (const auto [known, is_new] = sequence->second.try_emplace(number, file); !is_new)
                throw InputError(fmt::format("{}: is the same frame as {}", file, known->second));
    }
    return sequences;
}

}  // namespace

std::vector<FrameFacts> facts_of_frames(const std::map<std::uint64_t, std::string>& files) {
    std::vector<std::vector<ChainFile>> chains;
    std::map<fs::path, std::size_t> n_frames_of;  // that a file is an ancestor of
    double shared_s = 0;
    bool knows_costs = true;
    for (const auto& [number, file] : files) {
        chains.push_back(chain_of(file));
        std::set<fs::path> of_frame;
        for (const ChainFile& made : chains.back()) {
            const fs::path name = made.file.lexically_normal();
            of_frame.insert(name);
            if (!n_frames_of.contains(name)) shared_s += made.cost.cpu_s - made.cost.load_s;
        }
        for (const fs::path& made : of_frame) ++n_frames_of[made];
        knows_costs &= !chains.back().empty();
    }
    std::vector<FrameFacts> out;
    for (const auto& [number, file] : files) {
        FrameFacts facts;
        facts.number = number;
        const std::vector<ChainFile>& chain = chains[out.size()];
        const Image image = read_image(file);
        require_finite(image, {""}, file);
        facts.expected_relmse = expected_relmse(image);
        if (!chain.empty()) facts.cpu_s = facts.render_s = 0;
        // What a residual is made of, all frames share, even where a graph has one frame only.
        const auto is_residual = [](const ChainFile& made) { return made.cost.stage == "loom-residual"; };
        const auto residual = std::find_if(chain.begin(), chain.end(), is_residual);
        for (auto made = residual == chain.end() ? chain.begin() : residual; made != chain.end(); ++made) {
            if (n_frames_of[made->file.lexically_normal()] > 1) continue;
            facts.cpu_s += made->cost.cpu_s;
            facts.render_s += made->cost.cpu_s - made->cost.load_s;
            if (made != residual) continue;
            // A denoised frame keeps no ledger; the image that it is made of does.
            if (!image.ledger.empty())
                add_ledger(image, made->cost, facts);
            else if (fs::exists(made->file))
                add_ledger(read_image(made->file), made->cost, facts);
        }
        if (!chain.empty()) shared_s -= facts.render_s;
        out.push_back(facts);
    }
    // Sums in another order leave rounding.
    for (FrameFacts& facts : out)
        if (knows_costs) facts.shared_s = shared_s > 1e-9 ? shared_s : 0;
    return out;
}

std::string table_by_frame(const Options& options) {
    if (options.json || options.cost || !options.reference.empty() || !options.difference.empty() ||
        !options.parameter.empty() || !options.reference_variance.empty() || !options.fail_above.empty() ||
        !options.fail_below.empty())
        throw InputError("--by-frame: allows no other options than --scene and --tsv");
    std::string text = "scene\tmethod\tframe\tcpu_s\trender_s\tshared_s\ttouched\texpected_relmse\tstatic_share\n";
    for (const auto& [label, files] : sequences_of(options))
        for (const FrameFacts& f : facts_of_frames(files))
            text += fmt::format("{}\t{}\t{}\t{}\t{}\t{}\t{}\t{}\t{}\n", options.scene, label, f.number,
                                number_text(f.cpu_s), number_text(f.render_s), number_text(f.shared_s),
                                number_text(f.touched), number_text(f.expected_relmse), number_text(f.static_share));
    return text;
}

}  // namespace loom::compare
