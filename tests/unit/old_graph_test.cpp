// The correlated difference of the paths of a graph against that of newly traced paths: to the last bit, for edits of
// every kind; refused inputs; and the sum with an image of the same samples.
//
// Detected mutations, each in the edits in brackets:
// Of finding touched paths: failed light samples not drawn again (20 edits), nor directions of rays that found nothing
// (11), nor camera rays (ball_moved, lamps); shapes that differ in the last digits taken for equal
// (moved_by_less_than_counts); ends on the back of a light ignored (back_of_a_light_no_longer_black), and on its front
// (light_no_longer_black); segments to vertices (16) or to lights (15) not tested; the sky, a changed light, a failed
// sample of it ignored (2, 10, 6); segments that end a thousandth short (glossy_moved).
// Of the old contribution of paths: survival left out (28), densities of the heuristic swapped (37). The probe left out.
// Of the scan of a graph with misses: segments to vertices (14), to lights (13), camera segments from the path before
// (14), blocked rays (12) or BSDF samples without light (9) not tested, directions that end (15), failed samples of a
// changed light (6), the sky, ends on a light, escaped camera rays (1, 1, 3) ignored.
// Frames that rotate with the first anisotropic surface (made_anisotropic).
// Of resumed paths: rays cut one vertex late (19), hits of changed lights one late (7) or not at all (7), the ray that
// ended in the sky (3; taken for unchanged, 4), light samples taken for visible (26), drawn without survival (16) or added before the terms
// that they wait for (17); density (33), lobe (light_colour_behind_glass), vertex (14) or squared index (other_metal) of the
// resumed ray left out, directly visible light ignored (10), all behind the last change (40).
// Of repainted surfaces: direction (rougher) or lobe not compared (repainted, other_metal: roulette had ended them),
// light that the old surface could not reflect taken for blocked (mirror_made_matte), blocked light tested again
// (PathsAreTracedFromWhereTheyChange), roulette by the old throughput (5), the material behind ignored
// (painted_on_both_sides), the last vertex of all sampled (mirror_made_matte, repainted), hits weighted by the old
// density (5), the old albedo (7), textured and bumpy ones taken for plain (papered, bumps_made_flat).
// Of lights that only changed their radiance: the old radiance kept in samples (7), hits (6) or directly visible light
// (5), none of these searched for (7, 7, 5), a black light (sky_lit), one that moves (2) or whose surface changes
// (light_colour_and_surface) taken for such.
// Of plain diffuse vertices: the back (moved_beside_the_back_of_a_disk), texture (over_textures), mask (behind_a_mask)
// or bumps (2) ignored.

#include "stages/residual/stored/old_graph.h"

#include <gtest/gtest.h>

#include <cmath>
#include <fstream>
#include <iterator>

#include "formats/io/content_hash.h"
#include "formats/io/error.h"
#include "stages/residual/residual.h"
#include "stages/residual/stored/path_parts.h"
#include "stages/residual/stored/resumed_paths.h"
#include "tests/parts_by_force.h"
#include "tests/traced_graph.h"

