// An engine beside another one against an engine of all shapes.
#include <gtest/gtest.h>

#include <algorithm>
#include <random>

#include "stages/core/scene/embree.h"
#include "tests/traced_graph.h"

namespace loom {
namespace {

class RayEngines : public ::testing::Test {
  protected:
    const std::unique_ptr<Scene> scene = testing::load_inline(
        {.sensor = "type='perspective'>",
         .body = "<shape type='sphere'><point name='center' x='0.3' y='0' z='0.2'/><float name='radius' "
                 "value='0.4'/></shape>"
                 "<shape type='cube'><transform name='to_world'><scale value='0.3'/><rotate x='1' y='1' "
                 "angle='30'/><translate x='-0.5'/></transform></shape>"
                 "<shape type='disk'><transform name='to_world'><scale value='0.5'/><translate y='0.3' "
                 "z='0.6'/></transform></shape>"
                 "<shape type='rectangle'><transform name='to_world'><translate z='-0.6'/></transform></shape>"
                 "<shape type='sphere'><point name='center' x='-0.4' y='0.5' z='-0.2'/><float name='radius' "
                 "value='0.2'/></shape>"});
    std::vector<Ray> rays;

    RayEngines() {
        std::mt19937 random(3);
        std::uniform_real_distribution<float> u(-1, 1);
        for (int i = 0; i < 20000; ++i) {
            const Point3f a{u(random), u(random), u(random)}, b{u(random), u(random), u(random)};
            rays.push_back({a, normalize(b - a), 0, i % 2 ? 0.7f : INFINITY});
        }
    }
    static bool same(const Hit& a, const Hit& b) {
        return a.shape_idx == b.shape_idx &&
               (!a || (a.t == b.t && a.u == b.u && a.v == b.v && a.primitive_idx == b.primitive_idx));
    }
    /// in:      in_base  shapes of the engine below, in its order
    void compare(const std::vector<std::uint32_t>& in_base) const {
        std::vector<Shape> of_base;
        for (const std::uint32_t k : in_base) of_base.push_back(scene->shapes[k]);
        const RayEngine all(scene->shapes), beside(scene->shapes, std::make_shared<RayEngine>(of_base), in_base);
        std::vector<const Ray*> pointers;
        for (const Ray& ray : rays) pointers.push_back(&ray);
        std::vector<Hit> hits(rays.size());
        const std::unique_ptr<bool[]> blocked(new bool[rays.size()]);
        beside.intersect(pointers.data(), rays.size(), hits.data(), false);
        beside.occluded(pointers.data(), rays.size(), blocked.get());
        std::size_t n_differ = 0, n_hit = 0;
        for (std::size_t i = 0; i < rays.size(); ++i) {
            const Hit wanted = all.intersect(rays[i]);
            n_hit += bool(wanted);
            n_differ += !same(beside.intersect(rays[i]), wanted) || !same(hits[i], wanted) ||
                        beside.occluded(rays[i]) != bool(wanted) || blocked[i] != bool(wanted);
        }
        EXPECT_EQ(n_differ, 0u);
        EXPECT_GT(n_hit, rays.size() / 3);
    }
};

TEST_F(RayEngines, BesideAnotherHitTheSame) {
    compare({3, 1});
    compare({4, 2, 0});
    compare({1, 0, 4, 3});
}

TEST_F(RayEngines, OneOfThemMayBeEmpty) {
    compare({});
    compare({2, 0, 1, 4, 3});
}

TEST_F(RayEngines, BesideAnotherCrossTheSame) {
    const std::vector<std::uint32_t> in_base = {3, 0};
    std::vector<Shape> of_base;
    for (const std::uint32_t k : in_base) of_base.push_back(scene->shapes[k]);
    const RayEngine all(scene->shapes, RayEngine::Use::crossings);
    const RayEngine beside(scene->shapes, std::make_shared<RayEngine>(of_base, RayEngine::Use::crossings), in_base,
                           RayEngine::Use::crossings);
    std::vector<Hit> wanted, found;
    const auto order = [](const Hit& a, const Hit& b) {
        return std::pair(a.shape_idx, a.t) < std::pair(b.shape_idx, b.t);
    };
    for (std::size_t i = 0; i < 2000; ++i) {
        all.crossings(rays[i], wanted);
        beside.crossings(rays[i], found);
        std::sort(wanted.begin(), wanted.end(), order), std::sort(found.begin(), found.end(), order);
        ASSERT_EQ(found.size(), wanted.size());
        for (std::size_t k = 0; k < found.size(); ++k) ASSERT_TRUE(same(found[k], wanted[k]));
    }
}

}  // namespace
}  // namespace loom
