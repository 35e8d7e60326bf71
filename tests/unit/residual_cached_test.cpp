// Frames of an animation with a radiance cache of the static scene: the camera may move. What is seen of the edit does not
// depend on the cache, the rest is the cache plus the difference, and a frame has the same bytes alone and among others.
#include <cmath>

#include "formats/image.h"
#include "formats/io/content_hash.h"
#include "stages/core/edit/animation.h"
#include "stages/residual/cached_estimator.h"
#include "stages/trace/trace.h"
#include "tests/learnt_cache.h"
#include "tests/unit/frames_folder.h"

namespace loom {
namespace {

constexpr const char* scene_text =
    R"(<scene version="3.0.0"><default name="x" value="0"/><default name="eye" value="0"/><default name="paint" value="0.5"/>
<integrator type="path"><integer name="max_depth" value="5"/></integrator>
<sensor type="perspective"><float name="fov" value="45"/><transform name="to_world"><lookat origin="$eye,-4,1.6" target="0,0,.9" up="0,0,1"/></transform>
<film type="hdrfilm"><integer name="width" value="24"/><integer name="height" value="16"/><rfilter type="box"/></film></sensor>
<shape type="rectangle" id="floor"><transform name="to_world"><scale value="2"/></transform><bsdf type="twosided"><bsdf type="diffuse"><rgb name="reflectance" value="$paint, 0.5, 0.5"/></bsdf></bsdf></shape>
<shape type="rectangle" id="wall"><transform name="to_world"><scale value="2"/><rotate x="1" angle="90"/><translate y="1.5"/></transform><bsdf type="twosided"><bsdf type="diffuse"><rgb name="reflectance" value=".4,.6,.8"/></bsdf></bsdf></shape>
<shape type="rectangle" id="mirror"><transform name="to_world"><scale x=".5" y=".6"/><rotate x="1" angle="90"/><translate x="1.1" y="1.3" z=".7"/></transform><bsdf type="twosided"><bsdf type="conductor"><string name="material" value="none"/></bsdf></bsdf></shape>
<shape type="sphere" id="ball"><float name="radius" value=".4"/><point name="center" x="$x" y="-.2" z=".7"/></shape>
<shape type="rectangle" id="lamp"><transform name="to_world"><scale value=".5"/><rotate x="1" angle="180"/><translate y="-.5" z="2.6"/></transform><emitter type="area"><rgb name="radiance" value="9, 8, 7"/></emitter></shape>
</scene>)";

class CachedFrames : public testing::FramesFolder {
  protected:
    CachedFrames() : FramesFolder(scene_text, "loom-residual s.xml --frames f.tsv --cache c.h5") {}

