// Gradients: written and read again; every way in which a file can be wrong is refused with the name of the dataset.
#include "formats/gradient.h"

#include <gtest/gtest.h>

#include "formats/io/error.h"
#include "tests/formats/tiny_graph.h"

namespace loom {
namespace {

using testing::input_error_of;
using testing::ScratchFolder;

Gradient tiny_gradient() {
    Gradient g;
    g.graph = "0123456789abcdef";
    g.loss = 1.5;
    g.parameters.name = {"theta", "shape:ball/pose.x"};
    g.parameters.unit = {"1", "m"};
    g.parameters.value = {0.25, 0};
    g.parameters.gradient = {-3, 1e-300};
    g.shapes.wrench = std::vector<double>(12, 2);
    g.shapes.normals = std::vector<double>(9, 3);
    g.materials.numbers = std::vector<double>(2 * n_material_numbers, 4);
    g.emitters.wrench = std::vector<double>(12, 5);
    g.emitters.radiance = {6, 7, 8};
    g.camera.lens = 9;
    g.vertices.name = {"shape:a/vertices", "shape:b/vertices"};
    g.vertices.first = {0, 1, 3};
    g.vertices.gradient = std::vector<double>(9, 10);
    g.texels.name = {"bsdf:a/reflectance/texels"};
    g.texels.width = {2};
    g.texels.height = {1};
    g.texels.first = {0, 2};
    g.texels.gradient = std::vector<double>(6, 11);
    g.provenance.stage = "loom-test";
    return g;
}

TEST(GradientFile, ReadsWhatWasWritten) {
    const ScratchFolder folder;
    for (const bool with_parts : {true, false}) {
        Gradient g = tiny_gradient();
        if (!with_parts) g.vertices = {}, g.texels = {};
        write_gradient(g, folder / "g.h5", Sync::no);
        const Gradient read = read_gradient(folder / "g.h5");
        EXPECT_EQ(read.graph, g.graph);
        EXPECT_EQ(read.loss, g.loss);
        EXPECT_EQ(read.parameters.name, g.parameters.name);
        EXPECT_EQ(read.camera.lens, 9);
        EXPECT_EQ(read.vertices.name, g.vertices.name);
        for (const auto member : {&Gradient::Parameters::value, &Gradient::Parameters::gradient})
            EXPECT_TRUE(std::equal((g.parameters.*member).begin(), (g.parameters.*member).end(),
                                   (read.parameters.*member).begin(), (read.parameters.*member).end()));
        EXPECT_EQ(read.materials.numbers.size(), 2 * n_material_numbers);
        EXPECT_EQ(read.vertices.gradient.size(), g.vertices.gradient.size());
        EXPECT_EQ(read.texels.gradient.size(), g.texels.gradient.size());
    }
}

TEST(GradientFile, RefusesWhatIsWrong) {
    const ScratchFolder folder;
    const struct {
        void (*change)(Gradient&);
        const char* complaint;
    } cases[] = {
        {[](Gradient& g) {
             g.vertices.first = {1, 1, 3};
         },
         "vertices/first: does not start at 0"},
        {[](Gradient& g) {
             g.vertices.first = {0, 4, 3};
         },
         "vertices/first: row 2 is below the one before"},
        {[](Gradient& g) {
             g.vertices.first = {0, 1, 4};
         },
         "vertices/first: ends at 4, but there are 3 rows"},
        {[](Gradient& g) {
             g.vertices.first = {0, ~std::uint64_t{0}, 3};
         },
         "vertices/first: row 2 is below"},
        {[](Gradient& g) { g.vertices.gradient = {}; }, "vertices/first: ends at 3, but there are 0 rows"},
        {[](Gradient& g) {
             g.texels.first = {0, 1};
         },
         "texels/first: ends at 1, but there are 2 rows"},
        {[](Gradient& g) { g.texels.width = {3}; }, "texels/first: image 0 has 2 rows, not 3 x 1"},
        {[](Gradient& g) { g.texels.width = {65536}, g.texels.height = {65536}; },
         "texels/first: image 0 has 2 rows, not 65536 x 65536"},
    };
    for (const auto& [change, complaint] : cases) {
        Gradient g = tiny_gradient();
        change(g);
        write_gradient(g, folder / "g.h5", Sync::no);
        const std::string said = input_error_of([&] { read_gradient(folder / "g.h5"); });
        EXPECT_NE(said.find(complaint), std::string::npos) << said << "\nexpected: " << complaint;
    }
}

TEST(GradientFile, DamagedBytesDoNoHarm) {
    const ScratchFolder folder;
    write_gradient(tiny_gradient(), folder / "x.h5", Sync::no);
    testing::read_damaged(folder / "x.h5", [](const auto& path) { (void)read_gradient(path); });
}

}  // namespace
}  // namespace loom
