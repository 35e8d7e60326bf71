// The linear system of a path graph against its plain twin, and what its iteration must do.

#include <gtest/gtest.h>

#include <algorithm>
#include <cstring>
#include <map>
#include <numeric>
#include <set>

#include "formats/io/octahedral.h"
#include "stages/refine/solve.h"
#include "tests/traced_graph.h"

namespace loom {
namespace {

using refine::build_system;
using refine::Clamp;
using refine::Light;
using refine::path_radiance;
using refine::System;
using testing::clusters_of;
using testing::own_scene;
using testing::path_options;
using testing::trace_graph;

using Rgbd = Rgb<double>;
using Vector3d = Vector3<double>;

struct Value {
    Rgbd f_cos;
    double pdf_w;
};

/// A single vertex, all in double precision; the loops read the graph's values, in floats.
class PlainVertex {
  public:
    PlainVertex(const GraphReader& reader, std::size_t j) : at_(reader.vertex(j)), bsdf_(*at_.bsdf.model) {
        const Bsdf<float>& b = at_.bsdf;
        bsdf_.diffuse = Rgbd(b.diffuse), bsdf_.specular = Rgbd(b.specular), bsdf_.transmittance = Rgbd(b.transmittance);
        bsdf_.alpha_u = b.alpha_u, bsdf_.alpha_v = b.alpha_v, bsdf_.opacity = b.opacity;
        const auto& v = reader.graph().vertices;
        nee = (v.flags[j] & vertex_flag::attempted_nee) != 0;
        q = (v.flags[j] & vertex_flag::attempted_bsdf) ? (v.q.empty() ? 1.0 : v.q[j]) : 0.0;
    }

    bool nee;  // attempted next-event estimation
    double q;  // survival of a BSDF sample; 0 where none was attempted

    Vector3d p() const { return {at_.p.x, at_.p.y, at_.p.z}; }
    Value value(const Vector3d& wi) const {
        const auto along = [&](const auto& axis) { return wi.x * axis.x + wi.y * axis.y + wi.z * axis.z; };
        const Vector3d local{along(at_.frame.s), along(at_.frame.t), along(at_.frame.n)};
        const Vector3d wo{at_.wo_local.x, at_.wo_local.y, at_.wo_local.z};
        const BsdfValue<double> v = f_cos_pdf(bsdf_, wo, local);
        const double shadow =
            at_.perturbed ? bump_shadowing(at_, Vector3f(float(wi.x), float(wi.y), float(wi.z)), float(local.z)) : 1.0;
        return {v.f_cos * shadow, v.pdf_w};
    }

  private:
    ShadingPoint at_;
    Bsdf<double> bsdf_;
};

/// Source of an edge's light, in the measure that all vertices of a cluster share.
struct PlainLight {
    enum { direction, surface_point, point } kind;
    Vector3d y, n;  // n: towards the source vertex

    Value at(const PlainVertex& v) const {
        if (kind == direction) return v.value(y);
        const Vector3d d = y - v.p();
        const double d2 = dot(d, d), distance = std::sqrt(d2);
        const double G = kind == point ? 1 / d2 : std::max(-dot(d, n), 0.0) / (distance * d2);
        const Value value = v.value(d / distance);
        return {value.f_cos * G, value.pdf_w * G};
    }
};

Vector3d stored_normal(const Column<std::int16_t>& column, std::size_t i) {
    const auto n = unit_from_octahedral(column[2 * i], column[2 * i + 1]);
    return {n[0], n[1], n[2]};
}
Vector3d row(const Column<float>& column, std::size_t i, std::size_t width = 3) {
    return {column[width * i], column[width * i + 1], column[width * i + 2]};
}

/// One cluster by the equations at the top of cluster_edges.h, each sum written out: O(K^2) per edge.
struct PlainCluster {
    // by the vertex that light comes from: coefficient of each member
    std::map<std::uint32_t, std::vector<Rgbd>> columns;
    std::vector<double> survival;  // of each member, 0 where it drew no BSDF sample
    std::vector<Rgbd> direct;      // of each member