namespace loom::residual {
namespace {

constexpr std::uint64_t spp = 8, seed = 11;
const char* const rgb[] = {"R", "G", "B"};

using Changes = std::vector<std::pair<std::string, std::string>>;  // of the text of a scene, at its last occurrence

struct EditCase {
    std::string name, scene;
    Changes before, after;  // of the scene in both; of the new one
    bool everything = false;
};

const std::string lamp = "<emitter type=\"area\">", end = "</scene>";
Changes with_sky(const std::string& value) {
    return {{end, "<emitter type=\"constant\" id=\"sky\"><rgb name=\"radiance\" value=\"" + value +
                      "\"/></emitter></scene>"}};
}

const std::vector<EditCase>& edits() {
    static const std::string
        short_place = "<translate x=\"0.36\" y=\"-0.72\" z=\"0.3\"/>",
        tall_end =
            "<translate x=\"-0.33\" y=\"-0.42\" z=\"-0.35\"/>\n        </transform>\n        <ref id=\"white\"/>";
    static const auto tall_of = [](const std::string& bsdf) {
        return "<translate x=\"-0.33\" y=\"-0.42\" z=\"-0.35\"/></transform>" + bsdf;
    };
    static const auto disk_of = [](const std::string& bsdf) {
        return "<shape type=\"disk\" id=\"new\"><transform name=\"to_world\"><scale value=\"0.4\"/><rotate x=\"1\" "
               "angle=\"-60\"/></transform>" +
               bsdf + "</shape></scene>";
    };
    static const std::string patches =
        "<texture type=\"bitmap\" name=\"reflectance\"><string name=\"filename\" "
        "value=\"textures/patches.png\"/></texture>";
    static const std::string white =
                                 "<bsdf type=\"diffuse\" id=\"white\">\n        <rgb name=\"reflectance\" "
                                 "value=\"0.72, 0.70, 0.66\"/>\n    </bsdf>",
                             bumps = "<bsdf type=\"bumpmap\" id=\"white\"><float name=\"scale\" value=\"0.1\"/>" +
                                     patches + "<bsdf type=\"diffuse\">" + patches + "</bsdf></bsdf>";
    static const std::string box = "cornell-box.xml", gloss = "glossy-box.xml", lights = "all-emitters.xml";
    static const std::string ball =
        "<shape type=\"sphere\" id=\"new\"><point name=\"center\" x=\"0.3\" y=\"-0.1\" z=\"0.3\"/><float "
        "name=\"radius\" value=\"0.25\"/>";
    static const Changes sky = with_sky("0.2");
    static const std::vector<EditCase> all = {
        {"moved", box, {}, {{short_place, "<translate x=\"-0.1\" y=\"-0.72\" z=\"0.4\"/>"}}},
        {"moved_onto_itself", box, {}, {{short_place, "<translate x=\"0.31\" y=\"-0.72\" z=\"0.3\"/>"}}},
        {"moved_by_less_than_counts", box, {}, {{short_place, "<translate x=\"0.36000001\" y=\"-0.72\" z=\"0.3\"/>"}}},
        {"turned", box, sky, {{"angle=\"18\"", "angle=\"50\""}}},
        {"added_ball_of_glass", box, sky, {{end, ball + "<bsdf type=\"dielectric\"/></shape></scene>"}}},
        {"added_disk", box, {}, {{end, disk_of("<ref id=\"red\"/>")}}},
        {"removed", box, {}, {{"<shape type=\"cube\" id=\"short\">", "<!--"}, {end, "--></scene>"}}},
        {"repainted", box, {}, {{"0.12, 0.42, 0.14", "0.2, 0.3, 0.7"}}},
        {"made_rough",
         box,
         {},
         {{tall_end, tall_of("<bsdf type=\"roughplastic\"><float name=\"alpha\" value=\"0.2\"/></bsdf>")}}},
        {"made_of_metal",
         box,
         {},
         {{tall_end, tall_of("<bsdf type=\"conductor\"><string name=\"material\" value=\"Au\"/></bsdf>")}}},
        {"light_colour", box, {}, {{"14, 11.5, 8", "7, 11, 16"}}},
        {"light_moved", box, {}, {{"<translate y=\"0.99\"/>", "<translate x=\"-0.5\" y=\"0.99\" z=\"0.3\"/>"}}},
        {"light_no_longer_black", box, {}, {{"<ref id=\"black\"/>", "<ref id=\"red\"/>"}}},
        {"back_of_a_light_no_longer_black",
         box,
         {{"<translate y=\"0.99\"/>", "<translate y=\"0.3\"/>"}},
         {{"<ref id=\"black\"/>", "<bsdf type=\"twosided\"><bsdf type=\"diffuse\"/></bsdf>"}}},
        {"sky", box, sky, {{"value=\"0.2\"", "value=\"0.5, 0.7, 0.9\""}}},
        {"sky_lit", box, with_sky("0"), {{"radiance\" value=\"0\"", "radiance\" value=\"0.5\""}}},
        {"several",
         box,
         {},
         {{short_place, "<translate x=\"0.1\" y=\"-0.72\" z=\"0.4\"/>"},
          {"angle=\"18\"", "angle=\"50\""},
          {"0.60, 0.08, 0.06", "0.1, 0.1, 0.6"}}},
        {"unseen_shadow",
         box,
         {},
         {{end,
           "<shape type=\"rectangle\" id=\"new\"><transform name=\"to_world\"><scale value=\"0.15\"/><rotate x=\"1\" "
           "angle=\"90\"/>"
           "<translate x=\"0.2\" y=\"0.95\" z=\"1.5\"/></transform><ref id=\"white\"/></shape></scene>"}}},
        {"unseen_out_of_the_box",
         box,
         {},
         {{end,
           "<shape type=\"sphere\" id=\"new\"><point name=\"center\" x=\"0.3\" y=\"2\" z=\"4\"/><float name=\"radius\" "
           "value=\"1\"/>"
           "<emitter type=\"area\"><rgb name=\"radiance\" value=\"3\"/></emitter></shape></scene>"}},
         true},
        {"reflector_out_of_the_box",
         box,
         {},
         {{end,
           "<shape type=\"sphere\" id=\"new\"><point name=\"center\" x=\"0.3\" y=\"2\" z=\"4\"/><float name=\"radius\" "
           "value=\"1\"/></shape></scene>"}}},
        {"light_for_another",
         box,
         {},
         {{"<emitter type=\"area\">", "<!-- <emitter type=\"area\">"},
          {"\"$light\"/>\n        </emitter>", "\"$light\"/>\n        </emitter> -->"},
          {end, ball + "<emitter type=\"area\"><rgb name=\"radiance\" value=\"3\"/></emitter></shape></scene>"}}},
        {"light_added",
         box,
         {},
         {{end,
           "<emitter type=\"point\"><point name=\"position\" x=\"0.5\" y=\"0.5\" z=\"0.5\"/><rgb name=\"intensity\" "
           "value=\"0.4\"/></emitter></scene>"}},
         true},
        {"glass_moved", gloss, {}, {{"-0.35, -0.75, 0.5", "-0.2, -0.75, 0.55"}}},
        {"glossy_moved", gloss, {}, {{"x=\"0.42\" y=\"-0.74\"", "x=\"0.3\" y=\"-0.7\""}}},
        {"other_metal", gloss, {}, {{"value=\"Al\"", "value=\"Cu\""}}},
        {"ball_moved", lights, {}, {{"0.9, 0.2, 0.6", "1.1, -0.2, 0.7"}}},
        {"ball_gone",
         lights,
         {},
         {{"<shape type=\"sphere\" id=\"ball_matte\">", "<!--"},
          {"<shape type=\"sphere\" id=\"ball_metal\">", "--><shape type=\"sphere\" id=\"ball_metal\">"}}},
        {"lamp_sphere_moved", lights, {}, {{"-2, -0.5, 1.6", "-2, -0.7, 1.4"}}},
        {"lamp_disk_turned", lights, {}, {{"angle=\"-90\"", "angle=\"-70\""}}},
        {"lamp_point_moved", lights, {}, {{"-0.2, -1.5, 1", "-0.4, -1.5, 1.2"}}},
        {"spot_narrower", lights, {}, {{"value=\"15\"", "value=\"12\""}}},
        {"sun_turned", lights, {}, {{"1, 1, -2", "1, 0.5, -2"}}},
        {"lights_by_weight",
         lights,
         {},
         {{"<rgb name=\"irradiance\"", "<float name=\"sampling_weight\" value=\"2\"/><rgb name=\"irradiance\""}},
         true},
        {"under_a_map",
         "environment-map.xml",
         {},
         {{"<shape type=\"sphere\" id=\"ball_metal\">", "<!--"},
          {"<emitter type=\"envmap\"", "--><emitter type=\"envmap\""}}},
        {"behind_a_mask",
         "mask.xml",
         {},
         {{end, "<shape type=\"sphere\" id=\"new\"><float name=\"radius\" value=\"0.2\"/></shape></scene>"}}},
        {"over_textures",
         "textured.xml",
         {},
         {{end, "<shape type=\"sphere\" id=\"new\"><float name=\"radius\" value=\"0.2\"/></shape></scene>"}}},
        {"through_an_orthographic_camera",
         box,
         {{"<sensor type=\"perspective\">", "<sensor type=\"orthographic\">"},
          {"<string name=\"fov_axis\" value=\"x\"/>", ""},
          {"<float name=\"fov\" value=\"34\"/>", ""},
          {"rfilter type=\"box\"", "rfilter type=\"gaussian\""}},
         {{short_place, "<translate x=\"0.31\" y=\"-0.6\" z=\"0.3\"/>"}}},
        {"made_anisotropic",
         box,
         {},
         {{tall_end, tall_of("<bsdf type=\"roughconductor\"><float name=\"alpha_u\" value=\"0.1\"/><float "
                             "name=\"alpha_v\" value=\"0.3\"/></bsdf>")}},
         true},
        {"mirror_made_matte",
         box,
         {{tall_end, tall_of("<bsdf type=\"conductor\" id=\"mirror\"/>")}},
         {{"<bsdf type=\"conductor\" id=\"mirror\"/>", "<ref id=\"green\"/>"}}},
        {"painted_on_both_sides",
         box,
         {{end, disk_of("<bsdf type=\"diffuse\" id=\"front\"/>")}},
         {{"<bsdf type=\"diffuse\" id=\"front\"/>",
           "<bsdf type=\"twosided\"><bsdf type=\"plastic\"/><ref id=\"red\"/></bsdf>"}}},
        {"moved_over_bumps", box, {{white, bumps}}, {{short_place, "<translate x=\"-0.1\" y=\"-0.72\" z=\"0.4\"/>"}}},
        {"bumps_made_flat", box, {{white, bumps}}, {{bumps, white}}},
        {"white_repainted", box, {}, {{"0.72, 0.70, 0.66", "0.7, 0.5, 0.3"}}},
        {"papered", box, {}, {{"<rgb name=\"reflectance\" value=\"0.12, 0.42, 0.14\"/>", patches}}},
        {"rougher", gloss, {}, {{"<float name=\"alpha\" value=\"0.15\"/>", "<float name=\"alpha\" value=\"0.3\"/>"}}},
        {"moved_beside_the_back_of_a_disk",
         box,
         {{end, disk_of("<bsdf type=\"twosided\"><bsdf type=\"diffuse\"/></bsdf><boolean name=\"flip_normals\" "
                        "value=\"true\"/>")}},
         {{short_place, "<translate x=\"-0.1\" y=\"-0.72\" z=\"0.4\"/>"}}},
        {"light_out", box, {}, {{"14, 11.5, 8", "0, 0, 0"}}},
        {"light_colour_and_surface",
         box,
         {},
         {{"14, 11.5, 8", "7, 11, 16"}, {"<ref id=\"black\"/>", "<ref id=\"red\"/>"}}},
        {"light_colour_and_box_moved",
         box,
         {},
         {{"14, 11.5, 8", "7, 11, 16"}, {short_place, "<translate x=\"-0.1\" y=\"-0.72\" z=\"0.4\"/>"}}},
        {"light_colour_and_boxes_repainted",
         box,
         sky,
         {{"14, 11.5, 8", "7, 11, 16"},
          {"0.72, 0.70, 0.66", "0.7, 0.5, 0.3"},
          {"value=\"0.2\"", "value=\"0.5, 0.7, 0.9\""}}},
        {"light_colour_behind_glass", "caustic.xml", {}, {{"value=\"40\"", "value=\"30\""}}},
        {"nothing", gloss, {}, {}},
    };
    return all;
}

SceneDescription description(const std::string& scene, const Changes& before, const Changes& after,
                             const std::filesystem::path& file) {
    std::ifstream in(std::filesystem::path(LOOM_SOURCE_DIR) / "scenes" / scene);
    std::string text{std::istreambuf_iterator<char>(in), {}};
    for (const Changes* changes : {&before, &after})
        for (const auto& [from, to] : *changes) {
            const auto at = text.rfind(from);
            if (at == std::string::npos) throw std::logic_error("no such text: " + from);
            text.replace(at, from.size(), to);
        }
    std::ofstream(file) << text;
    return read_scene(file.string(), {{"resx", "24"}, {"resy", "24"}});
}

/// The two scenes of an edit.
struct Edited {
    std::unique_ptr<Scene> old_scene, new_scene;
    Edit edit;

