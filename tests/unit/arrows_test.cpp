// The architecture as a test: every #include of the project follows an arrow of arrows(), and docs/rooms.md lists the
// rooms with their arrows, floor by floor.
//
// Detected: a stage that includes another (stages share files only), a room that includes one above it, a format that
// includes a BSDF, HDF5 or OpenEXR outside of formats, Embree outside of its one file.

#include <gtest/gtest.h>

#include <algorithm>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <functional>
#include <map>
#include <regex>
#include <set>
#include <sstream>
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

/// "formats/io", "core/math", "stages/trace", "stages/residual/stored", "tests": where a path from the root lives.
std::string room_of(const std::string& path) {
    if (path.starts_with("tests/")) return "tests";
    std::string folder = fs::path(path).parent_path().string();
    for (const char* inner : {"/levels", "/decoder"})  // parts of the room around them
        if (folder.ends_with(inner)) folder.resize(folder.size() - std::string(inner).size());
    return folder.starts_with("stages/core/") ? folder.substr(std::string("stages/").size()) : folder;
}

using Arrows = std::map<std::string, std::set<std::string>>;

/// The rooms that a room may include besides itself. A stage may include all of formats and core, and the rooms in it.
const Arrows& arrows() {
    static const Arrows allowed = [] {
        Arrows a = {
            {"formats/io", {}},
            {"formats", {}},
            {"core/math", {}},
            {"core/neural", {}},
            {"core/compute", {}},
            {"core/stats", {"core/math"}},
            {"core/app", {}},
            {"core/table", {}},
            {"core/plot", {"core/math"}},
            {"core/sampling", {"core/math"}},
            {"core/scattering", {"core/sampling"}},
            {"core/description", {"core/math"}},
            {"core/assets", {"core/description"}},
            {"core/sky", {"core/description", "core/sampling"}},
            {"core/scene", {"core/assets", "core/sky", "core/scattering", "core/compute"}},
            {"core/tracing", {"core/scene", "core/stats", "core/app"}},
            {"core/graph", {"core/scene"}},
            {"core/clusters", {"core/graph"}},
            {"core/cache", {"core/scene", "core/neural"}},
            {"core/edges", {"core/scene"}},
            {"core/edit", {"core/scene", "core/table"}},
            {"stages/residual/control", {"core/edit"}},
            {"stages/residual/stored", {"core/tracing", "core/graph", "stages/residual/control"}},
            {"stages/residual/dynamic", {"core/tracing", "core/edit"}},
            {"stages/residual/effort", {"stages/residual/dynamic", "stages/residual/control"}},
        };
        for (auto& [room, below] : a)
            if (room.find('/') != std::string::npos && !room.starts_with("formats")) below.insert("formats");
        a["formats"] = {"formats/io"};
        // A room may also include another through a third.
        for (std::size_t pass = 0; pass < a.size(); ++pass)
            for (auto& [room, below] : a)
                for (const std::string& other : std::set<std::string>(below))
                    below.insert(a.at(other).begin(), a.at(other).end());
        return a;
    }();
    return allowed;
}

/// A stage's own folder, above the rooms in it.
bool is_stage(const std::string& room) {
    return room.starts_with("stages/") && !arrows().contains(room);
}

bool may_include(const std::string& from, const std::string& to) {
    if (from == to || from == "tests") return true;
    if (is_stage(from)) return to.starts_with("core/") || to.starts_with("formats") || to.starts_with(from + "/");
    return arrows().contains(from) && arrows().at(from).contains(to);
}

/// Who includes whom, without what is reached through another.
Arrows seen_arrows() {
    Arrows seen;
    for (const Include& i : includes()) {
        if (!i.quoted || is_generated(i.name) || i.file.starts_with("tests/")) continue;
        seen[room_of(i.file)];
        seen[room_of(i.name)];
        if (room_of(i.file) != room_of(i.name)) seen[room_of(i.file)].insert(room_of(i.name));
    }
    return seen;
}

/// Longest way down, in arrows. A loop of rooms has no floor: it ends at a height that no house has.
std::size_t floor_of(const std::string& room, const Arrows& seen, std::size_t height = 0) {
    std::size_t floor = 0;
    if (height > seen.size()) return floor;
    for (const std::string& below : seen.at(room)) floor = std::max(floor, floor_of(below, seen, height + 1) + 1);
    return floor;
}

/// Whether `to` is reached from `from` through another room.
bool through_another(const std::string& from, const std::string& to, const Arrows& seen) {
    for (const std::string& other : seen.at(from))
        if (other != to && (seen.at(other).contains(to) || through_another(other, to, seen))) return true;
    return false;
}

std::string drawing() {
    const Arrows seen = seen_arrows();
    std::map<std::size_t, std::string, std::greater<>> floors;
    for (const auto& [room, below] : seen) {
        std::string uses;
        for (const std::string& other : below)
            if (!through_another(room, other, seen)) uses += (uses.empty() ? " → " : ", ") + other;
        floors[floor_of(room, seen)] += "| | " + room + uses + " |\n";
    }
    std::string text =
        "# Rooms\n\nWho includes whom, as the sources have it, without what is reached through another room. No arrow "
        "goes up: a floor is the longest way down. Drawn and checked by `tests/unit/arrows_test.cpp`; after a change "
        "`LOOM_DRAW=1 build/test_unit --gtest_filter='Arrows.*'` draws it anew.\n\n| floor | room → rooms "
        "|\n|---|---|\n";
    for (const auto& [floor, rooms] : floors) text += "| " + std::to_string(floor) + rooms.substr(1);
    return text;
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
        EXPECT_TRUE(may_include(from, to))
            << i.file << ":" << i.line << ": " << from << " must not include " << i.name << " (" << to << ")";
    }
}

TEST(Arrows, drawing_is_up_to_date) {
    const fs::path file = fs::path(LOOM_SOURCE_DIR) / "docs" / "rooms.md";
    if (std::getenv("LOOM_DRAW")) std::ofstream(file) << drawing();
    std::stringstream text;
    text << std::ifstream(file).rdbuf();
    EXPECT_EQ(text.str(), drawing()) << "LOOM_DRAW=1 draws it anew";
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
        {"xxhash", {"formats/io/content_hash.cpp"}},
        {"nlohmann/", {"formats/", "tests/"}},
        {"boost/", {"stages/core/stats/special_functions.cpp"}},
        {"CLI/", {"stages/core/app/"}},
        {"flann/", {"stages/cluster/", "stages/core/cache/", "stages/refine/"}},
        {"spdlog/", {"stages/core/app/"}},
        {"pugixml", {"stages/core/description/"}},
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