    PlainCluster(const GraphReader& reader, std::span<const std::uint32_t> member, Reuse reuse)
        : direct(member.size()) {
        const PathGraph& g = reader.graph();
        std::vector<PlainVertex> v;
        for (const std::uint32_t j : member) survival.push_back(v.emplace_back(reader, j).q);
        for (std::size_t source = 0; source < member.size(); ++source) {
            const std::uint32_t j = member[source];
            const bool delta_lobe = is_delta(Lobe(g.vertices.lobe[j]));
            if ((g.vertices.flags[j] & vertex_flag::continued) && !delta_lobe) {
                const Vector3d wo_next = row(g.vertices.wo, j + 1);
                PlainLight light{PlainLight::direction, wo_next * -1.0, {}};
                if (reuse == Reuse::points) {
                    const Vector3d ng = stored_normal(g.vertices.ng.empty() ? g.vertices.ns : g.vertices.ng, j + 1);
                    light = {PlainLight::surface_point, row(g.vertices.p, j + 1),
                             dot(ng, wo_next) < 0 ? ng * -1.0 : ng};
                }
                double rho = 0;
                for (const PlainVertex& k : v) rho += k.q * light.at(k).pdf_w;
                if (rho > 0) {
                    auto& column = columns[j + 1];
                    for (const PlainVertex& k : v) column.push_back(light.at(k).f_cos / rho);
                }
            }
            const auto& e = g.light_edges;
            for (std::size_t i = 0; i < e.vertex.size(); ++i) {
                if (e.vertex[i] != j) continue;
                const bool bsdf_hit = LightTechnique(e.technique[i]) == LightTechnique::bsdf_hit;
                if (bsdf_hit && delta_lobe) {  // of this vertex alone
                    Rgbd own(own_light(reader, reader.vertex(j), j, i));
                    direct[source] += own;
                    continue;
                }
                Rgbd Li(e.Li[3 * i], e.Li[3 * i + 1], e.Li[3 * i + 2]);
                const Vector3d y = row(e.y, i, 4), d = y - v[source].p();
                const EmitterKind kind = EmitterKind(g.emitters.kind[e.emitter[i]]);
                double p_nee = e.pdf_nee_w[i];
                PlainLight light{PlainLight::direction, y, {}};
                bool discrete = kind == EmitterKind::directional;
                if (kind == EmitterKind::point || kind == EmitterKind::spot) {
                    light.kind = PlainLight::point;
                    Li = Li * dot(d, d);  // intensity
                    discrete = true;
                }
                if (kind == EmitterKind::area) {
                    Vector3d n = stored_normal(e.n, i);
                    if (dot(n, d) > 0) n = n * -1.0;
                    light = {PlainLight::surface_point, y, n};
                    p_nee *= -dot(n, d) / (dot(d, d) * std::sqrt(dot(d, d)));
                }
                double rho = 0;
                for (const PlainVertex& k : v) {
                    const Value at_k = light.at(k);
                    // A sample that a vertex does not reflect is dropped before its shadow ray: no attempt of that one.
                    const bool reflects = at_k.f_cos.r + at_k.f_cos.g + at_k.f_cos.b > 0;
                    if (k.nee && reflects) rho += p_nee;
                    if (!discrete) rho += k.q * at_k.pdf_w;
                }
                if (rho > 0)
                    for (std::size_t k = 0; k < v.size(); ++k) direct[k] += light.at(v[k]).f_cos * Li / rho;
            }
        }
    }
};

double max_channel_of(const Rgbd& c) {
    return std::max({c.r, c.g, c.b});
}

struct TwinCase {
    const char* scene;
    double tolerance;  // of sharp lobes in floats
    std::uint32_t k = 16;
    std::size_t min_edges = 50;  // shared continuations there must be
};
void PrintTo(const TwinCase& c, std::ostream* out) {
    *out << c.scene;
}

std::string name_of(std::string text) {
    if (const auto ending = text.find(".xml"); ending != std::string::npos) text.erase(ending);
    for (char& c : text)
        if (!std::isalnum(static_cast<unsigned char>(c))) c = '_';
    return text;
}

/// Returns the vertex of each unknown.
std::vector<std::uint32_t> vertices_of(const System& s) {
    std::vector<std::uint32_t> vertex(s.n_unknowns, System::nothing);
    for (std::uint32_t j = 0; j < s.n_unknowns; ++j) {
        EXPECT_EQ(vertex.at(s.unknown[j]), System::nothing);
        vertex[s.unknown[j]] = j;
    }
    return vertex;
}

class SystemTwin : public ::testing::TestWithParam<TwinCase> {};

// Every coefficient within half a step of its 16 bits (1 / 65535 of the column's largest) and the tolerance. Direct
// light within the tolerance, relative to the value and a tenth of the cluster's largest: 1e-5, and 1e-4 where narrow
// lobes of refraction amplify the rounding of directions. Detected mutations: see the commit of this file.
TEST_P(SystemTwin, CoefficientsAndDirectLight) {
    const TwinCase& param = GetParam();
    const auto scene = own_scene(param.scene, 14, 11);
    const PathGraph graph = trace_graph(*scene, path_options(*scene, 5), 2);
    const GraphReader reader(graph);
    const Clusters clusters = clusters_of(graph, param.k, 3);
    for (const Reuse reuse : {Reuse::directions, Reuse::points})
        for (const Clamp clamp : {Clamp::none, Clamp::column}) {
            const System s = build_system(graph, clusters, {{reuse}, clamp, 0.05f, 2});
            const std::vector<std::uint32_t> vertex = vertices_of(s);
            std::size_t n_clamped = 0, n_edges = 0, n_flat_edges = 0, n_strays = 0;
            double largest = 0, worst_direct = 0, worst_coefficient = 0, sum = 0, taken = 0;
            for (std::size_t c = 0; c < clusters.n_clusters(); ++c) {
                const auto member =
                    clusters.member.values().subspan(clusters.first[c], clusters.first[c + 1] - clusters.first[c]);
                const PlainCluster twin(reader, member, reuse);
                n_edges += s.n_edges[c];
                std::set<std::uint32_t> seen;
                for (int e = 0; e < s.n_edges[c]; ++e) {
                    const std::size_t slot = s.first[c] + e;
                    const std::uint32_t end = vertex[s.edges[slot].end];
                    ASSERT_TRUE(seen.insert(end).second);
                    if (!twin.columns.contains(end)) continue;
                    auto column = twin.columns.at(end);
                    Rgbd column_sum, most;  // the sum is of basic radiance, L / eta^2, weighted with survival
                    const auto eta2 = [&](std::uint32_t j) {
                        return graph.vertices.eta.empty() ? 1.0 : sqr(double(graph.vertices.eta[j]));
                    };
                    for (std::size_t k = 0; k < column.size(); ++k) {
                        Rgbd& a = column[k];
                        // A vertex that drew no BSDF sample reflects at most what comes in; a grey coat loses the rest,
                        // else all channels are scaled.
                        const double limit = eta2(member[k]) / eta2(end), largest_of_vertex = max_channel_of(a);
                        if (clamp == Clamp::column && twin.survival[k] == 0 && largest_of_vertex > limit &&
                            !s.shape[c].flat)
                            a = s.shape[c].channels() ? a * (limit / largest_of_vertex)
                                                      : a - Rgbd(largest_of_vertex - limit);
                        column_sum += a * (twin.survival[k] * eta2(end) / eta2(member[k]));
                        most = {std::max(most.r, a.r), std::max(most.g, a.g), std::max(most.b, a.b)};
                    }
                    const double bound = 1 - 0.05;
                    double factor = 1;
                    largest = std::max(largest, max_channel_of(column_sum));
                    if (clamp == Clamp::column && max_channel_of(column_sum) > bound) {
                        factor = bound / max_channel_of(column_sum);
                        n_clamped += max_channel_of(column_sum) > bound * (1 + 1e-5);
                    }
                    sum += column_sum.r + column_sum.g + column_sum.b;
                    taken += (column_sum.r + column_sum.g + column_sum.b) * (1 - factor);
                    n_flat_edges += s.shape[c].flat;
                    for (std::size_t k = 0; k < member.size(); ++k) {
                        const Spectrum coefficient = s.coefficient(c, e, int(s.unknown[member[k]] - s.first[c]));
                        for (int channel = 0; channel < 3; ++channel) {
                            const double ours = coefficient[channel];
                            const double step = s.shape[c].flat ? 0 : most[channel] * factor / 65535,
                                         exact = column[k][channel] * factor;
                            const double error = std::abs(ours - exact);
                            ASSERT_LE(error, 0.501 * step + param.tolerance * (exact + 0.1 * most[channel] * factor))
                                << "cluster " << c;
                            if (exact > 1e-3 * most[channel])
                                worst_coefficient = std::max(worst_coefficient, (error - 0.5 * step) / exact);
                        }
                    }
                }
                Rgbd brightest;
                for (const Rgbd& d : twin.direct)
                    if (max_channel_of(d) > max_channel_of(brightest)) brightest = d;
                // A grazing direction may lie on either side of a surface.
                for (const std::uint32_t end : seen) n_strays += !twin.columns.contains(end);
                for (const auto& [end, column] : twin.columns) n_strays += !seen.contains(end);
                for (std::size_t k = 0; k < member.size(); ++k) {
                    const Light B = s.at[s.unknown[member[k]]].B;
                    const Rgbd ours(B.r, B.g, B.b);
                    for (int channel = 0; channel < 3; ++channel) {
                        ASSERT_NEAR(ours[channel], twin.direct[k][channel],
                                    param.tolerance * (twin.direct[k][channel] + 0.1 * max_channel_of(brightest)))
                            << "cluster " << c << ", " << graph.materials.id[graph.vertices.material[member[k]]];
                        if (twin.direct[k][channel] > 1e-3 * max_channel_of(brightest))
                            worst_direct =
                                std::max(worst_direct, std::abs(ours[channel] / twin.direct[k][channel] - 1));
                    }
                }
            }
            EXPECT_GE(n_edges, param.min_edges);
            if (param.scene == std::string("cornell-box.xml")) {
                EXPECT_EQ(n_flat_edges > 0, reuse == Reuse::directions);
            }
            EXPECT_LE(n_strays, n_edges / 100);
            EXPECT_EQ(s.n_columns, n_edges);
            EXPECT_NEAR(s.largest_column_sum, largest, 10 * param.tolerance * largest);
            if (clamp == Clamp::column) {
                EXPECT_NEAR(double(s.n_clamped), double(n_clamped), 0.01 * n_edges + 1);
                EXPECT_NEAR(s.clamped_share, sum > 0 ? taken / sum : 0, 1e-3);
            } else {
                EXPECT_EQ(s.n_clamped, 0u);
                EXPECT_EQ(s.clamped_share, 0);
            }
            std::printf("    %s, %s: relative error of direct light %.1e, of coefficients beyond half a step %.1e\n",
                        param.scene, reuse == Reuse::points ? "points" : "directions", worst_direct, worst_coefficient);
        }
}

// Delta lobes and vertices in no cluster: their own samples, by path tracing's formula and heuristic.
TEST_P(SystemTwin, PrivateEdgesAndSolitaryVertices) {
    const auto scene = own_scene(GetParam().scene, 14, 11);
    const PathGraph graph = trace_graph(*scene, path_options(*scene, 6), 2);
    const GraphReader reader(graph);
    const Clusters clusters = clusters_of(graph, GetParam().k, 4);
    const System s = build_system(graph, clusters, {});
    const std::vector<std::uint32_t> vertex = vertices_of(s);
    std::vector<bool> shares(graph.n_vertices());
    for (const std::uint32_t j : clusters.member) shares[j] = true;
    std::map<std::uint32_t, const System::Private*> by_vertex;
    for (const System::Private& p : s.privates) EXPECT_TRUE(by_vertex.emplace(vertex[p.unknown], &p).second) << "twice";
    std::size_t expected = 0;
    for (std::uint32_t j = 0; j < graph.n_vertices(); ++j) {
        const Lobe lobe = Lobe(graph.vertices.lobe[j]);
        const ShadingPoint at = reader.vertex(j);
        if ((graph.vertices.flags[j] & vertex_flag::continued) && (is_delta(lobe) || !shares[j])) {
            ++expected;
            ASSERT_TRUE(by_vertex.contains(j));
            EXPECT_EQ(vertex[by_vertex[j]->end], j + 1);
            const Vector3f wi = continuation_direction(graph, j);
            const Spectrum f = is_delta(lobe) ? delta_value(at.bsdf, at.wo_local, lobe) : f_cos_pdf(at, wi).f_cos;
            const float bump = is_delta(lobe) && at.perturbed && lobe != Lobe::null
                                   ? bump_shadowing(at, wi, at.frame.to_local(wi).z)
                                   : 1.0f;
            for (int c = 0; c < 3; ++c)
                EXPECT_NEAR(by_vertex[j]->weight[c], f[c] * bump / graph.vertices.pdf_w[j],
                            1e-6f * f[c] / graph.vertices.pdf_w[j]);
        }
        if (shares[j]) continue;
        Spectrum own(0);
        for (std::size_t k = first_light_edge(graph, j); k < graph.n_light_edges() && graph.light_edges.vertex[k] == j;
             ++k)
            own += own_light(reader, at, j, k);
        const Light B = s.at[s.unknown[j]].B;
        EXPECT_EQ(Spectrum(B.r, B.g, B.b), own);
    }
    EXPECT_EQ(s.privates.size(), expected);
}

INSTANTIATE_TEST_SUITE_P(Scenes, SystemTwin,
                         ::testing::Values(TwinCase{"cornell-box.xml", 1e-5}, TwinCase{"cornell-box.xml", 1e-5, 61},
                                           TwinCase{"all-emitters.xml", 1e-5, 16, 40}, TwinCase{"glossy-box.xml", 1e-4},
                                           TwinCase{"caustic.xml", 1e-5, 5, 30}, TwinCase{"textured.xml", 1e-5, 3, 0},
                                           TwinCase{"mask.xml", 1e-5, 16, 0},
                                           TwinCase{"environment-map.xml", 1e-5, 16, 0}),
                         [](const auto& info) {
                             return name_of(info.param.scene) + "_k" + std::to_string(info.param.k);
                         });

HugeArray<Light> direct_of(const System& s) {
    HugeArray<Light> out(s.n_unknowns);
    for (std::size_t k = 0; k < s.n_unknowns; ++k) out[k] = s.at[k].B;
    return out;
}

/// Largest difference over the mean value, and the same as a ratio of sums.
struct Difference {
    double largest = 0, mean = 0;
};
Difference difference(const HugeArray<Light>& a, const HugeArray<Light>& b) {
    double largest = 0, sum = 0, level = 0;
    for (std::size_t i = 0; i < a.size(); ++i)
        for (const auto& [x, y] : {std::pair{a[i].r, b[i].r}, {a[i].g, b[i].g}, {a[i].b, b[i].b}}) {
            largest = std::max(largest, double(std::abs(x - y)));
            sum += std::abs(x - y);
            level += std::abs(y);
        }
    return {largest / (level / double(3 * a.size())), sum / level};
}

/// path_radiance in the order of unknowns.
HugeArray<Light> by_unknown(const System& s, const HugeArray<Light>& by_vertex) {
    HugeArray<Light> out(s.n_unknowns);
    for (std::size_t j = 0; j < s.n_unknowns; ++j) out[s.unknown[j]] = by_vertex[j];
    return out;
}

int longest_path(const PathGraph& g) {
    std::uint64_t n = 0;
    for (std::size_t i = 0; i < g.n_paths(); ++i)
        n = std::max(n, g.paths.first_vertex[i + 1] - g.paths.first_vertex[i]);
    return int(n);
}

class SystemOfOne : public ::testing::TestWithParam<const char*> {};

// With clusters of one, pooled densities are the balance heuristic and M is the step along the path. From zero the
// iteration ends at the estimate of path tracing, after as many steps as the longest path has edges between vertices.
// Every vertex within 2e-5 of the vertices' mean (rounding of up to 16 bounces). Detected mutations: the power
// heuristic; the delta branch dropped; q left out of the densities.
TEST_P(SystemOfOne, IsPathTracing) {
    const auto scene = own_scene(GetParam(), 32, 24);
    PathOptions path = path_options(*scene, 7);
    path.rr_depth = 2;
    const PathGraph graph = trace_graph(*scene, path, 2);
    const GraphReader reader(graph);
    const Clusters singles = clusters_of(graph, 1, 0, 0);  // nearly specular ones, too
    for (const std::uint32_t first : {0u}) ASSERT_EQ(singles.first[first], first);
    ASSERT_EQ(singles.n_clusters(), singles.n_members());
    const System s = build_system(graph, singles, {{}, Clamp::none, 0, 0});
    const int steps = longest_path(graph) - 1;
    ASSERT_GE(steps, 1);
    HugeArray<Light> X = direct_of(s);
    refine::solve(s, {}, {steps, Clamp::none, 0, 0}, X);
    const HugeArray<Light> balance = by_unknown(s, path_radiance(reader, 0, Heuristic::balance));
    const Difference from_zero = difference(X, balance);
    EXPECT_LT(from_zero.mean, 1e-5);
    EXPECT_LT(from_zero.largest, GetParam() == std::string("cornell-box.xml") ? 1e-4 : 1e-3);
    // The iteration stays there.
    HugeArray<Light> Y = by_unknown(s, path_radiance(reader, 0, Heuristic::balance));
    refine::solve(s, {}, {3, Clamp::none, 0, 0}, Y);
    EXPECT_LT(difference(Y, balance).mean, 1e-5);
    // The power heuristic is another estimate of the same light, not the same number.
    if (GetParam() == std::string("cornell-box.xml")) {
        EXPECT_GT(difference(by_unknown(s, path_radiance(reader, 0, Heuristic::power)), balance).mean, 1e-3);
    }
    std::printf("    %s: mean difference %.1e, largest %.1e, after %d steps\n", GetParam(), from_zero.mean,
                from_zero.largest, steps);
}

// D edges of a path are D - 2 steps from zero: one step fewer lacks light, the right number has all.
TEST_P(SystemOfOne, FromDarknessDepthIsCounted) {
    const auto scene = own_scene(GetParam(), 24, 18);
    for (const int depth : {2, 3, 5}) {
        PathOptions path = path_options(*scene, 8);
        path.max_depth = depth;
        const PathGraph graph = trace_graph(*scene, path, 2);
        const GraphReader reader(graph);
        const Clusters singles = clusters_of(graph, 1, 0, 0);
        refine::Options options;
        options.clamp = Clamp::none;
        const Radiance radiance = testing::radiance_of(graph, singles, options);
        EXPECT_EQ(radiance.settings.start, "zero");
        EXPECT_EQ(radiance.settings.iterations, depth - 2);
        const HugeArray<Light> balance = path_radiance(reader, 0, Heuristic::balance);
        double sum = 0, level = 0;
        for (std::size_t j = 0; j < graph.n_vertices(); ++j) {
            sum += std::abs(radiance.L[3 * j] - balance[j].r) + std::abs(radiance.L[3 * j + 1] - balance[j].g);
            level += balance[j].r + balance[j].g;
        }
        EXPECT_LT(sum, 5e-6 * level) << depth;
        if (depth == 2) continue;
        const System s = build_system(graph, singles, {{}, Clamp::none, 0, 0});
        HugeArray<Light> X = direct_of(s);
        refine::solve(s, {}, {depth - 3, Clamp::none, 0, 0}, X);
        if (GetParam() == std::string("cornell-box.xml") || GetParam() == std::string("glossy-box.xml")) {
            EXPECT_GT(difference(X, by_unknown(s, balance)).mean, 1e-3);
        }
    }
}

INSTANTIATE_TEST_SUITE_P(Scenes, SystemOfOne,
                         ::testing::Values("cornell-box.xml", "glossy-box.xml", "all-emitters.xml", "caustic.xml",
                                           "environment-map.xml"),
                         [](const auto& info) { return name_of(info.param); });

class SystemSolve : public ::testing::TestWithParam<const char*> {};

// Where steps count bounces, light of a first hit's continuation has one less: exactly the first hit's input. Detected
// mutations: the last step for all; none of the last two for the others.
TEST_P(SystemSolve, LastStepIsForFirstHits) {
    const auto scene = own_scene(GetParam(), 24, 18);
    const PathGraph graph = trace_graph(*scene, path_options(*scene, 10), 1);
    const System s = build_system(graph, clusters_of(graph, 16, 1), {});
    std::vector<std::uint32_t> first_hits;
    for (std::size_t i = 0; i < graph.n_paths(); ++i)
        if (graph.paths.first_vertex[i] < graph.paths.first_vertex[i + 1])
            first_hits.push_back(s.unknown[graph.paths.first_vertex[i]]);
    std::vector<std::uint8_t> is_first_hit(s.n_unknowns);
    for (const std::uint32_t k : first_hits) is_first_hit[k] = 1;
    for (const int steps : {1, 2, 4}) {
        HugeArray<Light> X = direct_of(s), all = direct_of(s), before = direct_of(s);
        refine::solve(s, first_hits, {steps, Clamp::column, 1e-3f, 0, true}, X);
        refine::solve(s, first_hits, {steps}, all);
        refine::solve(s, first_hits, {steps - 1}, before);
        EXPECT_GT(difference(all, before).mean, 1e-4);
        for (std::size_t k = 0; k < s.n_unknowns; ++k) {
            const Light& expected = is_first_hit[k] ? all[k] : before[k];
            ASSERT_EQ(X[k].r, expected.r) << steps;
            ASSERT_EQ(X[k].g, expected.g) << steps;
            ASSERT_EQ(X[k].b, expected.b) << steps;
        }
    }
}

// From zero and from the noisy paths, 200 steps lead to one fixed point: relative difference below 1e-5.
TEST_P(SystemSolve, BothStartsMeet) {
    const auto scene = own_scene(GetParam(), 32, 24);
    const PathGraph graph = trace_graph(*scene, path_options(*scene, 9), 1);
    const Clusters clusters = clusters_of(graph, 16, 1);
    const System s = build_system(graph, clusters, {});
    HugeArray<Light> zero = direct_of(s), paths = by_unknown(s, path_radiance(GraphReader(graph), 0));
    EXPECT_GT(difference(zero, paths).mean, 0.1);
    const auto log = refine::solve(s, {}, {200}, zero);
    refine::solve(s, {}, {200}, paths);
    EXPECT_EQ(log.size(), 200u);
    EXPECT_LT(log.back().residual, 1e-6);
    EXPECT_LT(difference(zero, paths).mean, 1e-5);
    std::printf("    %s: the starts end %.1e apart\n", GetParam(), difference(zero, paths).mean);
}

TEST_P(SystemSolve, ThreadsDoNotMatter) {
    const auto scene = own_scene(GetParam(), 64, 48);
    const PathGraph graph = trace_graph(*scene, path_options(*scene, 10), 1);
    for (const Clamp clamp : {Clamp::column, Clamp::cluster}) {
        HugeArray<Light> X[2];
        std::vector<refine::Iteration> log[2];
        for (const int threads : {1, 2}) {
            const System s = build_system(graph, clusters_of(graph, 16), {{}, clamp, 1e-3f, threads});
            std::vector<std::uint32_t> first_hits;
            for (std::size_t k = 0; k < s.n_unknowns; k += 3) first_hits.push_back(std::uint32_t(k));
            X[threads - 1] = direct_of(s);
            log[threads - 1] = refine::solve(s, first_hits, {5, clamp, 1e-3f, threads}, X[threads - 1]);
        }
        ASSERT_EQ(X[0].size(), X[1].size());
        EXPECT_EQ(std::memcmp(X[0].data(), X[1].data(), X[0].size() * sizeof(Light)), 0);
        ASSERT_EQ(log[0].size(), log[1].size());
        for (std::size_t i = 0; i < log[0].size(); ++i) {
            EXPECT_EQ(log[0][i].residual, log[1][i].residual);
            EXPECT_EQ(log[0][i].image_change, log[1][i].image_change);
            EXPECT_EQ(log[0][i].clamped_share, log[1][i].clamped_share);
        }
    }
}

/// Growth of light per step when no more comes in: the spectral radius of M, from below in the long run.
double spectral_radius(System& s, int steps) {
    for (std::size_t k = 0; k < s.n_unknowns; ++k) s.at[k].B = {};
    HugeArray<Light> X(s.n_unknowns);
    for (std::size_t k = 0; k < s.n_unknowns; ++k) X[k] = {1, 1, 1, 0};
    double growth = 0, before = 3.0 * double(s.n_unknowns);
    for (int i = 0; i < steps; ++i) {
        if (refine::solve(s, {}, {1, Clamp::none, 0, 0}, X).empty()) return 0;  // all light is gone
        double sum = 0;
        for (std::size_t k = 0; k < s.n_unknowns; ++k) sum += double(X[k].r) + X[k].g + X[k].b;
        growth = sum / before;
        before = sum;
        if (before < 1e-20) return growth;
    }
    return growth;
}

/// A closed room of plaster with an emitter, a ball of plastic, one of rough plastic and one of rough metal.
std::unique_ptr<Scene> glossy_room() {
    return testing::load_inline({R"(type="perspective"><float name="fov" value="80"/>
<transform name="to_world"><lookat origin="-0.9, -0.9, 0.8" target="0.3, 0.3, -0.2" up="0, 0, 1"/></transform>)",
                                 R"(
<shape type="cube"><boolean name="flip_normals" value="true"/>
  <bsdf type="diffuse"><rgb name="reflectance" value="0.8, 0.75, 0.7"/></bsdf></shape>
<shape type="rectangle"><transform name="to_world"><scale x="0.3" y="0.3"/><rotate x="1" angle="180"/><translate z="0.98"/></transform>
  <bsdf type="diffuse"><rgb name="reflectance" value="0.1"/></bsdf>
  <emitter type="area"><rgb name="radiance" value="10"/></emitter></shape>
<shape type="sphere"><point name="center" value="0.4, -0.3, -0.6"/><float name="radius" value="0.4"/>
  <bsdf type="plastic"><rgb name="diffuse_reflectance" value="0.6, 0.3, 0.2"/></bsdf></shape>
<shape type="sphere"><point name="center" value="-0.3, 0.5, -0.5"/><float name="radius" value="0.45"/>
  <bsdf type="roughconductor"><float name="alpha" value="0.2"/><string name="material" value="Ag"/></bsdf></shape>
<shape type="sphere"><point name="center" value="0.6, 0.6, 0.2"/><float name="radius" value="0.35"/>
  <bsdf type="roughplastic"><float name="alpha" value="0.1"/><rgb name="diffuse_reflectance" value="0.5"/></bsdf></shape>)",
                                 48, 36, -1});
}

