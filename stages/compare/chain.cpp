#include "stages/compare/chain.h"

#include <fmt/format.h>

#include <algorithm>
#include <map>

#include "formats/io/error.h"
#include "formats/survey.h"

namespace loom::compare {
namespace {

namespace fs = std::filesystem;

void add(StageCost& sum, const Cost& cost, std::uint64_t n_files) {
    sum.n_files += n_files;
    sum.cost.wall_s += cost.wall_s;
    sum.cost.cpu_s += cost.cpu_s;
    sum.cost.rays += cost.rays;
    sum.cost.samples += cost.samples;
    sum.cost.bytes_written += cost.bytes_written;
    sum.cost.peak_memory_bytes = std::max(sum.cost.peak_memory_bytes, cost.peak_memory_bytes);
}

/// How to get a cost file that is not there: the file says how it was made, if it is there itself.
std::string remedy(const fs::path& file) {
    if (!fs::exists(file)) return fmt::format("make {} again", file.native());
    const std::string command = survey_file(file).attribute("command");
    if (command.empty()) return fmt::format("{} was made by another program: it has no cost", file.native());
    return fmt::format("make {0} again: {1} -o {0}", file.native(), command);
}

class Walk {
  public:
    std::vector<StageCost> stages;

    void visit(const fs::path& file, const fs::path& child) {
        const fs::path key = fs::weakly_canonical(file);
        const auto [at, is_new] = done_.try_emplace(key, false);
        if (!is_new) {
            if (!at->second) throw InputError(fmt::format("{}: is among its own parents", file.native()));
            return;
        }
        if (!fs::exists(cost_path(file))) {
            throw InputError(fmt::format("{}: no such file{}; {}", cost_path(file).native(),
                                         child.empty() ? "" : fmt::format(" (a parent of {})", child.native()),
                                         remedy(file)));
        }
        const Cost cost = read_cost(file);
        for (const std::string& parent : cost.parents) visit((file.parent_path() / parent).lexically_normal(), file);
        auto stage =
            std::find_if(stages.begin(), stages.end(), [&](const StageCost& s) { return s.cost.stage == cost.stage; });
        if (stage == stages.end()) {
            stage = stages.emplace(stages.end());
            stage->cost.stage = cost.stage;
        }
        add(*stage, cost, 1);
        done_[key] = true;
    }

  private:
    std::map<fs::path, bool> done_;  // false while its parents are visited
};

}  // namespace

std::vector<StageCost> chain_cost(const fs::path& output) {
    Walk walk;
    walk.visit(output, {});
    return std::move(walk.stages);
}

StageCost total_of(const std::vector<StageCost>& stages) {
    StageCost total;
    total.cost.stage = "total";
    for (const StageCost& stage : stages) add(total, stage.cost, stage.n_files);
    return total;
}

}  // namespace loom::compare
