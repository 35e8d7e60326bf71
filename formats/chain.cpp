#include "formats/chain.h"

#include <fmt/format.h>

#include <map>

#include "formats/io/error.h"
#include "formats/survey.h"

namespace loom {
namespace {

namespace fs = std::filesystem;

/// Describes how to remake a missing cost file; the file itself, if it exists, stores its command.
std::string remedy(const fs::path& file) {
    if (!fs::exists(file)) return fmt::format("make {} again", file.native());
    const std::string command = survey_file(file).attribute("command");
    if (command.empty()) return fmt::format("{} was made by another program: it has no cost", file.native());
    return fmt::format("make {0} again: {1} -o {0}", file.native(), command);
}

class Walk {
  public:
    std::vector<ChainFile> files;

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
        Cost cost = read_cost(file);
        for (const std::string& parent : cost.parents) visit((file.parent_path() / parent).lexically_normal(), file);
        files.push_back({file, std::move(cost)});
        done_[key] = true;
    }

  private:
    std::map<fs::path, bool> done_;  // false while its parents are visited
};

}  // namespace

std::vector<ChainFile> read_chain(const fs::path& output) {
    Walk walk;
    walk.visit(output, {});
    return std::move(walk.files);
}

}  // namespace loom