double radius_of(const Scene& scene, Clamp clamp, std::uint64_t seed, float& largest_column_sum) {
    PathOptions path = path_options(scene, seed);
    path.max_depth = -1;
    const PathGraph graph = trace_graph(scene, path, 1);
    System s = build_system(graph, clusters_of(graph, 16), {{}, clamp, 1e-3f, 0});
    largest_column_sum = s.largest_column_sum;
    return spectral_radius(s, 40);
}

// Lobes are chosen by energy, so that weights f cos / p stay near what a surface reflects, and M contracts by itself:
// with column sums below 1 it must (1.06: what a lobe's masking leaves of a weight).
TEST(SystemSpectrum, IsAContractionWithoutAnyClamp) {
    const std::pair<const char*, std::unique_ptr<Scene>> scenes[]{
        {"cornell-box", own_scene("cornell-box.xml", 48, 36)},
        {"all-emitters", own_scene("all-emitters.xml", 48, 36)},
        {"glossy room", glossy_room()}};
    for (const auto& [name, scene] : scenes) {
        float largest = 0;
        const double radius = radius_of(*scene, Clamp::none, 11, largest);
        EXPECT_LT(radius, 1) << name;
        EXPECT_GT(radius, 0.05) << name;
        EXPECT_LT(largest, 1.06) << name;
        std::printf("    %s: largest column sum %.3f, spectral radius %.3f\n", name, largest, radius);
    }
}

