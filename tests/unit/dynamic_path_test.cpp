// Densities of paths through an edit against a plain reference implementation, and mappings there and back. Detected
// mutations: cosines of a segment swapped in the sensor prefix (reference); a perfectly specular vertex next to the
// sensor counted for techniques that connect it to the sensor (DynamicPaths of the statistical tests); neighbours of
// the moved vertex judged smooth by one of the two scenes alone (there and back).

#include <gtest/gtest.h>
#include <unistd.h>

#include <fstream>
#include <iterator>

#include "stages/core/scene/build.h"
#include "stages/residual/dynamic/path_pairs.h"
#include "stages/residual/dynamic_estimator.h"

namespace loom::residual {
namespace {

using Changes = std::vector<std::pair<std::string, std::string>>;

/// glossy-box.xml with the short box moved, the metal box repainted and the glass ball moved.
struct Fixture {
    std::filesystem::path folder =
        std::filesystem::temp_directory_path() / ("loom-dynamic-" + std::to_string(getpid()));
    std::unique_ptr<Scene> old_scene, new_scene;
    Edit edit;

    explicit Fixture(const Changes& changes) {
        std::filesystem::create_directories(folder);
        const std::filesystem::path base = std::filesystem::path(LOOM_SOURCE_DIR) / "scenes/glossy-box.xml";
        std::ifstream in(base);
        std::string text{std::istreambuf_iterator<char>(in), {}};
        for (const auto& [from, to] : changes) text.replace(text.rfind(from), from.size(), to);
        const std::string file = (folder / "new.xml").string();
        std::ofstream(file) << text;
        SceneDescription before = read_scene(base.string(), {}), after = read_scene(file, {});
        edit = find_edit(before, after);
        old_scene = build_scene(std::move(before));
        new_scene = build_scene(std::move(after));
    }
    ~Fixture() { std::filesystem::remove_all(folder); }
};

/// Samples times density of starting at vertex j (from 0) or at a ghost of segment i, by the area of all vertices and
/// one factor after another; then to the measure of the path.
double twin(const DynamicScenes& scenes, const DynamicScene& side, const SampleCounts& counts, const FullPath& p,
            const Term& term) {
    const std::size_t m = p.m();
    const auto g_light = [&](std::size_t i) {  // solid angle at v_i to area at v_{i+1}
        return p.segments[i + 1].cos_light / double(length2(p.places[i + 1]->at.p - p.places[i]->at.p));
    };
    const auto g_sensor = [&](std::size_t i) {  // solid angle at v_{i+1} to area at v_i
        return p.segments[i + 1].cos_sensor / double(length2(p.places[i + 1]->at.p - p.places[i]->at.p));
    };
    double to_measure = p.sensor.scale * p.segments[0].cos_light;  // area of v_1 to film
    for (std::size_t i = 0; i + 1 < m; ++i) to_measure *= g_light(i);
    double density = 1;
    const auto walk_to_sensor = [&](std::size_t from) {
        for (std::size_t i = from; i > 0; --i)
            density *= p.vertices[i].pdf_sensor * p.vertices[i].q_sensor * g_sensor(i - 1);
    };
    const auto walk_to_light = [&](std::size_t from) {
        for (std::size_t i = from; i + 1 < m; ++i)
            density *= p.vertices[i].pdf_light * p.vertices[i].q_light * g_light(i);
        density *= p.light.pdf;
    };
    const auto starts = [&](Technique t, Site site) {
        density *= counts.of(t, site).n / scenes.at(site).area(start_of(t));
    };
    const bool dynamic = term.technique <= Technique::dynamic_two_ends;
    if (dynamic) {
        const std::size_t j = term.place - 1;
        starts(term.technique, Site(p.vertices[j].site));
        if (term.technique == Technique::dynamic_two_ends) {
            walk_to_sensor(j);
            density *= p.vertices[j].pdf_cosine * g_light(j);
            walk_to_light(j + 1);
        } else if (term.technique == Technique::dynamic_from_emitter) {
            walk_to_sensor(j);
            density *= p.light.pdf;
        } else {
            walk_to_light(0);
        }
    } else {
        const Crossing& c = (*p.crossings)[term.place];
        starts(term.technique, side.ghost_site());
        if (term.technique == Technique::ghost_two_ends) {
            std::size_t i = 1;
            while (!(p.segments[i].first <= term.place && term.place < p.segments[i].first + p.segments[i].n)) ++i;
            const Vector3f d = normalize(p.places[i]->at.p - p.places[i - 1]->at.p);
            const double cos = std::abs(dot(c.n, d)), p_direction = cos / (2 * pi_double);
            // Area of the ghost and direction to the two vertices.                     [RP] Eq. (14)
            density *= p_direction / cos * p.segments[i].cos_sensor * p.segments[i].cos_light /
                       double(length2(p.places[i]->at.p - p.places[i - 1]->at.p));
            walk_to_sensor(i - 1);
            walk_to_light(i);
        } else if (term.technique == Technique::ghost_from_emitter) {
            const Vector3f d = normalize(p.light.y - p.places[m - 1]->at.p);
            const double cos = std::abs(dot(c.n, d)), cos_light = std::abs(dot(p.light.n, d));
            const double near2 = length2(p.light.y - c.p), far2 = length2(p.light.y - p.places[m - 1]->at.p);
            // By area of the light point, then the ghost as that point sees it: [RP] Eq. (12); back to the solid angle
            // at v_m.
            density *= light_pdf(side.scene, p.light, c.p) * cos_light / near2 * (near2 / cos) *
                       (p.segments[m].cos_sensor / far2) / (cos_light / far2);
            walk_to_sensor(m - 1);
        } else {
            const FilmPoint film = *side.scene.sensor.project(c.p);
            const double cos = std::abs(dot(c.n, film.d));
            const double near2 = sqr(double(film.t)), far2 = length2(p.places[0]->at.p - film.from);
            density *= near2 / cos * p.segments[0].cos_light / far2;
            walk_to_light(0);
        }
    }
    return density / to_measure;
}

TEST(DynamicPath, DensitiesAreThoseOfThePlainTwin) {
    const Fixture scenes_of(
        {{"<translate x=\"0.42\" y=\"-0.74\" z=\"0.3\"/>", "<translate x=\"0.3\" y=\"-0.74\" z=\"0.4\"/>"},
         {"<ref id=\"brushed\"/>", "<ref id=\"white\"/>"},
         {"value=\"-0.35, -0.75, 0.5\"", "value=\"-0.3, -0.7, 0.5\""}});
    const DynamicScenes scenes(*scenes_of.old_scene, *scenes_of.new_scene, scenes_of.edit);
    PathOptions options;
    options.max_depth = 9;
    std::size_t n_paths = 0, n_terms = 0, n_several = 0;
    std::array<std::size_t, n_techniques + 1> seen{};
    std::vector<Term> terms;
    for (const DynamicScene* side : {&scenes.new_scene, &scenes.old_scene}) {
        SampleCounts counts;
        double n = 1000;
        for (auto& by_site : counts.from_site)
            for (auto& from : by_site) from.n = n *= 1.3;
        PathFinder finder(scenes, *side, options);
        const auto check = [&](const FullPath& p, const Found& found) {
            terms.clear();
            const Evaluation e = evaluate(scenes, *side, counts, options, p, &terms);
            ASSERT_TRUE(p.dynamic());
            double sum = 0;
            bool own = found.technique == Technique::path_tracing;
            for (const Term& t : terms) {
                if (t.technique == Technique::path_tracing) continue;
                sum += t.density;
                own |= t.technique == found.technique && t.place == found.place;
                const bool joined_at_mirror = p.vertices[0].specular && t.technique != Technique::dynamic_from_sensor &&
                                              t.technique != Technique::ghost_from_sensor;
                const bool lit_at_mirror =
                    p.vertices[p.m() - 1].specular && t.technique != Technique::ghost_from_emitter;
                const double expected = joined_at_mirror || lit_at_mirror ? 0 : twin(scenes, *side, counts, p, t);
                ASSERT_NEAR(t.density, expected, 2e-4 * expected) << int(t.technique) << " of " << p.m();
                ++n_terms;
                ++seen[std::size_t(t.technique)];
            }
            EXPECT_TRUE(own) << "not found by the technique that has found it: " << int(found.technique);
            EXPECT_NEAR(e.site_density, sum, 1e-9 * sum);
            ++n_paths;
            n_several += terms.size() > 3;
        };
        for (const Family& f : families_of(scenes)) {
            const Technique technique = side->is_new ? f.in_new : f.in_old;
            if (technique == Technique::path_tracing) continue;
            for (std::uint64_t i = 0; i < 20000; ++i)
                finder.find(technique, side->is_new ? f.site_new : f.site_old,
                            Sampler(SamplerKind::independent, 7, std::uint64_t(technique), i), check);
        }
        for (std::uint64_t i = 0; i < 20000; ++i)
            finder.find_from_camera({i % side->scene.sensor.n_pixels(), i}, Sampler(SamplerKind::independent, 8, 0, i),
                                    check);
        EXPECT_LT(finder.n_unrelocated, 3000u);  // of 60000: the bottom of the box coincides with the floor
    }
    EXPECT_GT(n_paths, 100000u);
    EXPECT_GT(n_several, 1000u);
    for (std::size_t t = 1; t < n_techniques; ++t) EXPECT_GT(seen[t], 1000u) << t;
}

TEST(PathMapper, ThereAndBackIsTheSamePath) {
    const Fixture scenes_of(
        {{"<translate x=\"0.42\" y=\"-0.74\" z=\"0.3\"/>", "<translate x=\"0.38\" y=\"-0.74\" z=\"0.35\"/>"},
         {"<ref id=\"brushed\"/>", "<ref id=\"white\"/>"}});
    const DynamicScenes scenes(*scenes_of.old_scene, *scenes_of.new_scene, scenes_of.edit);
    PathOptions options;
    options.max_depth = 9;
    PathFinder finder(scenes, scenes.new_scene, options);
    // Directions that were sampled start off the surface, those between points do not: no short segments.
    const MappingLimits limits{0.2f, 0.1f};
    PathMapper there(scenes, true, limits), back(scenes, false, limits);
    std::size_t n = 0;
    for (const Technique technique : {Technique::dynamic_from_emitter, Technique::dynamic_two_ends})
        for (const Site site : {Site::new_place, Site::repainted})
            for (std::uint64_t i = 0; i < 20000; ++i)
                finder.find(technique, site, Sampler(SamplerKind::independent, 9, std::uint64_t(technique), i),
                            [&](const FullPath& p, const Found& found) {
                                Rejection why;
                                there.start_sample();
                                back.start_sample();
                                const MappedPath* q = there.map(p, found, why);
                                if (!q) return;
                                const MappedPath* r = back.map(q->path, found, why);
                                ASSERT_TRUE(r) << "accepted one way only: " << int(why);
                                EXPECT_NEAR(q->density_ratio * r->density_ratio, 1, 1e-3);
                                for (std::size_t k = 0; k < p.m(); ++k) {
                                    EXPECT_LT(length(r->path.places[k]->at.p - p.places[k]->at.p), 1e-5f);
                                    EXPECT_NEAR(r->path.vertices[k].pdf_light, p.vertices[k].pdf_light,
                                                2e-2 * p.vertices[k].pdf_light + 2e-3);
                                    EXPECT_NEAR(max_channel(r->path.vertices[k].f_cos),
                                                max_channel(p.vertices[k].f_cos),
                                                2e-2 * max_channel(p.vertices[k].f_cos) + 2e-3);
                                }
                                ++n;
                            });
    EXPECT_GT(n, 5000u);
}

// |T'| by finite differences: each vertex is moved a little on its tangent plane, and the partner's vertex follows. The
// measure of a path is that of the directions from one vertex to the next. Detected mutations: the cosine of the start
// left out; distances not squared.
TEST(PathMapper, JacobianIsThatOfFiniteDifferences) {
    const Fixture scenes_of(Changes{{"<translate x=\"0.42\" y=\"-0.74\" z=\"0.3\"/>",
                                     "<rotate y=\"1\" angle=\"25\"/><translate x=\"0.3\" y=\"-0.7\" z=\"0.35\"/>"}});
    const DynamicScenes scenes(*scenes_of.old_scene, *scenes_of.new_scene, scenes_of.edit);
    PathOptions options;
    options.max_depth = 9;
    PathFinder finder(scenes, scenes.new_scene, options);
    PathMapper mapper(scenes, true, {0.2f, 0.1f});
    using Vector = Vector3<double>;
    const auto at = [](const Point3f& p) { return Vector{p.x, p.y, p.z}; };
    /// Solid angle from a point per area that two edges span at another.
    const auto solid_angle = [](const Vector& from, const Vector& to, const std::array<Vector, 2>& edges) {
        std::array<Vector, 2> d;
        for (int k = 0; k < 2; ++k)
            d[std::size_t(k)] =
                normalize(to + edges[std::size_t(k)] - from) - normalize(to - edges[std::size_t(k)] - from);
        return length(cross(d[0], d[1]));
    };
    std::size_t n = 0, n_off = 0;
    for (const Technique technique : {Technique::dynamic_from_emitter, Technique::dynamic_two_ends})
        for (std::uint64_t i = 0; i < 20000; ++i)
            finder.find(technique, Site::new_place, Sampler(SamplerKind::independent, 11, std::uint64_t(technique), i),
                        [&](const FullPath& p, const Found& found) {
                            Rejection why;
                            mapper.start_sample();
                            const MappedPath* q = mapper.map(p, found, why);
                            if (!q) return;
                            double jacobian = 1;
                            for (std::size_t k = 1; k <= p.m(); ++k) {  // vertex k + 1, or the light
                                const bool light = k == p.m();
                                if (light && (p.light.at_infinity || p.light.delta)) continue;
                                const Vector base = light ? at(p.light.y) : at(p.places[k]->at.p),
                                             mapped = light ? at(q->path.light.y) : at(q->path.places[k]->at.p);
                                const Framef frame(light ? p.light.n : p.places[k]->at.ng);
                                const Matrix4d motion =
                                    light || p.places[k] == q->path.places[k]
                                        ? Matrix4d{}
                                        : scenes.new_scene.to_partner[p.places[k]->hit.shape_idx].matrix;
                                std::array<Vector, 2> edges, moved;
                                for (int e = 0; e < 2; ++e) {
                                    const Vector3f t = frame.to_world(e == 0 ? Vector3f{1, 0, 0} : Vector3f{0, 1, 0});
                                    edges[std::size_t(e)] = Vector{t.x, t.y, t.z} * 1e-5;
                                    moved[std::size_t(e)] = motion.vector(edges[std::size_t(e)]);
                                }
                                jacobian *= solid_angle(at(q->path.places[k - 1]->at.p), mapped, moved) /
                                            solid_angle(at(p.places[k - 1]->at.p), base, edges);
                            }
                            n_off += std::abs(q->density_ratio - jacobian) > 2e-3 * jacobian;
                            ++n;
                        });
    EXPECT_GT(n, 1000u);
    EXPECT_LT(n_off, n / 500) << "more than the few whose cosines are all rounding";
}

}  // namespace
}  // namespace loom::residual