    Animation animation() const { return find_animation(at("s.xml"), {}, "", read_frames(at("f.tsv")), Cameras::each); }
    /// Learns a cache of what the frames of f.tsv share.
    RadianceCache learnt(std::uint64_t spp = 8) const {
        const std::shared_ptr<const Scene> still = build_scene(animation().still);
        RadianceCache cache = testing::learnt_cache(*still, testing::path_options(*still, 7), spp, 16);
        cache.scene = content_hash_text(still->content_hash);
        cache.validation.relative_l2 = std::vector<double>(cache.validation.vertices.size(), 0.01);  // trusted
        return cache;
    }
    /// Multiplies the values of a cache.
    static RadianceCache scaled(RadianceCache cache, float by) {
        return testing::with_values(std::move(cache), [&](float e) { return e * by; });
    }
    void write_cache(const RadianceCache& cache, const std::string& name = "c.h5") const {
        write_radiance_cache(cache, at(name), Sync::no);
    }
    residual::Options options(const std::string& prefix, const std::string& cache = "c.h5") const {
        residual::Options options;
        options.old_scene = at("s.xml");
        options.frames = at("f.tsv");
        options.cache = at(cache);
        options.new_picture = at(prefix + "-%.exr");
        options.spp = 8;
        return options;
    }
    Image frame(const std::string& prefix, int number) const {
        return read_image(at(fmt::format("{}-{:04}.exr", prefix, number)));
    }
};

TEST_F(CachedFrames, HaveTheSameBytesAloneAndAmongOthers) {
    write("f.tsv", "frame\tx\teye\n3\t-0.7\t0\n4\t0\t.4\n10\t.5\t.8\n");
    write_cache(learnt());
    residual::run(options("all"), report);
    residual::Options one = options("one");
    one.only = "4:10";
    one.threads = 1;
    report.set_command("loom-residual s.xml --frames f.tsv --only 4:10 --cache c.h5");
    residual::run(one, report);
    EXPECT_FALSE(std::filesystem::exists(at("one-0003.exr")));
    ASSERT_FALSE(bytes("all-0004.exr").empty());
    EXPECT_EQ(bytes("one-0004.exr"), bytes("all-0004.exr"));
    // Rows before and after, in any order; the static scene is the same whatever its camera.
    report.set_command("loom-residual s.xml --frames f.tsv --cache c.h5");
    write("f.tsv", "frame\tx\teye\n12\t.1\t.9\n4\t0\t.4\n2\t.2\t.1\n");
    residual::run(options("more"), report);
    EXPECT_EQ(bytes("more-0004.exr"), bytes("all-0004.exr"));
    // Frames do not share their noise.
    write("f.tsv", "frame\tx\teye\n4\t0\t.4\n5\t0\t.4\n6\t.1\t.3\n");
    residual::run(options("again"), report);
    EXPECT_EQ(bytes("again-0004.exr"), bytes("all-0004.exr"));
    EXPECT_NE(frame("again", 5).channels[0].values, frame("again", 4).channels[0].values);
}

// Pixels of which the camera sees the ball alone, by itself or in the mirror, have the same bits with any cache.
TEST_F(CachedFrames, WhatMovesDoesNotDependOnTheCache) {
    write("f.tsv", "frame\tx\teye\n0\t1.5\t-.9\n1\t-.2\t.2\n");
    RadianceCache cache = learnt();
    write_cache(cache, "a.h5");
    write_cache(scaled(std::move(cache), 2), "b.h5");
    residual::run(options("a", "a.h5"), report);
    residual::run(options("b", "b.h5"), report);
    for (int number = 0; number < 2; ++number) {
        const Image a = frame("a", number), b = frame("b", number);
        // Find where the samples hit, by the same scene.
        const Frames table = read_frames(at("f.tsv"));
        const auto scene = load_scene(at("s.xml"), table.values_of(table.frames[std::size_t(number)]));
        std::size_t n_ball = 0, n_mirrored = 0, n_rest = 0;
        for (std::uint32_t y = 0; y < scene->sensor.height; ++y)
            for (std::uint32_t x = 0; x < scene->sensor.width; ++x) {
                int on_ball = 0, mirrored = 0, on_rest = 0, n = 0;
                for (int i = 0; i < 12; ++i)
                    for (int k = 0; k < 12; ++k, ++n) {
                        Ray ray = scene->sensor.sample_ray(x, y, {(float(i) + 0.5f) / 12, (float(k) + 0.5f) / 12});
                        Hit hit = scene->intersect_from_camera(ray);
                        if (!hit) continue;
                        if (scene->shapes[hit.shape_idx].id == "mirror") {
                            const SurfacePoint point = scene->surface(ray, hit);
                            const Vector3f normal(point.ng);
                            ray = spawn_ray(point.end(), ray.d - normal * (2 * dot(normal, ray.d)));
                            hit = scene->intersect(ray);
                            mirrored += hit && scene->shapes[hit.shape_idx].id == "ball";
                        } else {
                            on_ball += scene->shapes[hit.shape_idx].id == "ball";
                            on_rest +=
                                scene->shapes[hit.shape_idx].id == "wall" || scene->shapes[hit.shape_idx].id == "floor";
                        }
                    }
                const std::size_t pixel = std::size_t(y) * scene->sensor.width + x;
                const bool same = a.find("R")[pixel] == b.find("R")[pixel] && a.find("G")[pixel] == b.find("G")[pixel];
                if (on_ball == n || mirrored == n) {
                    EXPECT_TRUE(same) << x << ", " << y;
                    EXPECT_EQ(a.find("CacheError.G")[pixel], 0);
                }
                if (on_rest == n) {
                    EXPECT_FALSE(same) << x << ", " << y;
                    // Ten per cent of what the cache gives, by its validation.
                    const double by_cache = double(b.find("G")[pixel]) - double(a.find("G")[pixel]);
                    EXPECT_NEAR(a.find("CacheError.G")[pixel], 0.1 * by_cache, 1e-3 * std::abs(by_cache) + 1e-6);
                }
                n_ball += on_ball == n, n_mirrored += mirrored == n, n_rest += on_rest == n;
            }
        EXPECT_GT(n_ball, 8u);
        EXPECT_GT(n_rest, 100u);
        EXPECT_TRUE(number == 1 || n_mirrored > 0);
    }
}

// Where only the camera moves, the emitter is exact, and no path is traced.
TEST_F(CachedFrames, OfACameraAloneAreTheCache) {
    write("f.tsv", "frame\teye\n0\t-.9\n1\t.7\n");
    write("s.xml",
          std::string(scene_text).replace(std::string(scene_text).find("target=\"0,0,.9\""), 15, "target=\"0,0,2.4\""));
    const RadianceCache cache = learnt();
    write_cache(cache);
    residual::run(options("a"), report);
    const Image image = frame("a", 1);
    std::size_t n = 0;
    for (std::size_t i = 0; i < image.n_pixels(); ++i)
        if (image.find("R")[i] > 8.9f) {
            ++n;
            EXPECT_EQ(image.find("R")[i], 9);
            EXPECT_EQ(image.find("B")[i], 7);
            EXPECT_EQ(image.find("VarMean.R")[i], 0);
        }
    EXPECT_GT(n, 4u);
    EXPECT_NE(image.provenance.plan.find("biased"), std::string::npos);
}

// Answers far from all points are replaced by paths: the image is then the same whatever the cache says.
// Detected mutations: far answers used; the sum of the paths in their place taken for their mean.
TEST_F(CachedFrames, FarAnswersAreNotUsed) {
    for (const char* rows : {"frame\tx\teye\n0\t.3\t0\n1\t-.2\t.2\n", "frame\teye\n0\t0\n1\t.2\n"}) {
        write("f.tsv", rows);
        RadianceCache cache = learnt();
        cache.metric.median_distance = 1e-9f;
        write_cache(cache, "a.h5");
        write_cache(scaled(std::move(cache), 100), "b.h5");
        residual::run(options("a", "a.h5"), report);
        residual::run(options("b", "b.h5"), report);
        for (int number = 0; number < 2; ++number) {
            const Image a = frame("a", number), b = frame("b", number);
            for (const char* c : {"R", "G", "B", "VarMean.G"})
                EXPECT_TRUE(std::equal(a.find(c).begin(), a.find(c).end(), b.find(c).begin())) << c;
            double error = 0;
            for (const float e : a.find("CacheError.G")) error += double(e);
            EXPECT_EQ(error, 0);
            // They are path-traced: here the mean's standard error is about 2 %.
            const Frames table = read_frames(at("f.tsv"));
            const auto scene = load_scene(at("s.xml"), table.values_of(table.frames[std::size_t(number)]));
            tracing::Counts counts;
            const Image fresh =
                trace::render_image(*scene, testing::path_options(*scene, 31), {0, 64, 0}, report, counts);
            const auto mean = [](const Image& image) {
                double sum = 0;
                for (const float v : image.find("G")) sum += double(v);
                return sum;
            };
            EXPECT_NEAR(mean(a) / mean(fresh), 1, 0.15);
        }
        EXPECT_GT(report.warnings(), 0u);
    }
}

// With --correct the cache has no part in the mean: no layer says that it has, and where all paths are traced on, or all
// answers are far, frames are those of the path tracer to the bit.
TEST_F(CachedFrames, CorrectedByAllPathsAreThoseOfThePathTracer) {
    write("f.tsv", "frame\tx\teye\n3\t-0.7\t0\n4\t0\t.4\n10\t.5\t.8\n");
    RadianceCache cache = learnt();
    write_cache(cache);
    cache.metric.median_distance = 1e-9f;
    write_cache(cache, "far.h5");
    residual::Options all = options("all"), far = options("far", "far.h5");
    all.correct = 1;
    far.correct = 0.25;
    residual::run(all, report);
    residual::run(far, report);
    const Frames table = read_frames(at("f.tsv"));
    const auto scene = load_scene(at("s.xml"), table.values_of(table.frames[1]));
    PathOptions path = testing::path_options(*scene, streams::frame(streams::residual(0), 4), SamplerKind::sobol);
    tracing::Counts counts;
    const Image fresh = trace::render_image(*scene, path, {0, 8, 0}, report, counts);
    for (const char* prefix : {"all", "far"}) {
        const Image image = frame(prefix, 4);
        for (const char* c : {"R", "G", "B", "VarMean.G", "Albedo.R", "N.Z", "Depth.Z"}) {
            ASSERT_FALSE(image.find(c).empty()) << c;
            EXPECT_TRUE(std::equal(image.find(c).begin(), image.find(c).end(), fresh.find(c).begin())) << c;
        }
        EXPECT_TRUE(image.find("CacheError.R").empty());
        EXPECT_NE(image.provenance.plan.find("unbiased"), std::string::npos);
        EXPECT_EQ(image.provenance.plan.find("CacheError"), std::string::npos);
    }
}

TEST_F(CachedFrames, CorrectedHaveTheSameBytesAloneAndAmongOthers) {
    write("f.tsv", "frame\tx\teye\n3\t-0.7\t0\n4\t0\t.4\n10\t.5\t.8\n");
    write_cache(learnt());
    residual::Options all = options("all"), one = options("one");
    all.correct = one.correct = 0.25;
    all.threads = 2;
    one.threads = 1;
    one.only = "4:10";
    residual::run(all, report);
    report.set_command("loom-residual s.xml --frames f.tsv --only 4:10 --cache c.h5");
    residual::run(one, report);
    ASSERT_FALSE(bytes("all-0004.exr").empty());
    EXPECT_EQ(bytes("one-0004.exr"), bytes("all-0004.exr"));
}

// A change of the whole floor's paint touches every sample that sees it.
TEST_F(CachedFrames, RepaintedSurfacesCountAsSeen) {
    write("f.tsv", "frame\tpaint\teye\n0\t.5\t0\n1\t.8\t.3\n");
    RadianceCache cache = learnt();
    write_cache(cache, "a.h5");
    write_cache(scaled(std::move(cache), 2), "b.h5");
    residual::run(options("a", "a.h5"), report);
    residual::run(options("b", "b.h5"), report);
    const Image a = frame("a", 1), b = frame("b", 1);
    const std::size_t bottom = std::size_t(15) * 24 + 12;
    EXPECT_EQ(a.find("G")[bottom], b.find("G")[bottom]);
}

TEST_F(CachedFrames, ErrorsSayWhatToDo) {
    write("f.tsv", "frame\tx\teye\n3\t-0.7\t0\n4\t0\t.4\n");
    write_cache(learnt(2));
    const auto says = [&](const residual::Options& bad, const std::string& what) {
        const std::string text = error(bad);
        EXPECT_NE(text.find(what), std::string::npos) << text;
    };
    residual::Options bad = options("a");
    bad.cache = "";
    bad.old_picture = at("old.exr");
    says(bad, "f.tsv:3: frame 4: has another sensor than frame 3. Where the camera moves");
    says(bad, "loom-residual --cache (make animation CACHE=points)");
    bad = options("a");
    bad.old_picture = at("old.exr");
    says(bad, "--old: has no use with --cache");
    bad = options("a");
    bad.old_graph = {at("g.h5")};
    says(bad, "--old-graph: has no use with --cache");
    bad = options("a");
    bad.output = at("r-%.exr");
    says(bad, "-o: has no use with --cache");
    bad = options("a");
    bad.new_picture = at("a.exr");
    says(bad, "needs a % for the number of the frame");
    bad = options("a");
    bad.new_picture = "";
    says(bad, "--new: missing");
    bad = options("a");
    bad.spp = 1;
    says(bad, "one sample has no variance");
    bad = options("a");
    bad.frames = "";
    bad.new_scene = at("s.xml");
    says(bad, "--cache: needs --frames");
    bad = options("a");
    bad.defines = {"paint=.7"};
    says(bad, "c.h5: made of another scene");
    bad = options("a");
    bad.correct = 0.5;
    bad.cache = "";
    bad.old_picture = at("old.exr");
    says(bad, "--correct: there is no cache to correct");
    bad.frames = "";
    bad.new_scene = at("s.xml");
    says(bad, "--correct: needs --frames and --cache");
    RadianceCache other = learnt(2);
    other.validation = {};
    write_cache(other, "d.h5");
    says(options("a", "d.h5"), "validation/material has 0 rows");
}

}  // namespace
}  // namespace loom
