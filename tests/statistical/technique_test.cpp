// Each technique of dynamic paths alone, on the paths that it can sample.                       [RP] §4.1, §4.2
//
// The raw image of a family has each path over the density of its own technique alone. Its mean is
//   sum over scenes +-  integral of f(p) n(p) dp,   n: number of vertices or crossings where the technique starts.
// The reference is path tracing: camera paths by next-event estimation and by hits, times n. No part of it is sampled
// by the technique; n is counted from vertices and crossings by the text of [RP].

#include <gtest/gtest.h>
#include <tbb/parallel_for.h>

#include "stages/core/stats/chi_square.h"
#include "stages/residual/dynamic/path_finder.h"
#include "tests/statistical/edit_cases.h"

namespace loom::residual {
namespace {

constexpr int replicates = 32;
const char* const rgb[] = {"R", "G", "B"};

constexpr const char* short_place = "<translate x=\"0.36\" y=\"-0.72\" z=\"0.3\"/>";
constexpr const char* short_moved = "<translate x=\"-0.1\" y=\"-0.72\" z=\"0.4\"/>";
constexpr const char* end_of_tall =
    "<translate x=\"-0.33\" y=\"-0.42\" z=\"-0.35\"/>\n        </transform>\n        <ref id=\"white\"/>";
constexpr const char* tall_of_metal =
    "<translate x=\"-0.33\" y=\"-0.42\" z=\"-0.35\"/></transform><bsdf type=\"roughconductor\"><string "
    "name=\"material\" value=\"Au\"/>"
    "<float name=\"alpha\" value=\"0.2\"/></bsdf>";
constexpr const char* ball =
    "<shape type=\"sphere\" id=\"ball\"><point name=\"center\" x=\"0.3\" y=\"-0.1\" z=\"0.3\"/><float name=\"radius\" "
    "value=\"0.25\"/>"
    "<bsdf type=\"dielectric\"/></shape></scene>";
constexpr const char* bulb =
    "<emitter type=\"point\"><point name=\"position\" x=\"0.5\" y=\"0.5\" z=\"0.5\"/><rgb name=\"intensity\" "
    "value=\"0.4\"/></emitter></scene>";

const std::vector<EditCase>& edits() {
    static const std::vector<EditCase> all = {
        {"metal", {{end_of_tall, tall_of_metal}}},
        {"moved_by_metal", {{short_place, short_moved}}, {{end_of_tall, tall_of_metal}}},
        {"glass", {{"</scene>", ball}}},
        {"several",
         {{short_place, "<translate x=\"0.1\" y=\"-0.72\" z=\"0.4\"/>"},
          {"angle=\"18\"", "angle=\"50\""},
          {"0.60, 0.08, 0.06", "0.1, 0.1, 0.6"}}},
        {"bulb", {{short_place, short_moved}}, {{"</scene>", bulb}}},
    };
    return all;
}

/// From how many places a technique, with points on a site, starts a path of a scene.
int n_places(Technique technique, Site site, const DynamicScene& side, const FullPath& p) {
    const int m = int(p.m());
    if (m == 0) return 0;
    const auto dynamic = [&](int i) { return int(p.vertices[std::size_t(i)].site == std::uint8_t(site)); };
    const auto specular = [&](int i) { return p.vertices[std::size_t(i)].specular; };
    const auto crossings = [&](int i) { return side.ghost_site() == site ? int(p.segments[std::size_t(i)].n) : 0; };
    const bool lit = !specular(m - 1), seen = !specular(0);  // can be joined to a light, to the sensor
    int n = 0;
    switch (technique) {
        case Technique::dynamic_from_emitter:
            return lit && seen ? dynamic(m - 1) : 0;
        case Technique::dynamic_from_sensor:
            return lit && m > 1 ? dynamic(0) : 0;
        case Technique::dynamic_two_ends:
            for (int i = 1; i + 1 < m; ++i) n += dynamic(i);
            return lit && seen ? n : 0;
        case Technique::ghost_from_emitter:
            return seen && !(p.light.delta && !lit) ? crossings(m) : 0;
        case Technique::ghost_from_sensor:
            return lit ? crossings(0) : 0;
        case Technique::ghost_two_ends:
            for (int i = 1; i < m; ++i) n += crossings(i);
            return lit && seen ? n : 0;
        case Technique::path_tracing:
            break;  // none in this scene
    }
    return 0;
}

/// Renders the difference of all paths times their number of sites, by camera paths: one image per family.
std::vector<RegionMeans> by_camera(const EditedScenes& scenes, const DynamicScenes& sides,
                                   const std::vector<Family>& families, std::uint64_t seed, std::uint64_t spp) {
    PathOptions options = options_of(*scenes.new_scene);
    std::vector<Image> images(families.size());
    for (Image& image : images) {
        image.width = image.height = edit_size;
        for (const char* c : rgb) image.add(c);
    }
    PathFinder in_new(sides, sides.new_scene, options), in_old(sides, sides.old_scene, options);
    std::vector<Radiance> sums(families.size());
    for (std::uint64_t pixel = 0; pixel < edit_size * edit_size; ++pixel) {
        std::fill(sums.begin(), sums.end(), Radiance());
        for (std::uint64_t s = 0; s < spp; ++s) {
            const Sampler numbers(SamplerKind::sobol, seed, pixel, s);
            const auto trace = [&](PathFinder& finder, bool is_new) {
                const DynamicScene& side = is_new ? sides.new_scene : sides.old_scene;
                return finder.find_from_camera({pixel, s}, numbers, [&](const FullPath& p, const Found&) {
                    const Evaluation e = evaluate(sides, side, {}, options, p, nullptr);
                    if (!(e.camera_density > 0)) return;
                    const Radiance value = e.F * ((is_new ? 1 : -1) / e.camera_density / double(spp));
                    for (std::size_t f = 0; f < families.size(); ++f)
                        if (const int n = n_places(is_new ? families[f].in_new : families[f].in_old,
                                                   is_new ? families[f].site_new : families[f].site_old, side, p))
                            sums[f] += value * double(n);
                });
            };
            if (trace(in_new, true)) trace(in_old, false);
        }
        for (std::size_t f = 0; f < families.size(); ++f)
            for (int c = 0; c < 3; ++c) images[f].add(rgb[c])[pixel] = float(sums[f][c]);
    }
    std::vector<RegionMeans> means;
    for (const Image& image : images) means.push_back(region_means(image));
    return means;
}

class EachTechnique : public testing::TestWithParam<EditCase> {};

// Power: a factor of at most 1.76 between the two, for most families 1.1 to 1.3, is detected in nine of ten runs (full:
// with 8 times the samples); the test checks that half of each is detected. Detected mutations, each in all edits that
// have the family: density of dynamic from emitter doubled; the cosine of the sensor's segment dropped in dynamic from
// sensor, that of the direction in dynamic two ends, the ghost's in ghost from emitter and ghost from sensor, the
// vertex's in ghost two ends.
TEST_P(EachTechnique, HasTheMeanOfThePathsThatItCanFind) {
    const EditedScenes scenes = edited(GetParam());
    const DynamicScenes sides(*scenes.old_scene, *scenes.new_scene, scenes.edit);
    std::vector<Family> families = families_of(sides);
    families.pop_back();  // path tracing is what the reference is made of
    const std::size_t n_families = families.size();
    const std::uint64_t spp = full_run() ? 32 : 4;
    std::vector<std::vector<RegionMeans>> reference(replicates), ours(replicates);
    tbb::parallel_for(0, replicates, [&](int i) {
        reference[std::size_t(i)] = by_camera(scenes, sides, families, 20000 + std::uint64_t(i), spp);
        for (std::size_t f = 0; f < n_families; ++f) {
            DynamicOptions options;
            options.only_family = int(f);
            options.weighted = false;
            ours[std::size_t(i)].push_back(region_means(scenes.dynamic(options, 7000 + std::uint64_t(i), spp)));
        }
    });
    constexpr int regions = 1 + n_tiles * n_tiles;
    const double alpha = sidak_alpha(int(edits().size()) * 9 * 3 * regions);
    for (std::size_t f = 0; f < n_families; ++f) {
        SCOPED_TRACE(families[f].name);
        const auto estimate = [&](const std::vector<std::vector<RegionMeans>>& all, int c, int region,
                                  double scale = 1) {
            std::vector<double> values;
            for (const auto& means : all) values.push_back(scale * means[f][std::size_t(c)][std::size_t(region)]);
            return estimate_of(values);
        };
        double largest = 0, seen = 0;  // mean over its standard error
        for (int c = 0; c < 3; ++c)
            for (int region = 0; region < regions; ++region) {
                const Estimate mean = estimate(ours, c, region), expected = estimate(reference, c, region);
                EXPECT_GT(welch_p_value(mean, expected), alpha)
                    << fmt::format("channel {} region {}: {:.6g} +- {:.2g}, camera paths {:.6g} +- {:.2g}", c, region,
                                   mean.mean, mean.se, expected.mean, expected.se);
                const double error = std::hypot(mean.se, expected.se);
                if (error > 0 && std::abs(expected.mean) / error > largest) {
                    largest = std::abs(expected.mean) / error;
                    seen = welch_p_value(estimate(ours, c, region, 0.5), expected);
                }
            }
        const double critical = student_critical(alpha, 2 * replicates - 2);
        if (largest > 0)
            fmt::print("{} {}: a factor of {:.2f} is seen in nine of ten runs\n", GetParam().name, families[f].name,
                       1 + (critical + 1.28) / largest);
        if (largest > 0) {
            EXPECT_LT(seen, alpha) << "half of it is not seen";
        }
        // All paths by way of a smooth ball are specular where this one begins.
        if (!(largest > 0)) {
            EXPECT_EQ(std::string(families[f].name) + " of " + GetParam().name, "dynamic-from-emitter of glass");
        }
    }
}

INSTANTIATE_TEST_SUITE_P(Edits, EachTechnique, testing::ValuesIn(edits()),
                         [](const auto& info) { return info.param.name; });

}  // namespace
}  // namespace loom::residual
