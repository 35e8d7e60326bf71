#include "tests/formats/tiny_radiance_cache.h"

namespace loom::testing {
namespace {

RadianceCache common() {
    RadianceCache c;
    c.scene = "0123456789abcdef";
    c.graphs = {"fedcba9876543210", "00112233445566aa"};
    c.domain = {{-1, -0.5f, 0.25f}, 4};
    c.validation.material = {"wall", "floor"};
    c.validation.vertices = std::vector<std::uint64_t>{12, 0};
    c.validation.relative_l2 = std::vector<double>{0.0625, 0};
    c.validation.mean_ratio = std::vector<double>{0.99, 1};
    c.provenance.stage = "loom-test";
    c.provenance.release = "0.0.0";
    c.provenance.commit = "none";
    c.provenance.command = "loom-test --method points";
    c.provenance.seed = 7;
    c.provenance.inputs = {{"tiny graph.h5", "fedcba9876543210"}};
    c.provenance.plan = "on: points; off: nothing";
    return c;
}

}  // namespace

RadianceCache tiny_point_cache() {
    RadianceCache c = common();
    c.settings = {"points", 7, 6, 0, 1, 0.03f};
    c.demodulated = 1;
    c.metric = {8, 0.125f, 0.5f};
    std::vector<float> p, E, var;
    for (int i = 0; i < 9; ++i)
        p.push_back(0.25f * float(i)), E.push_back(0.5f + float(i)), var.push_back(0.01f * float(i));
    c.points.p = p;
    c.points.n = std::vector<std::int16_t>{0, 0, 32767, 0, -100, 200};
    c.points.E = E;
    c.points.var = var;
    c.points.members = std::vector<std::uint16_t>{1, 3, 65535};
    return c;
}

RadianceCache tiny_grid_cache() {
    RadianceCache c = common();
    c.settings = {"grid", 7, 4096, 2, 0, 0.03f};
    c.grid.resolution = std::vector<std::uint32_t>{1, 2};
    c.grid.first = std::vector<std::uint32_t>{0, 8, 24};
    c.grid.features = std::vector<float>(48, 0.25f);
    c.inputs = {"level 0 feature 0", "level 0 feature 1", "level 1 feature 0", "level 1 feature 1", "1"};
    c.mlp.rows = std::vector<std::uint32_t>{2, 3};
    c.mlp.columns = std::vector<std::uint32_t>{5, 2};
    c.mlp.weight = std::vector<float>(16, 0.5f);
    c.training.loss = std::vector<double>{0.5, 0.25};
    c.training.samples = std::vector<std::uint64_t>{2048, 4096};
    return c;
}

}  // namespace loom::testing
