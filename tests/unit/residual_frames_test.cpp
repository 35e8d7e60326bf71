// Frames of an animation by loom-residual: each is the image of its scene with the graph's samples, and has the same bytes
// alone, among others, and with any number of threads.
#include <algorithm>

#include "formats/io/mapped_file.h"
#include "stages/trace/trace.h"
#include "tests/unit/frames_folder.h"

namespace loom {
namespace {

constexpr const char* scene_text =
    R"(<scene version="3.0.0"><default name="x" value="0"/><default name="paint" value="0.5"/>
<default name="power" value="9"/><default name="at" value="0"/>
<integrator type="path"><integer name="max_depth" value="5"/></integrator>
<sensor type="perspective"><float name="fov" value="40"/><transform name="to_world"><lookat origin="0,-4,1.6" target="0,0,.7" up="0,0,1"/></transform>
<film type="hdrfilm"><integer name="width" value="12"/><integer name="height" value="12"/><rfilter type="box"/></film></sensor>
<shape type="rectangle"><transform name="to_world"><scale value="2"/></transform></shape>
<shape type="sphere" id="ball"><float name="radius" value=".3"/><point name="center" x="$x" y="0" z=".4"/></shape>
<shape type="cube" id="box"><transform name="to_world"><scale value=".2"/><translate x=".9" y=".3" z=".3"/></transform><bsdf type="diffuse"><rgb name="reflectance" value="$paint, 0.5, 0.5"/></bsdf></shape>
<shape type="rectangle" id="lamp"><transform name="to_world"><scale value=".4"/><rotate x="1" angle="180"/><translate x="$at" z="2.6"/></transform><emitter type="area"><rgb name="radiance" value="$power, 9, 9"/></emitter></shape>
</scene>)";

class ResidualFrames : public testing::FramesFolder {
  protected:
    app::Report tracer{"loom-trace"};

    ResidualFrames() : FramesFolder(scene_text, "loom-residual s.xml --frames f.tsv --old static.exr") {
        tracer.set_quiet(true);
        tracer.set_command("loom-trace s.xml --spp 8 --first-sample 0");
    }

