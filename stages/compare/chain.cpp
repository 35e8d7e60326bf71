#include "stages/compare/chain.h"

#include <algorithm>

#include "formats/chain.h"

namespace loom::compare {
namespace {

void add(StageCost& sum, const Cost& cost, std::uint64_t n_files) {
    sum.n_files += n_files;
    loom::add(sum.cost, cost);
}

}  // namespace

std::vector<StageCost> chain_cost(const std::filesystem::path& output) {
    std::vector<StageCost> stages;
    for (const ChainFile& file : read_chain(output)) {
        auto stage = std::find_if(stages.begin(), stages.end(),
                                  [&](const StageCost& s) { return s.cost.stage == file.cost.stage; });
        if (stage == stages.end()) {
            stage = stages.emplace(stages.end());
            stage->cost.stage = file.cost.stage;
        }
        add(*stage, file.cost, 1);
    }
    return stages;
}

StageCost total_of(const std::vector<StageCost>& stages) {
    StageCost total;
    total.cost.stage = "total";
    for (const StageCost& stage : stages) add(total, stage.cost, stage.n_files);
    return total;
}

}  // namespace loom::compare
