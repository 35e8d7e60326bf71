// Texts for users use the terms of the field: no word of the list below is in a string literal of more than one word
// (help, errors, warnings, plan lines, descriptions of datasets), in what make prints, or in the page of loom-report.
//
// Detected mutations: "picture" in an option of loom-trace, in an error of loom-merge and in the `## ` text of a
// variable.

#include <fmt/format.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <regex>
#include <sstream>
#include <string>
#include <vector>

namespace {

namespace fs = std::filesystem;

struct Text {
    std::string text;
    std::string where;  // file:line
};

// Word: what to write instead.
const std::vector<std::pair<const char*, const char*>> words{
    {"pictures?", "image"},
    {"around (a|the) corner", "NLOS capture"},
    {"matte", "diffuse"},
    {"light in flight", "transient"},
    {"lamps?", "emitter"},
    {"shines?", "emits"},
    {"darkness", "zero"},
    {"legs?", "segment"},
    {"dyed", "tint, albedo"},
    {"seen|unseen", "visible, occluded"},
    {"meets?|met", "hits, hit"},
    {"asks?|asked", "requires, queries; requested"},
    {"knows?", "has, stores"},
    {"tells?|told", "reports, names"},
    {"is said|are said|says nothing", "is stored, is reported"},
    {"(is|are) worth", "contributes"},
    {"by word|in words", "as text"},
    {"fresh memory", "first-touched pages"},
    {"absurd", "impossible"},
};

// Texts that no user reads, each with its reason.
const std::vector<std::pair<const char*, const char*>> exceptions{
    {"[picture in 'svg png']", "a variable of gnuplot scripts, whose bytes are an output"},
    {"data-picture", "an attribute of elements of the report"},
};

std::string content(const fs::path& path) {
    std::ifstream in(path, std::ios::binary);
    return {std::istreambuf_iterator<char>(in), {}};
}

/// String literals of C++ source, adjacent ones joined, without those in comments.
std::vector<Text> literals(const std::string& source, const std::string& name) {
    std::vector<Text> found;
    bool joins = false;  // only blanks since the last literal
    int line = 1;
    const auto skip_to = [&](std::size_t& i, std::size_t end) {
        line += int(std::count(source.begin() + long(i), source.begin() + long(end), '\n'));
        i = end;
    };
    for (std::size_t i = 0; i < source.size();) {
        const char c = source[i];
        if (source.compare(i, 2, "//") == 0) {
            skip_to(i, std::min(source.find('\n', i), source.size()));
        } else if (source.compare(i, 2, "R\"") == 0) {
            const std::size_t open = source.find('(', i);
            const std::string close = fmt::format("){}\"", source.substr(i + 2, open - i - 2));
            const std::size_t end = source.find(close, open);
            found.push_back({source.substr(open + 1, end - open - 1), name + ":" + std::to_string(line)});
            skip_to(i, end + close.size());
            joins = false;
        } else if (c == '"' || (c == '\'' && (i == 0 || !std::isalnum(static_cast<unsigned char>(source[i - 1]))))) {
            std::size_t end = i + 1;
            while (source[end] != c) end += source[end] == '\\' ? 2 : 1;
            if (c == '"' && joins)
                found.back().text += source.substr(i + 1, end - i - 1);
            else if (c == '"')
                found.push_back({source.substr(i + 1, end - i - 1), name + ":" + std::to_string(line)});
            joins = c == '"';
            i = end + 1;
        } else {
            if (c == '\n') ++line;
            if (!std::isspace(static_cast<unsigned char>(c))) joins = false;
            ++i;
        }
    }
    return found;
}

/// Returns the texts that make prints: `## ` texts, errors and notes.
std::vector<Text> printed_by_make(const std::string& makefile, const std::string& name) {
    std::vector<Text> found;
    std::istringstream lines(makefile);
    int number = 0;
    for (std::string line; std::getline(lines, line);) {
        ++number;
        for (const char* mark : {"## ", "$(error ", "$(info ", "$(call refuse", "echo ", "wrong_"})
            if (const std::size_t at = line.find(mark); at != std::string::npos) {
                found.push_back({line.substr(at), name + ":" + std::to_string(number)});
                break;
            }
    }
    return found;
}

std::vector<Text> texts_of_users() {
    const fs::path root = LOOM_SOURCE_DIR;
    std::vector<Text> found;
    const auto add = [&](std::vector<Text> more) { std::move(more.begin(), more.end(), std::back_inserter(found)); };
    for (const char* top : {"stages", "formats"})
        for (const auto& entry : fs::recursive_directory_iterator(root / top)) {
            const std::string name = fs::relative(entry.path(), root).string();
            const std::string ending = entry.path().extension().string();
            if (ending == ".cpp" || ending == ".h") add(literals(content(entry.path()), name));
            if (ending == ".html") add({{content(entry.path()), name}});
        }
    for (const auto& entry : fs::directory_iterator(root / "pipelines"))
        if (entry.path().extension() == ".mk")
            add(printed_by_make(content(entry.path()), "pipelines/" + entry.path().filename().string()));
    add(printed_by_make(content(root / "Makefile"), "Makefile"));
    return found;
}

TEST(Words, texts_of_users_use_the_terms_of_the_field) {
    std::vector<Text> texts = texts_of_users();
    ASSERT_GT(texts.size(), 2000u);
    std::erase_if(texts, [](const Text& text) {
        return text.text.find(' ') == std::string::npos ||  // a name
               std::any_of(exceptions.begin(), exceptions.end(),
                           [&](const auto& exception) { return text.text.find(exception.first) != std::string::npos; });
    });
    for (const auto& [word, instead] : words) {
        const std::regex pattern("\\b(" + std::string(word) + ")\\b", std::regex::icase);
        for (const Text& text : texts) {
            std::smatch match;
            EXPECT_FALSE(std::regex_search(text.text, match, pattern))
                << text.where << ": \"" << match.str() << "\", write: " << instead << "\n"
                << text.text.substr(0, 300);
        }
    }
}

// Escapes, raw strings, digit separators and comments do not hide or make a literal.
TEST(Words, literals_are_found) {
    const std::vector<Text> found =
        literals("f(\"a \\\"b\\\" \" // \"no\"\n  \"c\", '\"', 1'000, R\"x(raw \"d\")x\", \"e\");", "file");
    ASSERT_EQ(found.size(), 3u);
    EXPECT_EQ(found[0].text, "a \\\"b\\\" c");
    EXPECT_EQ(found[1].text, "raw \"d\"");
    EXPECT_EQ(found[2].text, "e");
    EXPECT_EQ(found[2].where, "file:2");
}

}  // namespace