    explicit Edited(const EditCase& c) {
        // Beside the textures.
        const auto folder = loom::testing::scratch_file("");
        std::filesystem::create_directories(folder);
        std::filesystem::create_directory_symlink(std::filesystem::path(LOOM_SOURCE_DIR) / "scenes/textures",
                                                  folder / "textures");
        SceneDescription before = description(c.scene, c.before, {}, folder / "old.xml"),
                         after = description(c.scene, c.before, c.after, folder / "new.xml");
        edit = find_edit(before, after);
        old_scene = build_scene(std::move(before));
        new_scene = build_scene(std::move(after));
        std::filesystem::remove_all(folder);
    }
    ScenePair pair() const { return {*old_scene, *new_scene}; }
    EditReach reach() const { return {*old_scene, *new_scene, edit}; }
    PathOptions path(SamplerKind sampler = SamplerKind::sobol) const {
        return loom::testing::path_options(*old_scene, seed, sampler);
    }

    PathGraph trace(PathOptions path, std::uint64_t n, std::uint64_t first, bool misses) const {
        return loom::testing::trace_graph(*old_scene, path, n, first, {.misses = misses});
    }
    OldGraph graph(const PathOptions& options, bool misses = false) const {
        PathOptions path = options;
        path.seed = seeds_of(Method::correlated, path.seed).old_scene;
        OldGraph graph;
        graph.passes.push_back(trace(path, 3, 0, misses));
        graph.passes.push_back(trace(path, spp - 3, 3, misses));
        graph.files = {"a.h5", "b.h5"};
        graph.path = path;
        graph.spp = spp;
        return graph;
    }
};

app::Report& quiet() {
    static app::Report report;
    report.set_quiet(true);
    return report;
}

/// Values that are not the same number.
std::size_t n_differing(const Image& a, const Image& b, const std::string& channel) {
    std::size_t n = 0;
    const auto x = a.find(channel), y = b.find(channel);
    for (std::size_t i = 0; i < x.size(); ++i) n += x[i] != y[i];
    return n;
}

class OfAnOldGraph : public ::testing::TestWithParam<EditCase> {};

TEST_P(OfAnOldGraph, IsTheFullDifferenceBitForBit) {
    const Edited edited(GetParam());
    const PathOptions path = edited.path();
    Counts counts;
    const Image full = render_residual(edited.pair(), Method::correlated, path, {0, spp, 1}, quiet(), counts);
    const GraphResidual ours = render_residual(edited.pair(), edited.reach(), edited.graph(path), 2, nullptr, quiet());
    EXPECT_EQ(ours.image.samples, spp);
    for (const char* layer : {"", "VarMean.", "Albedo."})
        for (const char* c : rgb) EXPECT_EQ(n_differing(full, ours.image, std::string(layer) + c), 0u) << layer << c;
    for (const char* c : {"N.X", "N.Y", "N.Z"}) EXPECT_EQ(n_differing(full, ours.image, c), 0u) << c;
    const auto depth = full.find("Depth.Z");
    for (std::size_t i = 0; i < depth.size(); ++i)
        EXPECT_NEAR(ours.image.find("Depth.Z")[i], depth[i], 1e-5 * (1 + depth[i]));
    EXPECT_EQ(!ours.why_all.empty(), GetParam().everything) << ours.why_all;
    EXPECT_LE(ours.counts.rays, counts.rays);
    if (GetParam().after.empty()) {
        EXPECT_EQ(ours.touched, 0u);
    }
    RecordProperty("touched", fmt::format("{:.4f}", double(ours.touched) / double(ours.paths)));

    // With misses few paths are examined closely, and light samples without a ray are not drawn again.
    const OldGraph graph = edited.graph(path, true);
    const GraphResidual scanned = render_residual(edited.pair(), edited.reach(), graph, 2, nullptr, quiet());
    for (const char* channel : {"R", "G", "B", "VarMean.R", "VarMean.G", "VarMean.B", "Albedo.R", "Albedo.G",
                                "Albedo.B", "N.X", "N.Y", "N.Z"})
        EXPECT_EQ(n_differing(ours.image, scanned.image, channel), 0u) << channel;
    EXPECT_LE(scanned.touched, ours.touched);
}

// The scan keeps little more than the touched paths.
TEST(OldGraph, ScanOfTheGraphLeavesFewPathsToLookAt) {
    for (const auto& [name, most] :
         {std::pair{"moved", 1.6}, {"repainted", 1.0}, {"glossy_moved", 1.5}, {"light_colour", 1.0}, {"sky", 1.02}}) {
        SCOPED_TRACE(name);
        const auto found =
            std::find_if(edits().begin(), edits().end(), [&](const EditCase& c) { return c.name == name; });
        const Edited edited(*found);
        const PathOptions path = edited.path();
        const PathGraph graph = edited.trace(path, spp, 0, true);
        const EditReach reach(*edited.old_scene, *edited.new_scene, edited.edit);
        const GraphReader reader(graph);
        CandidatePaths candidates(*edited.old_scene, reach, graph);
        const StoredPaths paths(*edited.old_scene, reader, path);
        const std::size_t n = graph.n_paths();
        std::vector<std::uint8_t> may(n), is(n);
        PathChanges changes;
        candidates.find(0, n, may.data());
        TouchedPaths(paths, reach).find(0, n, is.data(), changes);
        const auto n_may = double(std::count(may.begin(), may.end(), 1)),
                   n_is = double(std::count(is.begin(), is.end(), 1));
        EXPECT_GT(n_is, 0);
        EXPECT_LE(n_may, most * n_is) << "of " << n;
    }
}

// Plus and Minus are, to the last bit, those of paths that are classified one by one by what they hit and cross; by a graph
// and by new pairs. Detected mutations: occluded light samples not counted in Minus (23 edits); a crossing of a shadow ray makes
// the path touched (22).
TEST_P(OfAnOldGraph, DividesIntoThePartsOfItsPaths) {
    const Edited edited(GetParam());
    if (GetParam().everything) return;  // other light samples at all vertices
    const PathOptions path = edited.path();
    const EditReach reach = edited.reach();
    Counts counts;
    PartSums of_pairs(edited.pair(), reach, edited.edit), of_graph(edited.pair(), reach, edited.edit);
    const Image by_pairs =
        render_residual(edited.pair(), Method::correlated, path, {0, spp, 2}, quiet(), counts, &of_pairs);
    const OldGraph graph = edited.graph(path);
    const Image by_graph = render_residual(edited.pair(), reach, graph, 2, nullptr, quiet(), nullptr, &of_graph).image;
    const auto sides = {loom::testing::edited_side(*edited.old_scene, *edited.new_scene, edited.edit, reach, true),
                        loom::testing::edited_side(*edited.old_scene, *edited.new_scene, edited.edit, reach, false)};
    double most = 0;
    for (const auto& side : sides) {
        const std::string layer = &side->scene == edited.old_scene.get() ? "Minus." : "Plus.";
        for (std::uint64_t pixel = 0; pixel < by_pairs.n_pixels(); ++pixel) {
            double sum[3]{};
            for (std::uint64_t sample = 0; sample < spp; ++sample) {
                const Spectrum part = loom::testing::touched_part(*side, graph.path, {pixel, sample});
                for (int c = 0; c < 3; ++c) sum[c] += double(part[c]);
            }
            for (int c = 0; c < 3; ++c) {
                const float expected = float(sum[c] / double(spp));
                ASSERT_EQ(by_pairs.find(layer + rgb[c])[pixel], expected) << layer << rgb[c] << " " << pixel;
                ASSERT_EQ(by_graph.find(layer + rgb[c])[pixel], expected) << layer << rgb[c] << " " << pixel;
                most = std::max(most, std::abs(sum[c]));
            }
        }
    }
    // They are those of the residual, and no more.
    EXPECT_EQ(most == 0, GetParam().after.empty());
    for (const char* c : rgb)
        for (std::size_t i = 0; i < by_pairs.n_pixels(); ++i) {
            const float plus = by_pairs.find(std::string("Plus.") + c)[i],
                        minus = by_pairs.find(std::string("Minus.") + c)[i];
            ASSERT_NEAR(plus - minus, by_pairs.find(c)[i], 1e-5 * double(plus + minus) + 1e-6) << c << " " << i;
        }
}

/// Origins of the new scene's paths.
struct Ways {
    std::uint64_t shadow_rays = 0, cut = 0, last_ray = 0, whole = 0, repainted = 0, repainted_without_rays = 0,
                  without_rays = 0;
};

/// Checks path by path: the old and the new contribution, and that the path is traced only from its first change.
Ways check_paths(const Edited& edited, const PathOptions& options, bool misses = false) {
    PathOptions path = options;
    path.seed = seed;
    const PathGraph graph = edited.trace(path, 2, 0, misses);
    const EditReach reach(*edited.old_scene, *edited.new_scene, edited.edit);
    const GraphReader reader(graph);
    const StoredPaths paths(*edited.old_scene, reader, path);
    std::vector<std::uint8_t> touched(graph.n_pixels());
    ResumedPaths resumed(edited.pair(), reach, path);
    StoredBlock block;
    block.start(paths, graph.n_pixels(), 2 * graph.n_pixels());
    PathBatch old_batch(*edited.old_scene, path), new_batch(*edited.new_scene, path);
    FirstHits first_hits(paths);
    Ways ways;
    PathChanges changes;
    TouchedPaths(paths, reach).find(graph.n_pixels(), 2 * graph.n_pixels(), touched.data(), changes);
    auto again = changes.again.begin();
    for (const PathChange& change : changes.paths) {
        const std::uint64_t n = graph.paths.first_vertex[change.path + 1] - graph.paths.first_vertex[change.path];
        SCOPED_TRACE(fmt::format("path {} of {} vertices, cut at {}, {} light samples again{}", change.path, n,
                                 int(change.cut), change.n_again, change.repainted ? ", repainted" : ""));
        PathPair pair;
        pair.first = first_hits.of(change.path);
        resumed.counts = {};
        resumed.add(block, {{change}, {again, again + change.n_again}}, {&pair, 1});
        resumed.finish();
        again += change.n_again;
        const PathId id = paths.id(change.path);
        PathResult before, after;
        old_batch.trace({&id, 1}, {&before, 1});
        new_batch.trace({&id, 1}, {&after, 1});
        EXPECT_EQ(pair.before, before.L);
        EXPECT_EQ(pair.stored, before.L);
        EXPECT_EQ(pair.after, after.L);
        EXPECT_EQ(pair.first.albedo, after.first.albedo);
        EXPECT_EQ(pair.first.n, after.first.n);
        const bool never = change.cut == PathChange::never;
        const std::uint64_t rays = resumed.counts.rays;
        if (change.repainted) {
            EXPECT_LE(rays, after.n_rays);
        } else {
            EXPECT_LE(rays + (never ? n : change.cut), after.n_rays);
            if (never) {
                EXPECT_LE(rays, change.n_again);
            }
        }
        ways.shadow_rays += never && !change.repainted;
        ways.cut += !change.repainted && change.cut > 0 && change.cut < n;
        ways.last_ray += change.cut == n && n > 0;
        ways.whole += change.cut == 0;
        ways.repainted += change.repainted;
        ways.without_rays += rays == 0 && pair.after != pair.before;
        ways.repainted_without_rays += change.repainted && rays == 0 && pair.after != pair.before;
    }
    return ways;
}

TEST_P(OfAnOldGraph, IsOfPathsAsIfTheyWereTracedWhole) {
    const Edited edited(GetParam());
    check_paths(edited, edited.path());
    PathOptions path = edited.path(SamplerKind::independent);
    path.roulette = Roulette::throughput;
    path.rr_depth = 2;
    path.max_depth = 4;
    check_paths(edited, path, true);
}

INSTANTIATE_TEST_SUITE_P(Edits, OfAnOldGraph, ::testing::ValuesIn(edits()),
                         [](const auto& info) { return info.param.name; });

// Each way of coming by a path is taken where it should be.
TEST(OldGraph, PathsAreTracedFromWhereTheyChange) {
    const auto ways = [](const std::string& name) {
        const auto found =
            std::find_if(edits().begin(), edits().end(), [&](const EditCase& c) { return c.name == name; });
        const Edited edited(*found);
        return check_paths(edited, edited.path());
    };
    const Ways moved = ways("moved"), sky = ways("sky_lit"), recoloured = ways("light_colour"),
               repainted = ways("white_repainted"), glass = ways("glass_moved"), bumps = ways("moved_over_bumps");
    for (const Ways& w : {moved, glass, bumps}) {
        EXPECT_GT(w.shadow_rays, 5u);
        EXPECT_GT(w.cut, 20u);
        EXPECT_GT(w.whole, 5u);
    }
    EXPECT_EQ(sky.cut + sky.last_ray + sky.whole, 0u);
    EXPECT_GT(sky.without_rays, 50u);
    EXPECT_GT(recoloured.without_rays, 400u);
    EXPECT_EQ(recoloured.cut + recoloured.last_ray + recoloured.whole, 0u);
    EXPECT_GT(repainted.repainted, 100u);
    EXPECT_EQ(repainted.cut + repainted.last_ray + repainted.whole, 0u);
    EXPECT_GT(10 * repainted.repainted_without_rays,
              8 * repainted.repainted);  // 407 of 479; 347 if blocked rays were traced again
}

// What one new scene needs of the paths is kept for the next: the result of each is that of it alone. Detected mutations:
// light behind the last change left out where it is known in the old scene; vertices kept from one block to the next.
TEST(OldGraph, ScenesTogetherAreEachAlone) {
    std::vector<std::unique_ptr<Edited>> edited;
    std::vector<EditReach> reaches;
    std::vector<GraphJob> jobs;
    std::vector<ControlSums> controls;
    for (const char* name : {"moved", "light_colour", "light_moved", "repainted", "removed", "added_disk", "moved"}) {
        const auto found = std::find_if(edits().begin(), edits().end(),
                                        [&](const EditCase& c) { return c.name == name && c.before.empty(); });
        ASSERT_NE(found, edits().end());
        edited.push_back(std::make_unique<Edited>(*found));
    }
    for (const auto& e : edited) reaches.push_back(e->reach());
    const std::vector<Spectrum> half(edited[0]->old_scene->sensor.n_pixels(), Spectrum(0.5f));
    controls.assign(edited.size(), ControlSums(half));
    for (std::size_t i = 0; i < edited.size(); ++i)
        jobs.push_back({*edited[i]->new_scene, reaches[i], nullptr, i % 2 ? &controls[i] : nullptr});
    const OldGraph graph = edited[0]->graph(edited[0]->path(), true);
    const auto together = render_residuals(*edited[0]->old_scene, jobs, graph, 2, quiet());
    for (std::size_t i = 0; i < edited.size(); ++i) {
        SCOPED_TRACE(i);
        ControlSums control(half);
        const GraphResidual alone =
            render_residual(edited[i]->pair(), reaches[i], graph, 1, nullptr, quiet(), i % 2 ? &control : nullptr);
        EXPECT_EQ(alone.touched, together[i].touched);
        EXPECT_GT(alone.touched, 0u);
        for (const char* channel : {"R", "G", "B", "VarMean.R", "VarMean.G", "VarMean.B", "Albedo.R", "N.X", "Depth.Z"})
            EXPECT_EQ(n_differing(alone.image, together[i].image, channel), 0u) << channel;
        if (i % 2 == 0) continue;
        for (std::size_t p = 0; p < half.size(); ++p)
            for (std::size_t c = 0; c < 3; ++c) {
                const PairMoments &a = (*control.pairs(p))[c], &b = (*controls[i].pairs(p))[c];
                ASSERT_TRUE(a.n == b.n && a.before == b.before && a.after == b.after && a.of_both == b.of_both) << p;
            }
    }
}

// Also with other random streams, other roulette and passes with a gap, on any number of threads.
TEST(OldGraph, IsOfAllKindsOfPaths) {
    const Edited edited(edits()[0]);
    for (const auto& [sampler, roulette] :
         {std::pair{SamplerKind::independent, Roulette::throughput}, {SamplerKind::sobol, Roulette::off}}) {
        PathOptions path = edited.path(sampler);
        path.roulette = roulette;
        path.rr_depth = 2;
        path.max_depth = 6;
        Counts counts;
        const Image full = render_residual(edited.pair(), Method::correlated, path, {0, spp, 2}, quiet(), counts);
        const OldGraph graph = edited.graph(path);
        for (const int threads : {1, 2}) {
            const GraphResidual ours = render_residual(edited.pair(), edited.reach(), graph, threads, nullptr, quiet());
            for (const char* c : rgb)
                EXPECT_EQ(n_differing(full, ours.image, c) + n_differing(full, ours.image, std::string("VarMean.") + c),
                          0u);
        }
    }
}

// Old + residual of the same samples is the image of these samples in the new scene, with its variance. Detected
// mutation: the change of the mean left out of the variance.
TEST(OldGraph, SumOfTheSameSamplesIsAFreshPicture) {
    for (const std::size_t c : {0u, 5u, 10u, 34u}) {
        SCOPED_TRACE(edits()[c].name);
        const Edited edited(edits()[c]);
        const OldGraph graph = edited.graph(edited.path());
        Counts counts;
        const Image old = trace::render_image(*edited.old_scene, graph.path, {0, spp, 0}, quiet(), counts);
        const Image fresh = trace::render_image(*edited.new_scene, graph.path, {0, spp, 0}, quiet(), counts);
        const GraphResidual residual = render_residual(edited.pair(), edited.reach(), graph, 0, &old, quiet());
        const Image sum = add_residual_of_same_samples(old, residual.image, residual);
        EXPECT_EQ(sum.samples, spp);
        for (const char* channel : {"R", "G", "B", "VarMean.R", "VarMean.G", "VarMean.B"}) {
            const auto ours = sum.find(channel), theirs = fresh.find(channel), before = old.find(channel);
            for (std::size_t i = 0; i < ours.size(); ++i)
                ASSERT_NEAR(ours[i], theirs[i], 2e-6 * (theirs[i] + before[i]) + 1e-9) << channel << " " << i;
        }
    }
}

TEST(OldGraph, TellsWhetherAPictureIsOfItsSamples) {
    OldGraph graph;
    for (const std::uint64_t first : {0, 4}) {
        PathGraph& pass = graph.passes.emplace_back();
        pass.tracing.first_sample = first;
        pass.tracing.samples_per_pixel = 4;
        pass.provenance.seed = 3;
        pass.provenance.command =
            fmt::format("loom-trace x.xml --define a=1 --spp 4 --first-sample {} --seed 3 --sampler sobol", first);
    }
    graph.files = {"a.h5", "b.h5"};
    graph.spp = 8;
    graph.path.seed = 3;
    const auto picture = [](const std::string& stage, std::uint64_t picture_seed, const std::string& command) {
        Image image;
        image.provenance.stage = stage;
        image.provenance.seed = picture_seed;
        image.provenance.command = command;
        return image;
    };
    const std::string whole =
        "loom-trace x.xml --define a=1 --spp 8 --first-sample 0 --passes 1 --seed 3 --sampler sobol";
    EXPECT_TRUE(same_samples(picture("loom-trace", 3, whole), "old.exr", graph));
    EXPECT_FALSE(same_samples(picture("loom-trace", 4, whole), "old.exr", graph));
    EXPECT_FALSE(same_samples(picture("loom-merge", 4, "loom-merge a.exr b.exr"), "old.exr", graph));
    EXPECT_FALSE(same_samples(picture("unknown", 3, ""), "old.exr", graph));
    for (const auto& [stage, command] : std::vector<std::pair<std::string, std::string>>{
             {"loom-trace", "loom-trace x.xml --define a=1 --spp 16 --first-sample 0 --seed 3 --sampler sobol"},
             {"loom-trace", "loom-trace x.xml --define a=1 --spp 8 --first-sample 4 --seed 3 --sampler sobol"},
             {"loom-trace", "loom-trace x.xml --define a=1 --spp 8 --first-sample 0 --seed 3 --sampler independent"},
             {"loom-trace",
              "loom-trace x.xml --define a=1 --spp 8 --first-sample 0 --seed 3 --sampler sobol --max-depth 3"},
             {"loom-trace", "loom-trace"},
             {"loom-merge", whole},
             {"loom-residual", whole}}) {
        try {
            same_samples(picture(stage, 3, command), "old.exr", graph);
            ADD_FAILURE() << command;
        } catch (const InputError& error) {
            EXPECT_NE(std::string(error.what()).find("old.exr: has seed 3 like a.h5"), std::string::npos)
                << error.what();
        }
    }
    graph.passes[1].tracing.first_sample = 5;  // a gap
    EXPECT_THROW(same_samples(picture("loom-trace", 3, whole), "old.exr", graph), InputError);
}

/// Graphs on disk that are not quite those of a scene.
class OldGraphFile : public ::testing::Test {
  protected:
    Edited edited{edits()[0]};
    std::vector<std::string> files;

