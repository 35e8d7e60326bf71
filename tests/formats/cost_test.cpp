#include "formats/io/cost.h"

#include <gtest/gtest.h>

#include <nlohmann/json.hpp>

#include "formats/io/json.h"
#include "tests/formats/tiny_graph.h"

namespace loom {
namespace {

using testing::file_bytes;
using testing::input_error_of;
using testing::ScratchFolder;
using testing::write_bytes;

Cost some_cost() {
    return {"loom-trace",
            1.25,
            2.4999999999999996,
            0xffffffffffffffffu,
            921600,
            123456789,
            5,
            {"a \"b\"\\\n\x01.exr", "../c.h5"},
            {"scene.xml"},
            0.125,
            "loom-trace scene.xml --spp 4",
            "on: all; off: nothing"};
}

TEST(Cost, ReadsBack) {
    const ScratchFolder folder;
    write_cost(some_cost(), folder / "x.h5");
    EXPECT_TRUE(std::filesystem::exists(folder / "x.h5.cost.json"));
    EXPECT_EQ(read_cost(folder / "x.h5"), some_cost());
}

// A base name alone would lose parents in another folder, such as the passes of an image.
TEST(Cost, ParentsAreFoundFromTheFolderOfTheOutput) {
    EXPECT_EQ(parent_of("out/image.exr", "out/pt/pass-0.exr"), "pt/pass-0.exr");
    EXPECT_EQ(parent_of("out/image.exr", "out/graph.h5"), "graph.h5");
    EXPECT_EQ(parent_of("image.exr", "./graph.h5"), "graph.h5");
    EXPECT_EQ(parent_of("out/x/../image.exr", "old/image.exr"), "../old/image.exr");
    EXPECT_EQ(parent_of("/a/b/image.exr", "/a/c/graph.h5"), "../c/graph.h5");
}

TEST(Cost, NoParents) {
    const ScratchFolder folder;
    write_cost({}, folder / "x.h5");
    EXPECT_EQ(read_cost(folder / "x.h5"), Cost{});
}

// Files from before a cost named its command and plan.
TEST(Cost, CommandAndPlanMayBeMissing) {
    const ScratchFolder folder;
    write_bytes(
        cost_path(folder / "x.h5"),
        "{\"stage\": \"s\", \"wall_s\": 1, \"cpu_s\": 2, \"rays\": 3, \"samples\": 4, \"peak_memory_bytes\": 5, "
        "\"bytes_written\": 6, \"parents\": [], \"sources\": []}");
    const Cost cost = read_cost(folder / "x.h5");
    EXPECT_EQ(cost.bytes_written, 6u);
    EXPECT_EQ(cost.command + cost.plan, "");
}

TEST(Cost, BadFilesSayWhatIsWrong) {
    const ScratchFolder folder;
    const auto file = cost_path(folder / "x.h5");
    const auto message = [&] { return input_error_of([&] { read_cost(folder / "x.h5"); }); };
    EXPECT_EQ(message(), file.native() + ": no such file");
    write_bytes(file, "{\n\"stage\": \"x\",\n");
    EXPECT_EQ(message(), file.native() +
                             ":3: syntax error while parsing object key - unexpected end of input; "
                             "expected string literal");
    write_bytes(file, "{\"stage\": 3}");
    EXPECT_EQ(message(), file.native() + ": \"stage\" is missing or of another type");
    write_bytes(file, "{\"stage\": \"x\", \"wall_s\": 1, \"cpu_s\": 1, \"rays\": -1}");
    EXPECT_EQ(message(), file.native() + ": \"rays\" is -1, which is no such number");
    write_bytes(file, "{\"stage\": \"x\", \"wall_s\": 1e999}");
    EXPECT_EQ(message(), file.native() + ": number overflow parsing '1e999'");
    write_bytes(file, "{\n\"stage\": \"\xe9\"}");
    EXPECT_NE(message().find(file.native() + ":2: "), std::string::npos) << message();
    write_bytes(file, "[]");
    EXPECT_EQ(message(), file.native() + ": \"stage\" is missing or of another type");
}

// Names of files are bytes, JSON is UTF-8: what is none is replaced, so that the rest can be read.
TEST(Cost, BytesThatAreNoUtf8AreReplaced) {
    const ScratchFolder folder;
    Cost cost = some_cost();
    cost.command = "loom-trace caf\xe9.xml";
    cost.parents = {"caf\xc3\xa9.h5", "\xff"};
    write_cost(cost, folder / "x.h5");
    const Cost back = read_cost(folder / "x.h5");
    EXPECT_EQ(back.command, "loom-trace caf\xef\xbf\xbd.xml");
    EXPECT_EQ(back.parents, (std::vector<std::string>{"caf\xc3\xa9.h5", "\xef\xbf\xbd"}));
}

TEST(Json, TruncatedAnywhere) {
    const ScratchFolder folder;
    write_cost(some_cost(), folder / "x.h5");
    const std::string whole = file_bytes(cost_path(folder / "x.h5"));
    for (std::size_t n = 0; n + 2 < whole.size(); ++n) {
        EXPECT_NE(input_error_of([&] { parse_json(std::string_view(whole).substr(0, n), "x"); }), "nothing was thrown");
    }
}

TEST(Json, TooDeep) {
    const auto nested = [](std::size_t n) { return std::string(n, '[') + std::string(n, ']'); };
    const auto message = [](const std::string& text) { return input_error_of([&] { parse_json(text, "x"); }); };
    EXPECT_EQ(message(nested(64)), "nothing was thrown");
    EXPECT_EQ(message(nested(100'000)), "x: nested deeper than 64");
    EXPECT_EQ(message(std::string(1'000'000, '[')), "x: nested deeper than 64");
}

// The text on disk: order, indents, escapes, and the fewest digits that read back.
TEST(Json, TextAsWritten) {
    JsonWriter json;
    json.begin_object();
    json.text("text", "a \"b\"\\\n\t\x01");
    json.number("whole", 2);
    json.number("third", 1 / 3.0);
    json.number("large", 1e300);
    json.number("nan", NAN);
    json.integer("integer", 0xffffffffffffffffu);
    json.begin_array("none");
    json.end_array();
    json.begin_array("list");
    json.text({}, "x");
    json.begin_object();
    json.end_object();
    json.end_array();
    json.end_object();
    EXPECT_EQ(json.str(), R"({
  "text": "a \"b\"\\\n\t\u0001",
  "whole": 2,
  "third": 0.3333333333333333,
  "large": 1e+300,
  "nan": null,
  "integer": 18446744073709551615,
  "none": [],
  "list": [
    "x",
    {}
  ]
}
)");
}

}  // namespace
}  // namespace loom
