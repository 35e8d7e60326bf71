// `make edit`: the image of an edited scene from the image of the old scene, which edits share; and loom-residual's
// command line.

#include "formats/image.h"
#include "tests/pipeline/process.h"

namespace loom::pipeline {
namespace {

class MakeEdit : public PipelineTest {
  protected:
    std::string edit(const std::string& out, const std::string& variables) const {
        return "make -s edit BUILD='" + fs::path(LOOM_BIN_DIR).parent_path().string() +
               "' DEFINES='resx=24 resy=16' SPP=2 BASE_SPP=4 OUT=" + (folder / out).string() +
               " BASE=" + (folder / "base").string() + " " + variables;
    }
    std::string made(const std::string& out, const std::string& variables) const {
        const Outcome outcome = sh(edit(out, variables));
        EXPECT_EQ(outcome.code, 0) << outcome.err;
        EXPECT_EQ(outcome.out, (folder / out / "new.exr").string() + "\n");
        return bytes_of(folder / out / "new.exr");
    }
    std::string in(const std::string& name) const { return (folder / name).string(); }
    void expect_refused(const std::string& arguments, const std::string& message) const {
        const std::vector<std::string> before = files();
        const Outcome outcome = sh(stage("residual") + " " + arguments);
        EXPECT_EQ(outcome.code, 2) << arguments;
        EXPECT_NE(outcome.err.find(message), std::string::npos) << arguments << "\n" << outcome.err;
        EXPECT_EQ(outcome.out, "");
        EXPECT_EQ(files(), before) << arguments;
    }
};

TEST_F(MakeEdit, edits_share_the_picture_before) {
    const std::string light = "NEW_DEFINES=light=20,10,5";
    const std::string first = made("a", light);
    const auto base_time = fs::last_write_time(folder / "base/old.exr"),
               new_time = fs::last_write_time(folder / "a/new.exr");
    for (const char* file : {"a/residual.exr", "a/residual.png", "a/new.png", "a/new.exr.cost.json"})
        EXPECT_TRUE(fs::exists(folder / file)) << file;
    EXPECT_TRUE(first == made("a", light + " THREADS=1"));
    EXPECT_EQ(fs::last_write_time(folder / "a/new.exr"), new_time);
    // A second edit of the same scene, and the first with more samples.
    made("b", "NEW_DEFINES=light=3");
    EXPECT_FALSE(first == made("a", light + " SPP=3"));
    EXPECT_EQ(fs::last_write_time(folder / "base/old.exr"), base_time);
    EXPECT_FALSE(first == made("a", light + " METHOD=independent"));
    EXPECT_TRUE(first == made("a", light));
    // A change of the base's settings makes it again.
    made("a", light + " BASE_SPP=5");
    EXPECT_NE(fs::last_write_time(folder / "base/old.exr"), base_time);

    const Image before = read_image(folder / "base/old.exr"), residual = read_image(folder / "a/residual.exr"),
                sum = read_image(folder / "a/new.exr");
    EXPECT_EQ(sum.samples, before.samples + residual.samples);
    for (const char* channel : {"R", "G", "B", "VarMean.R", "VarMean.G", "VarMean.B"})
        for (std::size_t i = 0; i < sum.n_pixels(); ++i)
            EXPECT_EQ(sum.find(channel)[i], before.find(channel)[i] + residual.find(channel)[i]) << channel;
}

// The variance of a denoised residual is unknown. So is that of the sum, to which no edit can be added.
TEST_F(MakeEdit, of_a_denoised_residual) {
    const std::string light = "SPP=8 METHOD=correlated NEW_DEFINES=light=20,10,5";
    const std::string noisy = made("a", light);
    for (const char* method : {"", " GRAPH=1", " METHOD=graph PASSES=2"}) {
        SCOPED_TRACE(method);
        const std::string first = made("a", light + method), clean = made("d", light + method + " DENOISE=1");
        EXPECT_FALSE(first == clean);
        EXPECT_TRUE(clean == made("d", light + method + " DENOISE=1 THREADS=1"));
        const Image before = read_image(folder / "base/old.exr"), found = read_image(folder / "a/residual.exr"),
                    kept = read_image(folder / "d/noisy.exr"), residual = read_image(folder / "d/residual.exr"),
                    sum = read_image(folder / "d/new.exr");
        EXPECT_TRUE(sum.find("VarMean.R").empty());
        EXPECT_TRUE(sum.ledger.empty());
        EXPECT_EQ(sum.scene, read_image(folder / "a/new.exr").scene);
        double changed = 0;
        for (const char* c : {"R", "G", "B"})
            for (std::size_t i = 0; i < sum.n_pixels(); ++i) {
                EXPECT_EQ(kept.find(c)[i], found.find(c)[i]);
                EXPECT_EQ(sum.find(c)[i], before.find(c)[i] + residual.find(c)[i]);
                changed += std::abs(residual.find(c)[i] - kept.find(c)[i]);
            }
        EXPECT_GT(changed, 0);
    }
    EXPECT_TRUE(noisy == made("a", light));  // whatever was made there in between
    const Outcome chained = sh(edit("e", light + " OLD_IMAGE=" + in("d/new.exr")));
    EXPECT_NE(chained.code, 0);
    EXPECT_NE(chained.err.find("has no variance"), std::string::npos) << chained.err;
}

// The difference of path graphs: old + residual, its passes made once, the graphs gone; the same scene is 0.
TEST_F(MakeEdit, by_path_graphs) {
    const std::string light = "METHOD=graph PASSES=4 NEW_DEFINES=light=20,10,5";
    const std::string first = made("g", light);
    const auto passes_time = fs::last_write_time(folder / "g/graph/new-0.exr");
    EXPECT_TRUE(first == made("g", light + " THREADS=1"));
    for (const char* file : {"g/residual.exr", "g/residual.png", "g/new.png", "g/new.exr.cost.json"})
        EXPECT_TRUE(fs::exists(folder / file)) << file;
    for (const auto& file : files()) EXPECT_FALSE(file.ends_with(".h5")) << file;
    const Image before = read_image(folder / "base/old.exr"), residual = read_image(folder / "g/residual.exr"),
                sum = read_image(folder / "g/new.exr");
    EXPECT_EQ(residual.samples, 8u);
    EXPECT_FALSE(residual.find("Blend.Path").empty());
    for (const char* channel : {"R", "G", "B", "VarMean.R"})
        for (std::size_t i = 0; i < sum.n_pixels(); ++i)
            EXPECT_EQ(sum.find(channel)[i], before.find(channel)[i] + residual.find(channel)[i]) << channel;
    // Another way to merge them makes no pass anew.
    EXPECT_FALSE(first == made("g", light + " UNBIASED=1"));
    EXPECT_EQ(fs::last_write_time(folder / "g/graph/new-0.exr"), passes_time);
    EXPECT_TRUE(read_image(folder / "g/residual.exr").find("Blend.Path").empty());
    // Its cost, each part once: 4 passes of two scenes, a common clustering of each.
    const Outcome cost = sh(stage("compare") + " --quiet --cost " + (folder / "g/residual.exr").string());
    EXPECT_EQ(cost.code, 0) << cost.err;

    made("same", "METHOD=graph PASSES=2");
    const Image zero = read_image(folder / "same/residual.exr");
    for (const char* channel : {"R", "G", "B", "VarMean.R", "VarMean.G", "VarMean.B"})
        for (const float v : zero.find(channel)) ASSERT_EQ(v, 0.0f) << channel;
}

// Edits share the graph too. With the old image's own samples the sum is the image of these samples in the new scene.
TEST_F(MakeEdit, from_a_graph_of_the_scene_before) {
    const std::string light = "NEW_DEFINES=light=20,10,5 GRAPH=1";
    const std::string first = made("a", light);
    const auto graph_time = fs::last_write_time(folder / "base/graph.h5");
    EXPECT_TRUE(first == made("a", light + " THREADS=1"));
    made("b", "NEW_DEFINES=light=3 GRAPH=1");
    EXPECT_EQ(fs::last_write_time(folder / "base/graph.h5"), graph_time);
    const Image before = read_image(folder / "base/old.exr"), residual = read_image(folder / "a/residual.exr"),
                sum = read_image(folder / "a/new.exr");
    EXPECT_EQ(residual.samples, 2u);
    EXPECT_NE(residual.provenance.seed, before.provenance.seed);
    EXPECT_NE(residual.provenance.plan.find("; old graph: "), std::string::npos) << residual.provenance.plan;
    // A light that changes by a factor is no noise.
    double noise = 0, of_plain_sum = 0;
    for (const char* channel : {"VarMean.R", "VarMean.G", "VarMean.B"})
        for (std::size_t i = 0; i < sum.n_pixels(); ++i) {
            noise += double(sum.find(channel)[i]);
            of_plain_sum += double(before.find(channel)[i]) + double(residual.find(channel)[i]);
        }
    EXPECT_LT(noise, 0.9 * of_plain_sum);
    EXPECT_FALSE(first == made("a", light + " GRAPH_SEED=9"));
    // The chain of costs includes the graph.
    const Outcome cost = sh(stage("compare") + " --quiet --cost " + in("a/new.exr"));
    EXPECT_EQ(cost.code, 0) << cost.err;

    made("same", "NEW_DEFINES=light=20,10,5 GRAPH=same");
    ASSERT_EQ(sh(stage("trace") + " scenes/cornell-box.xml -D resx=24 -D resy=16 -D light=20,10,5 --spp 4 -o " +
                 in("fresh.exr"))
                  .code,
              0);
    const Image same = read_image(folder / "same/new.exr"), fresh = read_image(in("fresh.exr"));
    EXPECT_EQ(same.samples, 4u);
    EXPECT_TRUE(same.ledger.empty());
    EXPECT_EQ(same.scene.hash, fresh.scene.hash);
    EXPECT_EQ(sum.ledger.back().method, "old graph");
    // A later edit, with a graph whose random streams no link has.
    const std::string later =
        "OLD_DEFINES=light=20,10,5 NEW_DEFINES=light=3 GRAPH=1 OLD_IMAGE=" + in("a/new.exr") + " BASE=" + in("base-2");
    EXPECT_NE(sh(edit("later", later + " GRAPH_SEED=9")).err.find("has the random numbers of this residual"),
              std::string::npos);
    made("later", later + " GRAPH_SEED=10");
    EXPECT_EQ(read_image(folder / "later/new.exr").ledger.size(), 3u);
    for (const char* channel : {"R", "G", "B", "VarMean.R", "VarMean.G", "VarMean.B"})
        for (std::size_t i = 0; i < same.n_pixels(); ++i)
            EXPECT_NEAR(same.find(channel)[i], fresh.find(channel)[i], 1e-5 * (1 + fresh.find(channel)[i])) << channel;
}

TEST_F(MakeEdit, graphs_that_do_not_fit_are_refused) {
    const std::string box = "scenes/cornell-box.xml -D resx=24 -D resy=16 ", o = " -o " + in("r.exr"),
                      n = " --old " + in("old.exr") + " --new " + in("n.exr");
    const auto trace = [&](const std::string& options, const std::string& file) {
        ASSERT_EQ(sh(stage("trace") + " " + box + options + " -o " + in(file)).code, 0);
    };
    trace("--spp 2", "old.exr");
    trace("--spp 2", "old.h5");
    trace("--spp 3", "more.h5");
    trace("--spp 1 --seed 4", "one.h5");
    trace("--spp 2 -D light=9", "light.h5");
    trace("--spp 2 --max-depth 3", "short.h5");
    const std::string edit = box + "--new-define light=3 --old-graph ";
    expect_refused(edit + in("missing.h5") + o, "no such file");
    expect_refused(edit + in("old.exr") + o, "old.exr");
    expect_refused(edit + in("light.h5") + o, "trace it again");
    expect_refused(edit + in("short.h5") + o, "give --max-depth 3");
    expect_refused(edit + in("old.h5") + " " + in("more.h5") + o, "which");
    expect_refused(edit + in("old.h5") + o + " --method dynamic", "give --method correlated or auto");
    expect_refused(edit + in("old.h5") + n + " --residual " + in("old.exr"), "has no use with --residual");
    expect_refused(edit + in("one.h5") + n, "one sample per pixel has no variance");
    expect_refused(edit + in("more.h5") + n, "other samples or options");
    EXPECT_EQ(sh(stage("residual") + " " + edit + in("old.h5") + o + n).code, 0);
}

TEST_F(MakeEdit, what_does_not_go_together_is_refused) {
    const std::string box = " scenes/cornell-box.xml -D resx=24 -D resy=16 --spp 2 --quiet ";
    ASSERT_EQ(
        sh(stage("trace") + box + "-o " + in("a.exr") + " && " + stage("trace") + box + "--seed 1 -o " + in("b.exr"))
            .code,
        0);
    const auto refused = [&](const std::string& command, const std::string& message) {
        const Outcome outcome = sh(command);
        EXPECT_EQ(outcome.code, 2) << command;
        EXPECT_NE(outcome.err.find(message), std::string::npos) << command << "\n" << outcome.err;
    };
    const std::string merge = stage("merge") + " " + in("a.exr") + " -o " + in("x.exr"),
                      cluster = stage("cluster") + " " + in("a.h5");
    refused(merge + " --minus " + in("b.exr"), "trace both with the same --seed");
    refused(merge + " --minus " + in("a.exr") + " --minus " + in("b.exr"), "2 images for 1 parts");
    refused(merge + " --unbiased 1", "has no estimates of its own paths");
    ASSERT_EQ(sh(stage("trace") + box + "-o " + in("a.h5")).code, 0);
    refused(cluster + " -o " + in("x.h5") + " --with " + in("a.h5"), "needs --with-output");
    refused(cluster + " -o " + in("x.h5") + " --with-output " + in("y.h5"), "needs --with");
    EXPECT_FALSE(fs::exists(folder / "x.exr"));
    EXPECT_FALSE(fs::exists(folder / "x.h5"));
    ASSERT_EQ(sh(merge + " --minus " + in("a.exr")).code, 0);
    refused(stage("residual") + " scenes/cornell-box.xml -D resx=24 -D resy=16 --old " + in("a.exr") + " --new " +
                in("n.exr") + " --residual " + in("x.exr"),
            "has no variance");
}

TEST_F(MakeEdit, wrong_variables_are_refused) {
    for (const char* wrong :
         {"METHOD=graph PASSES=1", "METHOD=graph K=0", "METHOD=graph UNBIASED=2", "METHOD=none", "GRAPH=2",
          "GRAPH=1 METHOD=independent", "SPP=0", "BASE_SPP=x", "OLD=missing.xml", "NEW=missing.xml", "OUT='two words'",
          "OLD_IMAGE=missing.exr", "OLD_IMAGE=LICENSE GRAPH=same", "OLD_IMAGE=LICENSE METHOD=graph",
          "OLD_IMAGE=LICENSE", "OLD_PICTURE=missing.exr", "NEW_DEFINES=resx=25"}) {
        const Outcome outcome = sh(edit("x", wrong));
        EXPECT_EQ(outcome.code, 2) << wrong << "\n" << outcome.err;
        EXPECT_EQ(outcome.out, "");
    }
}

TEST_F(MakeEdit, plan_says_the_edit) {
    const std::string box = stage("residual") + " scenes/cornell-box.xml --quiet --plan";
    EXPECT_EQ(sh(box).out.substr(0, 16), "nothing differs\n");
    EXPECT_EQ(sh(box).code, 0);
    EXPECT_EQ(sh(box + " --old-define light=1 --new-define light=2,2,2").out.substr(0, 61),
              "light changed: lamp: radiance (1, 1, 1) -> (2, 2, 2)\nshapes: ");
    EXPECT_NE(sh(box + " --method independent")
                  .out.find("on: independent paths (different random numbers in the two scenes, as requested)"),
              std::string::npos);
}

TEST_F(MakeEdit, wrong_command_lines_are_2) {
    const std::string box = "scenes/cornell-box.xml -D resx=24 -D resy=16 --new-define light=3 ",
                      o = " -o " + in("r.exr"), n = " --new " + in("n.exr");
    ASSERT_EQ(sh(stage("trace") + " scenes/cornell-box.xml -D resx=24 -D resy=16 --spp 2 -o " + in("old.exr")).code, 0);
    ASSERT_EQ(sh(stage("trace") + " scenes/cornell-box.xml -D resx=16 -D resy=24 --spp 2 -o " + in("tall.exr")).code,
              0);
    ASSERT_EQ(sh(stage("trace") + " scenes/cornell-box.xml -D resx=24 -D resy=16 --spp 1 -o " + in("one.exr")).code, 0);
    ASSERT_EQ(
        sh(stage("trace") + " scenes/cornell-box.xml -D resx=24 -D resy=16 -D light=9 --spp 2 -o " + in("light.exr"))
            .code,
        0);
    ASSERT_EQ(sh(stage("denoise") + " " + in("old.exr") + " -o " + in("clean.exr")).code, 0);
    const auto old = [&](const char* name) { return " --old " + in(name); };
    expect_refused("", "old");
    expect_refused("missing.xml" + o, "missing.xml");
    expect_refused(box, "-o: missing");
    expect_refused(box + n, "give --old");
    expect_refused(box + o + " --png " + in("n.png"), "give --new and --old");
    expect_refused(box + " -o " + in("r.h5"), "must end in .exr");
    expect_refused(box + old("old.exr") + n + " --spp 1", "at least 2");
    expect_refused(box + o + old("tall.exr") + n, "is 16 x 24, but the film of cornell-box.xml has 24 x 16 pixels");
    expect_refused(box + o + old("one.exr") + n, "has no variance");
    expect_refused(box + o + old("light.exr") + n, "trace it again");
    expect_refused(box + o + " --new-define resx=25",
                   "the film's width is 25, not 24 as in the old scene, at scenes/cornell-box.xml:");
    EXPECT_EQ(sh(stage("residual") + " " + box + o + old("old.exr") + n + " --spp 2").code, 0);
}

// The image of one technique is a component, and is never accepted as a whole residual.
TEST_F(MakeEdit, techniques_by_themselves) {
    const std::string box = "scenes/cornell-box.xml -D resx=24 -D resy=16 --spp 2 ";
    const Outcome list =
        sh(stage("residual") + " --quiet scenes/movers.xml --new-define m1=1 --method dynamic --technique list");
    EXPECT_EQ(list.out,
              "dynamic-from-emitter\ndynamic-two-ends\nghost-from-emitter\nghost-two-ends\nnew-place-from-sensor\nold-"
              "place-from-sensor\npath-tracing\n")
        << list.err;
    const std::string light = box + "--method dynamic --new-define light=3 ", part = light + "--technique path-tracing";
    ASSERT_EQ(sh(stage("trace") + " scenes/cornell-box.xml -D resx=24 -D resy=16 --spp 2 -o " + in("old.exr")).code, 0);
    ASSERT_EQ(sh(stage("residual") + " " + part + " -o " + in("part.exr")).code, 0);
    ASSERT_EQ(sh(stage("residual") + " " + part + " --raw -o " + in("raw.exr")).code, 0);
    EXPECT_NE(
        read_image(in("part.exr")).provenance.plan.find("a part of it: only paths found by path-tracing, weighted"),
        std::string::npos);
    EXPECT_NE(read_image(in("raw.exr")).provenance.plan.find("only paths found by path-tracing, raw"),
              std::string::npos);
    const std::string o = " -o " + in("x.exr"), n = " --old " + in("old.exr") + " --new " + in("n.exr");
    expect_refused(light + "--technique ghost-two-ends" + o,
                   "--technique ghost-two-ends: unknown; the techniques of this edit are path-tracing");
    expect_refused(part + n, "give no image of the new scene");
    expect_refused(box + "--new-define light=3 --technique path-tracing" + o, "needs --method dynamic");
    expect_refused(part + o + " --as-printed", "without --no-mapping or --technique");
    expect_refused(light + "--raw" + o, "--raw: needs --technique");
    expect_refused(light + n + " --residual " + in("part.exr"), "holds the paths of one technique");
    const Outcome pictures = sh("make -s edit-techniques BUILD='" + fs::path(LOOM_BIN_DIR).parent_path().string() +
                                "' DEFINES='resx=24 resy=16' SPP=2 NEW_DEFINES=light=3 OUT=" + in("t"));
    EXPECT_EQ(pictures.out,
              in("t/techniques/path-tracing-weighted.png") + "\n" + in("t/techniques/path-tracing-raw.png") + "\n")
        << pictures.err;
}

// Passes of a residual merge into what one run gives.
TEST_F(MakeEdit, passes_merge) {
    const std::string box =
        stage("residual") + " scenes/cornell-box.xml -D resx=24 -D resy=16 --new-define light=3 --spp ";
    ASSERT_EQ(sh(box + "8 -o " + in("whole.exr")).code, 0);
    ASSERT_EQ(sh(box + "4 -o " + in("a.exr") + " && " + box + "4 --first-sample 4 -o " + in("b.exr")).code, 0);
    ASSERT_EQ(sh(stage("merge") + " " + in("a.exr") + " " + in("b.exr") + " -o " + in("ab.exr")).code, 0);
    const Image whole = read_image(in("whole.exr")), merged = read_image(in("ab.exr"));
    for (const char* channel : {"R", "G", "B", "VarMean.R", "Albedo.R"})
        for (std::size_t i = 0; i < whole.n_pixels(); ++i)
            EXPECT_NEAR(whole.find(channel)[i], merged.find(channel)[i], 1e-4) << channel << " " << i;
}

// An image names its scene, whichever stage made it; a difference of images names none.
TEST_F(MakeEdit, pictures_name_their_scene) {
    const std::string box = stage("trace") + " scenes/cornell-box.xml --quiet -D resx=8 -D resy=8 --spp 2 ";
    const auto run = [&](const std::string& command) {
        const Outcome outcome = sh(command);
        ASSERT_EQ(outcome.code, 0) << command << "\n" << outcome.err;
    };
    const auto scene_of = [&](const char* name) { return read_image(in(name)).scene; };
    for (const char* seed : {"0", "1"}) {
        run(box + "--seed " + seed + " -o " + in("a" + std::string(seed) + ".exr"));
        run(box + "-D light=3 --seed " + seed + " -o " + in("b" + std::string(seed) + ".exr"));
    }
    run(box + "-o " + in("a.h5") + " && " + stage("gather") + " --quiet " + in("a.h5") + " -o " + in("gathered.exr"));
    const InputId a = scene_of("a0.exr"), b = scene_of("b0.exr");
    EXPECT_EQ(a.name, "cornell-box.xml");
    EXPECT_EQ(a.hash.size(), 16u);
    EXPECT_NE(a.hash, b.hash);
    EXPECT_EQ(scene_of("gathered.exr"), a);
    const std::string merge = stage("merge") + " --quiet ";
    run(merge + in("a0.exr") + " " + in("a1.exr") + " -o " + in("aa.exr"));
    run(merge + in("a0.exr") + " " + in("b1.exr") + " -o " + in("ab.exr"));
    run(merge + in("b0.exr") + " " + in("b1.exr") + " --minus " + in("a0.exr") + " --minus " + in("a1.exr") + " -o " +
        in("minus.exr"));
    EXPECT_EQ(scene_of("aa.exr"), a);
    EXPECT_EQ(scene_of("ab.exr"), InputId());
    const Image minus = read_image(in("minus.exr"));
    EXPECT_EQ(minus.scene, InputId());
    ASSERT_EQ(minus.ledger.size(), 1u);
    EXPECT_EQ(minus.ledger[0].scene, b);
    EXPECT_EQ(minus.ledger[0].method, differences_method);
    EXPECT_EQ(minus.ledger[0].samples, 4u);
    EXPECT_EQ(minus.ledger[0].var_mean, mean_var_mean(minus));
    EXPECT_TRUE(read_image(in("aa.exr")).ledger.empty());
}

// Edits after edits: the new image of one is the old image of the next, and lists all of them.
TEST_F(MakeEdit, edits_go_on_from_edits) {
    const std::string warm = "light=20,10,5", cold = "light=5,10,20";
    made("a", "METHOD=correlated NEW_DEFINES=" + warm);
    const auto base_time = fs::last_write_time(folder / "base/old.exr");
    const std::string goes_on =
        "OLD_DEFINES=" + warm + " NEW_DEFINES=" + cold + " METHOD=dynamic OLD_IMAGE=" + in("a/new.exr");
    const std::string second = made("b", goes_on);
    EXPECT_TRUE(second == made("b", goes_on + " THREADS=1"));
    const auto made_at = fs::last_write_time(folder / "b/new.exr");
    made("c", "METHOD=correlated OLD_DEFINES=" + cold + " OLD_IMAGE=" + in("b/new.exr"));
    EXPECT_EQ(fs::last_write_time(folder / "b/new.exr"), made_at);
    EXPECT_EQ(fs::last_write_time(folder / "base/old.exr"), base_time);  // nothing but differences is traced

    const Image first = read_image(in("base/old.exr")), middle = read_image(in("b/new.exr")),
                last = read_image(in("c/new.exr"));
    EXPECT_EQ(last.scene.hash, first.scene.hash);  // there and back again
    ASSERT_EQ(last.ledger.size(), 4u);
    EXPECT_TRUE(std::equal(middle.ledger.begin(), middle.ledger.end(), last.ledger.begin()));
    const Ledger& ledger = last.ledger;
    const char* const methods[] = {"", "correlated", "dynamic", "correlated"};
    for (std::size_t i = 0; i < 4; ++i) {
        EXPECT_EQ(ledger[i].method, methods[i]);
        EXPECT_EQ(ledger[i].samples, i == 0 ? 4u : 2u);
        EXPECT_GT(ledger[i].var_mean, 0);
        for (std::size_t j = 0; j < i; ++j) EXPECT_FALSE(share_numbers(ledger[i], ledger[j])) << i << " " << j;
    }
    EXPECT_EQ(ledger[0].what, "loom-trace");
    EXPECT_EQ(ledger[2].what, "light changed: lamp: radiance (20, 10, 5) -> (5, 10, 20)");
    EXPECT_EQ(ledger[2].scene, middle.scene);
    EXPECT_NEAR(accumulated_var_mean(ledger, 4), mean_var_mean(last), 1e-5 * mean_var_mean(last));
    const Image residual = read_image(in("c/residual.exr"));
    EXPECT_EQ(residual.scene, InputId());
    ASSERT_EQ(residual.ledger.size(), 1u);
    EXPECT_EQ(residual.ledger[0], ledger[3]);
    for (std::size_t i = 0; i < last.n_pixels(); ++i)
        EXPECT_EQ(last.find("G")[i], middle.find("G")[i] + residual.find("G")[i]);

    const std::string text = sh(stage("inspect") + " --quiet " + in("c/new.exr")).out;
    EXPECT_NE(text.find("  link  method       per pixel     var_mean          sum    share  fresh spp        CPU  "
                        "shows; edit\n     0"),
              std::string::npos)
        << text;
    EXPECT_NE(text.find("cornell-box.xml; light changed: lamp: radiance (20, 10, 5) -> (5, 10, 20)\n"),
              std::string::npos)
        << text;
    EXPECT_NE(sh(stage("inspect") + " --quiet --json " + in("c/new.exr")).out.find("\"fresh_spp\""), std::string::npos);

    // Refused inputs: the image of another scene, a residual in place of an image, a sum among passes.
    const std::string box = "scenes/cornell-box.xml -D resx=24 -D resy=16 --spp 2 ",
                      from_warm = box + "--old-define " + warm + " ", n = " --new " + in("n.exr");
    expect_refused(box + "--new-define light=3 --old " + in("a/new.exr") + n,
                   "as the old scene, give the new scene of the edit before, with its values");
    expect_refused(box + "--new-define light=3 --old " + in("a/new.exr") + n,
                   "is an image of cornell-box.xml with content " + ledger[1].scene.hash +
                       ", not of cornell-box.xml with these values, whose content is " + first.scene.hash);
    expect_refused(box + "--new-define light=3 --old " + in("a/residual.exr") + n,
                   "is a residual, not an image of cornell-box.xml");
    EXPECT_NE(sh(stage("merge") + " " + in("base/old.exr") + " " + in("a/new.exr") + " -o " + in("m.exr"))
                  .err.find("is an image plus an edit"),
              std::string::npos);
    EXPECT_FALSE(fs::exists(folder / "m.exr"));
    // An image from before images named their scene: loom-trace's is identified by its input, others are accepted
    // unchecked.
    Image old = read_image(in("a/new.exr"));
    old.ledger.clear();
    old.scene = {};
    old.provenance.stage = "loom-trace";
    old.provenance.inputs = {ledger[1].scene};
    write_image(old, in("old.exr"));
    expect_refused(box + "--new-define light=3 --old " + in("old.exr") + n, "trace it again");
    EXPECT_EQ(sh(stage("residual") + " " + from_warm + "--new-define light=3 --old " + in("old.exr") + n).code, 0);
    old.provenance.stage = "loom-merge";
    write_image(old, in("old.exr"));
    const Outcome on_trust = sh(stage("residual") + " " + box + "--new-define light=3 --old " + in("old.exr") + n);
    EXPECT_EQ(on_trust.code, 0);
    EXPECT_NE(on_trust.err.find("names no scene and is taken for an image of cornell-box.xml"), std::string::npos)
        << on_trust.err;

    // A residual made before has a seed of its own, and passes of it merge.
    const std::string pass =
        stage("residual") + " --quiet " + from_warm + "--new-define light=3 --method correlated --seed ";
    ASSERT_EQ(sh(pass + "0 -o " + in("r0.exr") + " && " + pass + "6 -o " + in("r6.exr") + " && " + pass +
                 "6 --first-sample 2 -o " + in("r6b.exr") + " && " + stage("merge") + " --quiet " + in("r6.exr") + " " +
                 in("r6b.exr") + " -o " + in("r.exr"))
                  .code,
              0);
    const std::string add = from_warm + "--new-define light=3 --old " + in("a/new.exr") + n + " --residual ";
    expect_refused(add + in("r0.exr"),
                   "its edit 1 (correlated) has the random numbers of this residual (correlated, seed 0)");
    expect_refused(add + in("a/residual.exr"),
                   "leads to cornell-box.xml with content " + ledger[1].scene.hash + ", not to cornell-box.xml");
    expect_refused(add + in("base/old.exr"), "is an image of cornell-box.xml, not a residual");
    const Outcome added = sh(stage("residual") + " " + add + in("r.exr"));
    ASSERT_EQ(added.code, 0) << added.err;
    const Image sum = read_image(in("n.exr"));
    EXPECT_EQ(sum.provenance.seed, 6u);
    ASSERT_EQ(sum.ledger.size(), 3u);
    EXPECT_EQ(sum.ledger[2].method, "correlated");
    EXPECT_EQ(sum.ledger[2].seed, 6u);
    EXPECT_EQ(sum.ledger[2].samples, 4u);
    EXPECT_EQ(sum.ledger[2].what, "light changed: lamp: radiance (20, 10, 5) -> (3, 3, 3)");
    EXPECT_GT(sum.ledger[2].var_sample, 0);
    EXPECT_NEAR(accumulated_var_mean(sum.ledger, 3), mean_var_mean(sum), 1e-5 * mean_var_mean(sum));
    // The noise of the bright emitter's light stays after the light is removed: a new base is proposed, with numbers
    // and command.
    EXPECT_NE(added.err.find("less than half of the 4 that the chain began with"), std::string::npos) << added.err;
    EXPECT_NE(
        added.err.find(
            "re-base: loom-trace scenes/cornell-box.xml -D 'resx=24' -D 'resy=16' -D 'light=3' --spp 4 -o FRESH.exr"),
        std::string::npos)
        << added.err;
}

TEST_F(MakeEdit, cost_of_graphs_has_a_row_per_edit) {
    const std::string chart = "make -s chart-edit-cost BUILD='" + fs::path(LOOM_BIN_DIR).parent_path().string() +
                              "' OUT=" + in("c") + " SIZE=24 SPP=2 REPLICATES=1 ROWS=";
    const Outcome made = sh(chart + "'speck half'");
    ASSERT_EQ(made.code, 0) << made.err;
    for (const char* text : {"| box | speck | ", "| box | half | ", "c/cost.png"})
        EXPECT_NE(made.out.find(text), std::string::npos) << text << "\n" << made.out;
    EXPECT_TRUE(fs::exists(folder / "c/cost.svg"));
    EXPECT_NE(sh(chart + "nothing").code, 0);
}

// Detected mutation: syntax of GNU awk alone (Debian has mawk).
TEST_F(MakeEdit, table_has_a_row_per_method_and_is_made_once) {
    const std::string table =
        "make -s table-edit BUILD='" + fs::path(LOOM_BIN_DIR).parent_path().string() + "' OUT=" + in("t") +
        " ROWS=blue METHODS='correlated dynamic' SPP=2 SPPS='2 4' REPLICATES=2 SIZE=24 REFERENCE_SPP=8 BASE_SPP=4";
    const Outcome first = sh(table);
    ASSERT_EQ(first.code, 0) << first.err;
    EXPECT_NE(first.out.find(in("t/table.tsv")), std::string::npos) << first.out;
    const std::string text = bytes_of(folder / "t/table.md");
    for (const char* row : {"### Materials (Table 2)", "| blue | correlated | 2 |", "| blue | correlated | 4 |",
                            "| blue | dynamic | 2 |", "| 8.5 |"})
        EXPECT_NE(text.find(row), std::string::npos) << row << "\n" << text;
    const auto made_at = fs::last_write_time(folder / "t/table.md");
    EXPECT_EQ(sh(table).code, 0);
    EXPECT_EQ(fs::last_write_time(folder / "t/table.md"), made_at);
    EXPECT_NE(sh(table + " ROWS=nothing").code, 0);
}

}  // namespace
}  // namespace loom::pipeline