    ~OldGraphFile() override {
        for (const std::string& file : files) std::filesystem::remove(file);
    }
    template <class Change>
    std::string write(std::uint64_t first, std::uint64_t n, Change&& change) {
        PathOptions path = edited.path();
        path.seed = 3;
        Counts counts;
        PathGraphInPieces graph = trace::render_graph(*edited.old_scene, path, {first, n, 0}, quiet(), counts);
        graph.provenance.stage = "loom-trace";
        graph.provenance.seed = path.seed;
        graph.provenance.inputs = {{"old.xml", content_hash_text(edited.old_scene->content_hash)}};
        change(graph);
        files.push_back(loom::testing::scratch_file(".h5"));
        write_path_graph(graph, files.back(), Sync::no);
        return files.back();
    }
    std::string write(std::uint64_t first, std::uint64_t n) {
        return write(first, n, [](PathGraphInPieces&) {});
    }
    OldGraph read(const std::vector<std::string>& names, int max_depth = 17) const {
        return read_old_graph(names, *edited.old_scene, "old.xml", max_depth);
    }
    void expect_refused(const std::vector<std::string>& names, const std::string& reason, int max_depth = 17) const {
        try {
            read(names, max_depth);
            ADD_FAILURE() << "not refused: " << reason;
        } catch (const InputError& error) {
            EXPECT_NE(std::string(error.what()).find(reason), std::string::npos) << error.what();
            EXPECT_TRUE(std::any_of(names.begin(), names.end(), [&](const std::string& name) {
                return std::string(error.what()).starts_with(name);
            })) << error.what();
        }
    }
};

TEST_F(OldGraphFile, IsReadInTheOrderOfItsSamples) {
    const OldGraph graph = read({write(6, 2), write(1, 3)});
    EXPECT_EQ(graph.spp, 5u);
    EXPECT_EQ(graph.passes[0].tracing.first_sample, 1u);
    EXPECT_EQ(graph.files[0], files[1]);
    EXPECT_EQ(graph.path.seed, 3u);
    EXPECT_EQ(graph.path.max_depth, 17);
}

TEST_F(OldGraphFile, ThatDoesNotFitIsRefused) {
    const std::string good = write(0, 2);
    const auto wrong = [&](auto&& change) { return write(0, 2, change); };
    expect_refused({wrong([](PathGraphInPieces& g) { g.provenance.stage = "loom-merge"; })},
                   "was written by loom-merge");
    expect_refused({wrong([](PathGraphInPieces& g) { g.provenance.inputs[0].hash = "0123456789abcdef"; })},
                   "is a graph of old.xml with content 0123456789abcdef, not of old.xml");
    expect_refused({wrong([](PathGraphInPieces& g) { g.provenance.inputs.clear(); })}, "of an unknown scene");
    expect_refused({wrong([](PathGraphInPieces& g) { g.sensor.width = 48, g.sensor.height = 12; })},
                   "is of 48 x 12 pixels, but the film of old.xml has 24 x 24");
    expect_refused({wrong([](PathGraphInPieces& g) { g.tracing.roulette = "russian"; })}, "roulette russian");
    expect_refused({wrong([](PathGraphInPieces& g) { g.tracing.sampler = "halton"; })}, "sampler halton");
    expect_refused({wrong([](PathGraphInPieces& g) { g.shapes.id.push_back("another"); })}, "has 9 shapes");
    expect_refused({good}, "was traced with max_depth 17, not 5; give --max-depth 17", 5);
    expect_refused({good, good}, "has samples from 0 on");
    expect_refused({good, write(1, 2)}, "has samples from 1 on, which " + good + " has too (to 1)");
    expect_refused({good, write(2, 2, [](PathGraphInPieces& g) { g.provenance.seed = 4; })},
                   "was not traced like " + good);
    expect_refused({good, write(2, 2, [](PathGraphInPieces& g) { g.tracing.roulette_depth = 4; })},
                   "was not traced like " + good);
}

// A graph whose attributes alone claim the scene.
TEST_F(OldGraphFile, OfOtherPathsIsFoundOut) {
    const OldGraph graph = read({write(0, 2, [](PathGraphInPieces& g) { g.provenance.seed = 4; })});
    try {
        render_residual(edited.pair(), edited.reach(), graph, 0, nullptr, quiet());
        ADD_FAILURE() << "not found out";
    } catch (const InputError& error) {
        EXPECT_NE(std::string(error.what()).find("graph and scene do not belong together"), std::string::npos)
            << error.what();
    }
}
}  // namespace
}  // namespace loom::residual
