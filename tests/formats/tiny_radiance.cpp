#include "tests/formats/tiny_radiance.h"

namespace loom::testing {

Radiance tiny_radiance() {
    Radiance r;
    r.graph = "fedcba9876543210";
    r.clusters = "00112233445566aa";
    r.graph_vertices = 6;
    r.settings = {"fixed-point", "points", "cluster", "zero", 3, 0.01f, 1};
    std::vector<float> L, direct, indirect_path;
    for (int i = 0; i < 18; ++i) L.push_back(0.125f * float(i) + 0.01f);
    for (int i = 0; i < 12; ++i) direct.push_back(0.1f * float(i)), indirect_path.push_back(0.2f * float(i));
    r.L = L;
    r.direct = direct;
    r.indirect_path = indirect_path;
    r.residual = std::vector<double>{0.5, 0.125, 0.01};
    r.image_change = std::vector<double>{0.25, 0.0625, 0.005};
    r.clamped_share = 1e-4;
    r.provenance.stage = "loom-test";
    r.provenance.release = "0.0.0";
    r.provenance.commit = "none";
    r.provenance.command = "loom-test --iterations 3";
    r.provenance.seed = 7;
    r.provenance.inputs = {{"tiny graph.h5", "fedcba9876543210"}, {"tiny clusters.h5", "00112233445566aa"}};
    r.provenance.plan = "on: three steps from darkness; off: nothing";
    return r;
}

}  // namespace loom::testing