// Neighbours on rough glass may see a continuation on the other side of their surface, in the other medium: columns of
// up to 2.4, and modes that grow. The clamp bounds all columns, and so the spectrum.
TEST(SystemSpectrum, ColumnClampMakesAContractionOfRoughGlass) {
    const auto scene = own_scene("glossy-box.xml", 48, 36);
    float largest = 0;
    const double free_radius = radius_of(*scene, Clamp::none, 11, largest);
    EXPECT_GT(largest, 1);
    const double radius = radius_of(*scene, Clamp::column, 11, largest);
    EXPECT_LT(radius, 1);
    EXPECT_GT(radius, 0.05);
    std::printf("    spectral radius %.3f, %.3f with the clamp\n", free_radius, radius);
}

INSTANTIATE_TEST_SUITE_P(Scenes, SystemSolve,
                         ::testing::Values("cornell-box.xml", "glossy-box.xml", "all-emitters.xml"),
                         [](const auto& info) { return name_of(info.param); });

/// n vertices in one cluster, each lit by the next one with weight `gain`.
System ring(std::uint32_t n, float gain, float survival = 1) {
    System s;
    s.n_unknowns = n, s.n_clusters = 1;
    s.unknown = HugeArray<std::uint32_t>(n);
    s.at = HugeArray<System::Row>(n), s.edges = HugeArray<System::Edge>(n);
    s.edge_survival = HugeArray<float>(n), s.inv_eta2 = HugeArray<float>(n);
    s.first = {0, n}, s.n_edges = {std::uint16_t(n)}, s.shape = {{}}, s.block = {0};
    s.blocks = HugeArray<std::byte>(s.shape[0].bytes(int(n), padded_lanes(int(n))));
    const System::BlockAt<std::byte> block(s.blocks.data(), s.shape[0], int(n), padded_lanes(int(n)));
    for (std::uint32_t j = 0; j < n; ++j) {
        s.unknown[j] = j;
        s.at[j].B = {1, 0.5f, 0.25f, 0};
        s.edges[j] = {1, (j + 1) % n};
        std::fill_n(block.scale + 3 * j, 3, gain / 65535);
        s.edge_survival[j] = survival;
        s.inv_eta2[j] = 1;
        for (int channel = 0; channel < 3; ++channel)
            block.fraction[(3 * j + channel) * padded_lanes(int(n)) + j] = 65535;  // to itself alone
    }
    return s;
}

