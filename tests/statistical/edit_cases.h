#pragma once
// Edits of one scene by changes of its text: cornell-box.xml under a constant sky of low radiance, at small size.

#include <fmt/format.h>
#include <unistd.h>

#include <fstream>
#include <iterator>
#include <stdexcept>

#include "stages/residual/dynamic_estimator.h"
#include "tests/statistical/support.h"

namespace loom::residual {

inline constexpr int edit_size = 32;  // px

struct EditCase {
    using Changes = std::vector<std::pair<std::string, std::string>>;  // applied to the last occurrence of the text
    std::string name;
    Changes changes;
    Changes setting = {};  // applied to both scenes, first
};
inline void PrintTo(const EditCase& edit, std::ostream* out) {
    *out << edit.name;
}

/// One of the two scene files of an edit. It must exist as long as its description is used, because building a scene
/// reads it again.
class SceneFile {
  public:
    SceneFile(const EditCase& edit, bool after)
        : file_(std::filesystem::temp_directory_path() /
                fmt::format("loom-edit-{}-{}-{}.xml", getpid(), edit.name, after ? "new" : "old")) {
        std::ifstream in(source_dir() / "scenes/cornell-box.xml");
        std::string text{std::istreambuf_iterator<char>(in), {}};
        text.replace(text.rfind("</scene>"), 8,
                     "<emitter type=\"constant\"><rgb name=\"radiance\" value=\"0.2\"/></emitter></scene>");
        change(text, edit.setting);
        if (after) change(text, edit.changes);
        std::ofstream(file_) << text;
    }
    ~SceneFile() { std::filesystem::remove(file_); }
    SceneFile(const SceneFile&) = delete;
    SceneFile& operator=(const SceneFile&) = delete;

    SceneDescription read() const {
        return read_scene(file_.string(), {{"resx", std::to_string(edit_size)}, {"resy", std::to_string(edit_size)}});
    }

  private:
    static void change(std::string& text, const EditCase::Changes& changes) {
        for (const auto& [from, to] : changes) {
            const auto at = text.rfind(from);
            if (at == std::string::npos) throw std::logic_error("no such text: " + from);
            text.replace(at, from.size(), to);
        }
    }
    std::filesystem::path file_;
};

/// Two scenes and the edit between them.
struct EditedScenes {
    std::unique_ptr<Scene> old_scene, new_scene;
    Edit edit;
    EditedScenes(SceneDescription before, SceneDescription after) : edit(find_edit(before, after)) {
        old_scene = build_scene(std::move(before));
        new_scene = build_scene(std::move(after));
    }
    Image dynamic(const DynamicOptions& options, std::uint64_t seed, std::uint64_t spp, int threads = 1) const {
        app::Report report;
        report.set_quiet(true);
        PathOptions path = options_of(*new_scene);
        path.seed = seed;
        DynamicCounts counts;
        return render_dynamic({*old_scene, *new_scene}, edit, options, path, {0, spp, threads}, report, counts);
    }
};

inline EditedScenes edited(const EditCase& edit) {
    const SceneFile before(edit, false), after(edit, true);
    return {before.read(), after.read()};
}

}  // namespace loom::residual
