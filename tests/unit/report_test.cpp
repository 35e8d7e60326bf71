// Pages with known parts; tests/pipeline/report_test.cpp tests them in a browser.

#include "stages/report/report.h"

#include <gtest/gtest.h>

#include <cmath>
#include <fstream>

#include "formats/image.h"
#include "formats/io/error.h"
#include "stages/report/html.h"
#include "stages/report/pixels.h"
#include "stages/report/tour.h"

namespace loom::report {
namespace {

namespace fs = std::filesystem;

std::string error_of(const std::function<void()>& body) {
    try {
        body();
    } catch (const InputError& error) {
        return error.what();
    }
    return "nothing was thrown";
}

// [RFC4648] section 10.
TEST(Report, Base64) {
    const auto of = [](const std::string& text) {
        return base64({reinterpret_cast<const std::uint8_t*>(text.data()), text.size()});
    };
    EXPECT_EQ(of(""), "");
    EXPECT_EQ(of("f"), "Zg==");
    EXPECT_EQ(of("fo"), "Zm8=");
    EXPECT_EQ(of("foobar"), "Zm9vYmFy");
    EXPECT_EQ(of("\xff\xfe\xfd"), "//79");
}

TEST(Report, NumbersHaveThreeDigits) {
    EXPECT_EQ(number(0), "0");
    EXPECT_EQ(number(1), "1.00");
    EXPECT_EQ(number(-0.012345), "−0.0123");
    EXPECT_EQ(number(99.96), "100.0");
    EXPECT_EQ(number(54321), "54321");
    EXPECT_EQ(number(1.5e-5), "1.50\u202f·\u202f10<sup>−5</sup>");
    EXPECT_EQ(number(NAN), "–");
    EXPECT_EQ(number(2, NAN), "2.00");
    EXPECT_EQ(number(2, 0.25), "2.00\u202f<small>±\u202f0.25</small>");
    EXPECT_EQ(number(0.0105, 4.01e-5), "0.0105\u202f<small>±\u202f0.000040</small>");
}

TEST(Report, TemplatesAreFilledWholly) {
    EXPECT_EQ(filled("a {{x}} b {{y}}", {{"x", "{{y}}"}, {"y", "2"}}), "a {{y}} b 2");
    EXPECT_THROW(filled("{{x}}", {}), std::logic_error);
    EXPECT_THROW(filled("", {{"x", "1"}}), std::logic_error);
}

TEST(Report, ChartsKeepTheirIdsApart) {
    const std::string svg =
        "<?xml version=\"1.0\"?>\n<svg><path id='a'/><g id=\"b\"/><use xlink:href='#a'/><i "
        "fill=\"url(#b)\"/></svg>";
    EXPECT_EQ(inline_svg(svg, "c1", "x.svg"),
              "<svg><path id='c1-a'/><g id=\"c1-b\"/><use xlink:href='#c1-a'/><i fill=\"url(#c1-b)\"/></svg>");
    EXPECT_EQ(error_of([] { inline_svg("text", "c", "x.svg"); }), "x.svg: is no SVG");
    EXPECT_NE(error_of([] { inline_svg("<svg><script>", "c", "x.svg"); }).find("x.svg: holds a script"),
              std::string::npos);
}

Image picture(std::uint32_t width, std::uint32_t height, float scale) {
    Image image;
    image.width = width;
    image.height = height;
    image.samples = 4;
    std::vector<float> rgb(3 * image.n_pixels());
    for (std::size_t i = 0; i < rgb.size(); ++i) rgb[i] = scale * float(i);
    image.set_layer("", "RGB", rgb);
    return image;
}

// A red row 0, 3, 6 above 9, 12, 15 in halves of 2 x 2: their mean 6, and 10.5 of the narrow cell at the
// edge.
TEST(Report, PixelsAreMeansInHalves) {
    const Pixels small = pixels_of(picture(3, 2, 1), 2);
    EXPECT_EQ(small.factor, 2u);
    EXPECT_EQ(small.width, 2u);
    EXPECT_EQ(small.height, 1u);
    // 6, 7, 8, 10.5, 11.5, 12.5 as halves: 4600 4700 4800 4940 49c0 4a40.
    const std::vector<std::uint8_t> bytes{0x00, 0x46, 0x00, 0x47, 0x00, 0x48, 0x40, 0x49, 0xc0, 0x49, 0x40, 0x4a};
    EXPECT_EQ(small.data, base64(bytes));
    EXPECT_EQ(pixels_of(picture(3, 2, 1), 3).factor, 1u);

    Image bright = picture(1, 1, 0);
    bright.set_layer("", "RGB", std::vector<float>{1e6f, -1e6f, NAN});
    const Pixels clipped = pixels_of(bright, 16);
    EXPECT_EQ(clipped.n_clipped, 2u);
    EXPECT_EQ(clipped.data, base64(std::vector<std::uint8_t>{0xff, 0x7b, 0xff, 0xfb, 0x00, 0x7e}));
}

Cost cost(const std::string& stage, double cpu_s, std::vector<std::string> parents) {
    Cost c;
    c.stage = stage;
    c.cpu_s = cpu_s;
    c.peak_memory_bytes = std::uint64_t(1000 * cpu_s);
    c.parents = std::move(parents);
    return c;
}

/// An image merged of two passes, each from a deleted graph, beside a reference without a history.
class Page : public testing::Test {
  protected:
    void SetUp() override {
        for (const char* name : {"a", "b"}) {
            const fs::path place = folder / name;
            fs::create_directories(place / "graph");
            for (int pass : {0, 1}) {
                const std::string stem = "pass-" + std::to_string(pass);
                Cost trace = cost("loom-trace", 1 + pass, {});
                trace.sources = {"scene.xml"};
                trace.command = "loom-trace scene.xml --first-sample " + std::to_string(pass);
                trace.plan = "on: paths; off: <sky>";
                write_cost(trace, place / "graph" / (stem + ".h5"));
                write_cost(cost("loom-gather", 0.5, {stem + ".h5"}), place / "graph" / (stem + ".exr"));
            }
            write_cost(cost("loom-merge", 0.25, {"graph/pass-0.exr", "graph/pass-1.exr"}), place / "image.exr");
            write_image(picture(4, 3, 0.1f), place / "image.exr");
            write_image(picture(4, 3, 0.11f), place / "reference.exr");
            std::ofstream(place / "errors.tsv")
                << "method\tsamples\trelmse\trelmse_trimmed\tmape\tpsnr\tssim\tbias2\tvariance\treference_"
                   "noise\t"
                   "corr_right\tcorr_near\tp_image\tp_tiles\tcpu_s\twall_s\trender_s\trays\tpeak_memory_"
                   "bytes\n"
                   "x\t4\t0.5\t0.4\t0.3\t20\t0.9\t-0.001\t0.25\tnan\t0.1\t0.05\t0.5\t1e-9\t4."
                   "25\t5\t4\t0\t2048\n"
                   "x\t4\t0.7\t0.4\t0.3\t20\t0.9\t-0.001\t0.25\tnan\t0.1\t0.05\t0.5\t1e-9\t4."
                   "25\t5\t4\t0\t2048\n";
            std::ofstream(place / "equal.tsv")
                << "scene\tfirst\tmethod\tequal_cpu_s\trelmse_first\trelmse_method\ttimes_better\tlow\thigh\n"
                   "s\tpt\tx\t1\t0.5\t0.25\t2\t1.5\t2.5\ns\tpt\tx\t4\t0.3\t0.1\t3\t2\t4\n"
                   "s\tpt\ty\t1\t0.5\t0.55\t0.9\t0.5\t1.5\n";
            std::ofstream(place / "error-cost.svg") << "<svg><path id=\"p\"/></svg>";
        }
    }
    Options options(const std::string& name, const std::string& label = "x") const {
        Options o;
        const auto in = [&](const char* file) { return (folder / name / file).string(); };
        o.pictures = {label + "=" + in("image.exr")};
        o.reference = in("reference.exr");
        o.errors = in("errors.tsv");
        o.equal_cost = in("equal.tsv");
        o.charts = {in("error-cost.svg")};
        o.title = "a <scene>";
        return o;
    }
    fs::path folder = fs::path(testing::TempDir()) / "loom-report";
    void TearDown() override { fs::remove_all(folder); }
};

TEST_F(Page, LineageGathersFilesOfAKind) {
    const std::vector<Made> rows = lineage_of((folder / "a/image.exr").string());
    ASSERT_EQ(rows.size(), 3u);
    EXPECT_EQ(rows[0].name, "graph/pass-*.h5");
    EXPECT_EQ(rows[0].names, (std::vector<std::string>{"graph/pass-0.h5", "graph/pass-1.h5"}));
    EXPECT_EQ(rows[0].from, std::vector<std::string>{"scene.xml"});
    EXPECT_EQ(rows[0].cost.cpu_s, 3);
    EXPECT_EQ(rows[0].cost.peak_memory_bytes, 2000u);
    EXPECT_EQ(rows[0].cost.command, "loom-trace scene.xml --first-sample 0");
    EXPECT_EQ(rows[1].from, std::vector<std::string>{"graph/pass-*.h5"});
    EXPECT_EQ(rows[2].name, "image.exr");
    EXPECT_EQ(rows[2].from, std::vector<std::string>{"graph/pass-*.exr"});
}

// Same inputs give same bytes in any folder; and a browser would fetch nothing.
TEST_F(Page, DependsOnItsInputsOnly) {
    const std::string page = page_of(options("a"));
    EXPECT_TRUE(page == page_of(options("a")));
    EXPECT_TRUE(page == page_of(options("b")));
    EXPECT_EQ(page.find(folder.string()), std::string::npos);
    for (const char* fetched : {"src=", "<link", "@import", "url(", "fetch(", "https:"})
        EXPECT_EQ(page.find(fetched), std::string::npos) << fetched;
}

TEST_F(Page, SaysWhatTheTablesSay) {
    const std::string page = page_of(options("a"));
    const auto has = [&](const std::string& text) { return page.find(text) != std::string::npos; };
    EXPECT_TRUE(has("<h1>a &lt;scene&gt;</h1>"));
    EXPECT_TRUE(has("<td>0.600\u202f<small>±\u202f0.10</small></td>"));  // relMSE of two replicates
    EXPECT_TRUE(has("<td>&lt;\u202f0.0001</td>"));
    EXPECT_TRUE(has("<td>–</td><td>2.0 KiB</td>"));  // an unknown number of rays is no zero
    // At the highest common level; a ratio whose interval contains 1 is reported as no difference.
    EXPECT_TRUE(
        has("At an equal CPU time of 4.00 s, <em>x</em> has <strong>3.00 times less</strong> relMSE than "
            "<em>pt</em> (2.00 to 4.00)."));
    EXPECT_TRUE(
        has("<em>y</em> has <strong>1.11 times more</strong> relMSE than <em>pt</em> (0.667 to 2.00), which "
            "may be noise."));
    EXPECT_TRUE(has("<b class=\"better\">3.00"));
    EXPECT_TRUE(has("<b class=\"noise\">0.900"));
    EXPECT_TRUE(has("<path id=\"chart0-p\"/>"));
    EXPECT_TRUE(has("on: paths; off: &lt;sky&gt;"));
    EXPECT_TRUE(has("5 files, 4.25\u202fs of CPU time"));
}

// A label must end neither the data nor an element.
TEST_F(Page, LabelsAreNoMarkup) {
    Options o = options("a", "</script><script>alert(1)//");
    o.errors.clear();
    const std::string page = page_of(o);
    EXPECT_EQ(page.find("<script>alert"), std::string::npos);
    EXPECT_NE(page.find("&lt;/script&gt;"), std::string::npos);
}

TEST_F(Page, WrongInputsAreRefused) {
    Options o = options("a");
    write_image(picture(5, 3, 1), folder / "a/reference.exr");
    EXPECT_NE(error_of([&] { page_of(o); }).find("is 4 x 3, but"), std::string::npos);
    o = options("b");
    fs::remove(folder / "b/graph/pass-1.h5.cost.json");
    EXPECT_NE(error_of([&] { page_of(o); }).find("pass-1.h5.cost.json: no such file"), std::string::npos);
    o = options("b");
    o.equal_cost = o.errors;
    fs::copy_file(folder / "a/graph/pass-1.h5.cost.json", folder / "b/graph/pass-1.h5.cost.json");
    EXPECT_NE(error_of([&] { page_of(o); }).find("is no table of equal costs"), std::string::npos);
}

// Two figures of one section share a heading and a command; times are those of all ancestors, each once.
// Detected mutations: an ancestor of two outputs counted twice; text that is not escaped.
TEST(Tour, ShowsFiguresWithWhatTheyTook) {
    const fs::path folder = fs::temp_directory_path() / "loom-tour";
    fs::remove_all(folder);
    fs::create_directories(folder);
    const auto file = [&](const char* name) { return (folder / name).string(); };
    write_png(picture(2, 2, 0.1f), file("a.png"));
    std::ofstream(file("b.svg")) << "<svg><path id='a'/></svg>";
    std::ofstream(file("c.txt")) << "text";
    const auto cost = [&](const char* name, double wall_s, std::vector<std::string> parents) {
        Cost made;
        made.stage = "loom-trace", made.wall_s = wall_s, made.cpu_s = 2 * wall_s, made.parents = std::move(parents);
        write_cost(made, file(name));
    };
    cost("graph.h5", 10, {});
    cost("a.exr", 1, {"graph.h5"});
    cost("b.exr", 2, {"graph.h5"});
    const auto page = [&](const std::string& rows) {
        std::ofstream(file("tour.tsv")) << "section\ttext\tfigure\tcaption\toutput\tcommand\n" << rows;
        return tour_page(file("tour.tsv"), "Title");
    };
    const std::string a = file("a.png"), b = file("b.svg"), both = file("a.exr") + " " + file("b.exr");
    const std::string html = page("One\tText <1>\t" + a + "\tFirst\t" + file("a.exr") + "\tmake 'a'\n" + "One\t\t" + b +
                                  "\tSecond\t" + both + "\tmake 'a'\n" + "Two\t\t" + a + "\tThird\t\t\n");
    const auto count = [&](const std::string& text) {
        std::size_t n = 0;
        for (std::size_t at = 0; (at = html.find(text, at)) != std::string::npos; ++at) ++n;
        return n;
    };
    EXPECT_EQ(count("<section>"), 2u);
    EXPECT_EQ(count("Text &lt;1&gt;"), 1u);
    EXPECT_EQ(count("make &#39;a&#39;"), 1u);
    EXPECT_EQ(count("data:image/png;base64,iVBORw0KGgo"), 2u);
    EXPECT_EQ(count("chart1-a"), 1u);
    EXPECT_EQ(count("11.0 s (22.0 s of CPU time)"), 1u);
    EXPECT_EQ(count("13.0 s (26.0 s of CPU time)"), 1u);

    EXPECT_NE(error_of([&] { page("One\t\t" + file("c.txt") + "\t\t\t\n"); }).find("c.txt: is neither"),
              std::string::npos);
    EXPECT_NE(error_of([&] { page(""); }).find("tour.tsv"), std::string::npos);
    EXPECT_NE(error_of([&] { page("One\t\t" + a + "\t\t" + file("none.exr") + "\t\n"); }).find("none.exr"),
              std::string::npos);
    fs::remove_all(folder);
}

}  // namespace
}  // namespace loom::report