// X = 0.5 X + B is B / (1 - 0.5).
TEST(SystemByHand, HasItsClosedForm) {
    const System s = ring(5, 0.5f);
    HugeArray<Light> X(5);
    const auto log = refine::solve(s, std::vector<std::uint32_t>{0, 3}, {60, Clamp::none}, X);
    ASSERT_EQ(log.size(), 60u);
    for (std::size_t k = 0; k < 5; ++k) {
        EXPECT_NEAR(X[k].r, 2, 1e-6);
        EXPECT_NEAR(X[k].b, 0.5, 1e-6);
    }
    EXPECT_NEAR(log[1].residual, 1.0 / 3, 1e-6);  // from 1 to 1.5
    EXPECT_NEAR(log[1].image_change, 1.0 / 3, 1e-6);
}

// Column sums of 1.5 make more light of light at each step: found out within a few, long before anything overflows.
TEST(SystemByHand, DivergenceIsDetected) {
    const System s = ring(5, 1.5f);
    HugeArray<Light> X = direct_of(s);
    const auto log = refine::solve(s, {}, {100, Clamp::none}, X);
    EXPECT_LT(log.size(), 8u);
    for (std::size_t k = 0; k < 5; ++k) EXPECT_TRUE(std::isfinite(X[k].r));
}

// The input may not grow, for any coefficients: 1 - epsilon of it is passed on, and the log reports the rest.
TEST(SystemByHand, ClusterClampTamesIt) {
    const System s = ring(5, 1.5f);
    HugeArray<Light> X = direct_of(s);
    const auto log = refine::solve(s, {}, {2000, Clamp::cluster, 0.1f}, X);
    ASSERT_EQ(log.size(), 2000u);
    for (std::size_t i = 1; i < 100; ++i) EXPECT_LT(log[i].residual, log[i - 1].residual) << i;
    EXPECT_NEAR(X[2].r, 1 / (1 - 0.9), 1e-3);
    EXPECT_NEAR(log.back().clamped_share, 1 - 0.9 / 1.5, 1e-5);
}

// An edge that survived roulette with q represents 1 / q edges: that much input is allowed.
TEST(SystemByHand, ClusterClampKnowsRoulette) {
    const System s = ring(5, 1.5f, 0.5f);
    HugeArray<Light> X = direct_of(s);
    const auto log = refine::solve(s, {}, {3, Clamp::cluster, 0.1f}, X);
    for (const auto& i : log) EXPECT_EQ(i.clamped_share, 0);
}

}  // namespace
}  // namespace loom
