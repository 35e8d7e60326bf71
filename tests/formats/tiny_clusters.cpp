#include "tests/formats/tiny_clusters.h"

namespace loom::testing {

Clusters tiny_clusters() {
    Clusters c;
    c.graph = "fedcba9876543210";
    c.graph_vertices = 6;
    c.settings = {"centres", 2, 4, 0.5f, 0.25f, 0.05f, 7};
    c.first = {0, 1, 3, 5};
    c.member = {5, 0, 2, 3, 1};
    c.provenance.stage = "loom-test";
    c.provenance.release = "0.0.0";
    c.provenance.commit = "none";
    c.provenance.command = "loom-test --seed 7";
    c.provenance.seed = 7;
    c.provenance.inputs = {{"tiny graph.h5", "fedcba9876543210"}};
    c.provenance.plan = "normals in the metric";
    return c;
}

}  // namespace loom::testing
