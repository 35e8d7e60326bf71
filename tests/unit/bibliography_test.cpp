// A docstring's source key must be in the bibliography.

#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <iterator>
#include <regex>
#include <set>
#include <string>

namespace {

namespace fs = std::filesystem;

std::string text_of(const fs::path& path) {
    std::ifstream in(path);
    return {std::istreambuf_iterator<char>(in), {}};
}

TEST(Bibliography, every_key_in_the_code_is_listed) {
    const fs::path root = LOOM_SOURCE_DIR;
    const std::string bibliography = text_of(root / "stages/BIBLIOGRAPHY.md");
    // [Walter2007], [Key2010a], and the methods' own [PG] Eq. / [PG] §
    const std::regex key(R"(\[([A-Za-z]+[0-9]{4}[a-z]?|[A-Z]{2}(?=\] (?:Eq|§|eq))|NumericalRecipes)\])");
    std::set<std::string> found;
    for (const char* top : {"stages", "formats", "tests"}) {
        for (const auto& entry : fs::recursive_directory_iterator(root / top)) {
            const std::string ending = entry.path().extension().string();
            if (ending != ".h" && ending != ".inl" && ending != ".cpp") continue;
            if (entry.path().filename() == "bibliography_test.cpp") continue;
            const std::string text = text_of(entry.path());
            for (std::sregex_iterator at(text.begin(), text.end(), key), end; at != end; ++at) {
                found.insert((*at)[1]);
                EXPECT_NE(bibliography.find("| " + (*at)[1].str() + " |"), std::string::npos)
                    << fs::relative(entry.path(), root) << ": " << at->str() << " is not in BIBLIOGRAPHY.md";
            }
        }
    }
    EXPECT_GT(found.size(), 10u);
}

}  // namespace
