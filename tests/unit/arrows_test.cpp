// The architecture as a test: every #include of the project goes along an arrow of the drawing below.
//
//   tests ─▶ stages/NAME ─▶ stages/core ─▶ formats ─▶ formats/io
//   core:    transport ─▶ scene ─▶ scattering ─▶ sampling ─▶ math;   beside: app, table, plot, and stats ─▶ math
//
// Caught: a stage that includes another (they meet in files only), a format that knows a BSDF, HDF5 or
// OpenEXR outside of formats, Embree outside of its one file.

#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <map>
#include <regex>
#include <set>
#include <string>
#include <vector>

namespace {

namespace fs = std::filesystem;

struct Include {
    std::string file;  // relative to the root
    std::string name;
    bool quoted;
    int line;
};

std::vector<Include> includes() {
    const fs::path root = LOOM_SOURCE_DIR;
    const std::regex pattern(R"re(^\s*#\s*include\s*([<"])([^>"]+)[>"])re");
    const std::set<std::string> endings = {".h", ".inl", ".cpp"};
    std::vector<Include> found;
    for (const char* top : {"stages", "formats", "tests"}) {
        for (const auto& entry : fs::recursive_directory_iterator(root / top)) {
            if (!entry.is_regular_file() || !endings.contains(entry.path().extension().string())) continue;
            std::ifstream in(entry.path());
            int number = 0;
            for (std::string line; std::getline(in, line);) {
                ++number;
                std::smatch match;
                if (!std::regex_search(line, match, pattern)) continue;
                found.push_back({fs::relative(entry.path(), root).string(), match[2], match[1] == "\"", number});
            }
        }
    }
    return found;
}

/// A header that the build makes: of the release, or of a stage's plain files (add_page of CMakeLists.txt).
bool is_generated(const std::string& name) {
    return name == "version.h" || name == "report_page.h";
}

/// "formats/io", "formats", "core/math", …, "stages/trace", "tests": where a path from the root lives.
std::string room_of(const std::string& path) {
    const fs::path parts(path);  // outlives its iterators
    const auto part = [&](int n) {
        auto at = parts.begin();
        std::advance(at, n);
        return at->string();
    };
    if (path.starts_with("formats/io/")) return "formats/io";
    if (path.starts_with("formats/")) return "formats";
    if (path.starts_with("stages/core/")) return "core/" + part(2);
    if (path.starts_with("stages/")) return "stages/" + part(1);
    return "tests";
}

/// The rooms that a room may include besides itself.
const std::map<std::string, std::set<std::string>>& arrows() {
    static const std::set<std::string> formats = {"formats", "formats/io"};
    static const auto with = [](std::set<std::string> rooms, const std::set<std::string>& more) {
        rooms.insert(more.begin(), more.end());
        return rooms;
    };
    static const std::map<std::string, std::set<std::string>> allowed = {
        {"formats/io", {}},
        {"formats", {"formats/io"}},
        {"core/math", formats},
        {"core/sampling", with(formats, {"core/math"})},
        {"core/scattering", with(formats, {"core/math", "core/sampling"})},
        {"core/scene", with(formats, {"core/math", "core/sampling", "core/scattering", "core/app"})},
        {"core/transport",
         with(formats, {"core/math", "core/sampling", "core/scattering", "core/scene", "core/app", "core/stats"})},
        {"core/stats", with(formats, {"core/math"})},
        {"core/app", formats},
        {"core/table", {"formats/io"}},
        {"core/plot", {"formats/io"}},
    };
    return allowed;
}

TEST(Arrows, includes_are_found) {
    EXPECT_GT(includes().size(), 100u);
}

TEST(Arrows, own_headers_are_quoted_from_the_root_and_exist) {
    const fs::path root = LOOM_SOURCE_DIR;
    for (const Include& i : includes()) {
        if (i.quoted) {
            EXPECT_TRUE(is_generated(i.name) || fs::exists(root / i.name))
                << i.file << ":" << i.line << ": \"" << i.name << "\" is not a file from the root";
        } else {
            EXPECT_FALSE(fs::exists(root / i.name))
                << i.file << ":" << i.line << ": <" << i.name << "> is a header of the project";
        }
    }
}

TEST(Arrows, rooms_include_only_rooms_below) {
    for (const Include& i : includes()) {
        if (!i.quoted || is_generated(i.name)) continue;
        const std::string from = room_of(i.file), to = room_of(i.name);
        if (from == to || from == "tests") continue;
        const bool is_stage = from.starts_with("stages/");
        const bool to_core_or_formats = to.starts_with("core/") || to.starts_with("formats");
        if (!is_stage) {
            ASSERT_TRUE(arrows().contains(from)) << i.file << ": room " << from << " is not in the drawing";
        }
        EXPECT_TRUE(is_stage ? to_core_or_formats : arrows().at(from).contains(to))
            << i.file << ":" << i.line << ": " << from << " must not include " << i.name << " (" << to << ")";
    }
}

TEST(Arrows, libraries_stay_in_their_rooms) {
    struct Rule {
        const char* header;        // prefix of the name included
        std::set<std::string> in;  // prefixes of the files that may
    };
    const std::vector<Rule> rules = {
        {"hdf5", {"formats/", "tests/"}},
        {"H5", {"formats/", "tests/"}},
        {"OpenEXR/", {"formats/", "tests/"}},
        {"Imf", {"formats/", "tests/"}},
        {"embree", {"stages/core/scene/embree.cpp", "tests/bench/"}},
        {"CLI/", {"stages/core/app/"}},
        {"flann/", {"stages/cluster/", "stages/refine/"}},
        {"spdlog/", {"stages/core/app/"}},
        {"pugixml", {"stages/core/scene/"}},
        {"gtest/", {"tests/"}},
    };
    for (const Include& i : includes()) {
        if (i.quoted) continue;
        for (const Rule& rule : rules) {
            if (!i.name.starts_with(rule.header)) continue;
            bool allowed = false;
            for (const std::string& place : rule.in) allowed |= i.file.starts_with(place);
            EXPECT_TRUE(allowed) << i.file << ":" << i.line << ": <" << i.name << "> does not belong here";
        }
    }
}

TEST(Arrows, core_has_no_main) {
    const std::regex pattern(R"(^int main\s*\()");
    for (const auto& entry : fs::recursive_directory_iterator(fs::path(LOOM_SOURCE_DIR) / "stages" / "core")) {
        if (entry.path().extension() != ".cpp") continue;
        std::ifstream in(entry.path());
        for (std::string line; std::getline(in, line);) EXPECT_FALSE(std::regex_search(line, pattern)) << entry.path();
    }
}

}  // namespace