    void trace(const std::string& output, const std::string& frames, const std::vector<std::string>& defines = {},
               std::uint64_t seed = 0) {
        trace::Options options;
        options.seed = seed;
        options.scene = at("s.xml");
        options.output = at(output);
        options.static_frames = frames.empty() ? "" : at(frames);
        options.defines = defines;
        options.spp = 8;
        options.seed = seed;
        trace::run(options, tracer);
    }
    residual::Options options(const std::string& prefix) const {
        residual::Options options;
        options.old_scene = at("s.xml");
        options.frames = at("f.tsv");
        options.old_picture = at("static.exr");
        options.old_graph = {at("g.h5")};
        options.output = at(prefix + "residual-%.exr");
        options.new_picture = at(prefix + "new-%.exr");
        return options;
    }
};

// The ball, the box's paint and the emitter change, which stays in the static scene as the first row has it.
TEST_F(ResidualFrames, AreImagesOfTheirScenes) {
    write("f.tsv",
          "frame\tx\tpaint\tpower\tat\n3\t-0.7\t.5\t9\t0\n4\t0\t.5\t9\t0\n10\t.5\t.8\t5\t0\n11\t.5\t.8\t5\t.6\n");
    trace("static.exr", "f.tsv");
    trace("g.h5", "f.tsv");
    residual::run(options(""), report);
    const std::vector<std::pair<std::string, std::vector<std::string>>> frames = {
        {"new-0003.exr", {"x=-0.7"}},
        {"new-0004.exr", {}},
        {"new-0010.exr", {"x=.5", "paint=.8", "power=5"}},
        {"new-0011.exr", {"x=.5", "paint=.8", "power=5", "at=.6"}}};
    const Image base = read_image(at("static.exr"));
    for (const auto& [name, defines] : frames) {
        trace("fresh.exr", "", defines);
        const Image ours = read_image(at(name)), fresh = read_image(at("fresh.exr"));
        double difference = 0, moved = 0;
        for (const char* c : {"R", "G", "B"}) {
            const auto a = ours.find(c), b = fresh.find(c), old = base.find(c);
            ASSERT_EQ(a.size(), b.size());
            for (std::size_t i = 0; i < a.size(); ++i) {
                difference = std::max(difference, std::abs(double(a[i]) - b[i]));
                moved = std::max(moved, std::abs(double(a[i]) - old[i]));
            }
        }
        EXPECT_LT(difference, 1e-5) << name;
        EXPECT_GT(moved, 0.1) << name;
    }
}

// The same where every path is followed again.
TEST_F(ResidualFrames, OfAMovedEmitterHaveTheSameBytesAloneAndAmongOthers) {
    write("f.tsv", "frame\tat\tx\n3\t0\t0\n4\t.5\t.1\n10\t.2\t.5\n11\t-.2\t.5\n");
    trace("static.exr", "f.tsv");
    trace("g.h5", "f.tsv", {}, 1);
    residual::run(options("all-"), report);
    for (const char* number : {"4", "10"}) {
        residual::Options one = options("one-");
        one.only = fmt::format("{}:{}", number, std::stoi(number) + 1);
        one.threads = 1;
        residual::run(one, report);
        for (const char* of : {"new", "residual"}) {
            const auto image = [&](const char* who) {
                return read_image(at(fmt::format("{}-{}-{:04}.exr", who, of, std::stoi(number))));
            };
            const Image a = image("all"), b = image("one");
            for (const char* c : {"R", "G", "B", "VarMean.R", "VarMean.G", "VarMean.B", "N.X"})
                EXPECT_TRUE(std::ranges::equal(a.find(c), b.find(c))) << number << of << c;
        }
    }
}

TEST_F(ResidualFrames, HaveTheSameBytesAloneAndAmongOthers) {
    write("f.tsv", "frame\tx\n3\t-0.7\n4\t0\n10\t.5\n");
    trace("static.exr", "f.tsv");
    trace("g.h5", "f.tsv");
    residual::run(options("all-"), report);
    residual::Options one = options("one-");
    one.only = "4:10";
    one.threads = 1;
    report.set_command("loom-residual s.xml --frames f.tsv --only 4:10 --old static.exr");
    residual::run(one, report);
    EXPECT_FALSE(std::filesystem::exists(at("one-new-0003.exr")));
    EXPECT_FALSE(std::filesystem::exists(at("one-new-0010.exr")));
    ASSERT_FALSE(bytes("all-new-0004.exr").empty());
    EXPECT_EQ(bytes("one-new-0004.exr"), bytes("all-new-0004.exr"));
    EXPECT_EQ(bytes("one-residual-0004.exr"), bytes("all-residual-0004.exr"));
    // Without an image of the static scene.
    const auto residual_alone = [&](const std::string& prefix, const std::string& only, const std::string& command) {
        residual::Options of_residual = options(prefix);
        of_residual.old_picture = of_residual.new_picture = "";
        of_residual.only = only;
        report.set_command("loom-residual s.xml --frames f.tsv " + command + "--old-graph g.h5");
        residual::run(of_residual, report);
    };
    residual_alone("all-bare-", "", "");
    residual_alone("one-bare-", "4:10", "--only 4:10 ");
    EXPECT_EQ(bytes("one-bare-residual-0004.exr"), bytes("all-bare-residual-0004.exr"));
    // Rows before and after, in any order.
    report.set_command("loom-residual s.xml --frames f.tsv --old static.exr");
    write("f.tsv", "frame\tx\n12\t.1\n4\t0\n2\t.2\n3\t-0.7\n");
    residual::run(options("more-"), report);
    EXPECT_EQ(bytes("more-new-0004.exr"), bytes("all-new-0004.exr"));
}

// Pairs on top of the graph, and alone: a frame has a map of its own.
TEST_F(ResidualFrames, HaveTheSameBytesWithAdaptivePairs) {
    write("f.tsv", "frame\tx\n3\t-0.7\n4\t0\n10\t.5\n");
    trace("static.exr", "f.tsv");
    trace("g.h5", "f.tsv", {}, 1);
    for (const bool has_graph : {true, false}) {
        const auto run = [&](const std::string& prefix, const std::string& only, int threads) {
            residual::Options adaptive = options(prefix);
            if (!has_graph) adaptive.old_graph.clear();
            adaptive.extra = 0.7;
            adaptive.only = only;
            adaptive.threads = threads;
            report.set_command("loom-residual s.xml --frames f.tsv" + (only.empty() ? "" : " --only " + only) +
                               " --old static.exr --extra 0.7");
            residual::run(adaptive, report);
        };
        run("all-", "", 2);
        run("one-", "4:10", 1);
        EXPECT_EQ(bytes("one-new-0004.exr"), bytes("all-new-0004.exr"));
        EXPECT_EQ(bytes("one-residual-0004.exr"), bytes("all-residual-0004.exr"));
        const Image residual = read_image(at("one-residual-0004.exr"));
        EXPECT_EQ(residual.samples, has_graph ? 8u : 1u);
        const auto green = residual.find("G");
        EXPECT_GT(std::count_if(green.begin(), green.end(), [](float g) { return g != 0; }), 5);
    }
    residual::Options bad = options("");
    bad.extra = 1;
    trace("static.exr", "f.tsv", {}, 1);
    EXPECT_NE(error(bad).find("has the samples of the graph, to which --extra adds others"), std::string::npos);
    bad.parts = true;
    EXPECT_NE(error(bad).find("leave out --parts"), std::string::npos);
    bad.parts = false;
    bad.method = residual::Method::independent;
    bad.old_graph.clear();
    EXPECT_NE(error(bad).find("same random numbers in both scenes"), std::string::npos);
}

TEST_F(ResidualFrames, ErrorsSayWhatIsWrong) {
    write("f.tsv", "frame\tx\n3\t-0.7\n4\t0\n");
    trace("static.exr", "f.tsv");
    trace("g.h5", "f.tsv");
    residual::Options bad = options("");
    bad.output = at("residual.exr");
    EXPECT_NE(error(bad).find("needs a % for the number of the frame"), std::string::npos);
    bad = options("");
    bad.new_defines = {"x=1"};
    EXPECT_NE(error(bad).find("its rows are the new scenes"), std::string::npos);
    for (const char* only : {"4", "4:", ":4", "5:4", "4:4", "a:b", "-1:3"}) {
        bad = options("");
        bad.only = only;
        EXPECT_NE(error(bad).find("expected FIRST:END"), std::string::npos) << only;
    }
    bad.only = "20:30";
    EXPECT_NE(error(bad).find("has no frame with such a number"), std::string::npos);
    bad = options("");
    bad.frames.clear();
    bad.only = "3:4";
    EXPECT_NE(error(bad).find("--only: needs --frames"), std::string::npos);
    // Another static scene than that of image and graph.
    write("f.tsv", "frame\tx\tpaint\n3\t-0.7\t.1\n4\t0\t.2\n");
    EXPECT_NE(error(options("")).find("is an image of"), std::string::npos);
}

}  // namespace
}  // namespace loom
