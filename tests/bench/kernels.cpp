#include <fmt/format.h>

#include <cmath>
#include <set>
#include <vector>

#include "stages/core/app/report.h"
#include "stages/core/edges/edge_tree.h"
#include "stages/core/scattering/gradient.h"
#include "tests/bench/bench.h"
#include "tests/unit/bsdf_cases.h"
#include "tests/unit/icosphere.h"

namespace loom::bench {
namespace {

constexpr int n = 1 << 14;  // in the cache

/// Nanoseconds per element of body(i) over n elements, the fastest of many rounds. Its sum is kept.
template <class Body>
double ns_per_element(Body&& body) {
    [[maybe_unused]] static volatile float sink;
    double fastest = INFINITY;
    for (int round = 0; round < 15; ++round)
        fastest = std::min(fastest, seconds_of([&] {
                               float sum = 0;
                               for (int i = 0; i < n; ++i) sum += body(i);
                               sink = sum;
                           }));
    return fastest / n * 1e9;
}

template <SamplerKind kind>
double ns_per_pair() {
    constexpr std::uint32_t pairs = 16;  // of one path, which makes its sampler once
    return ns_per_element([](int i) {
               const Sampler sampler(kind, 1, 2, std::uint64_t(i));
               float sum = 0;
               for (std::uint32_t d = 0; d < pairs; ++d) {
                   const Point2f u = sampler.pair(d);
                   sum += u.x + u.y;
               }
               return sum;
           }) /
           pairs;
}

/// Measures the silhouettes of an occluder within the shafts from points of a floor, 2 m wide, to a square light. The
/// occluder is 1 m above it, the light 3 m.
void silhouettes(const char* name, const Mesh& occluder, app::Report& report) {
    Shape shape;
    shape.mesh = occluder;
    const EdgeTree tree(find_edges({&shape, 1}));
    std::vector<EdgeSegment> found;
    std::string row = fmt::format("{:40}", fmt::format("{}, {} edges", name, tree.n_edges()));
    double mean_found = 0;
    for (const float half : {0.3f, 0.1f, 0.01f}) {
        const Point3f light[] = {{-half, -half, 3}, {half, -half, 3}, {half, half, 3}, {-half, half, 3}};
        std::size_t n_found = 0, n_queries = 0;
        const double ns = ns_per_element([&](int i) {
            const Point3f x{(float(i % 128) - 63.5f) / 64, (float(i / 128) - 63.5f) / 64, 0};
            tree.collect(Shaft::to_polygon({x, {0, 0, 1}}, light), found);
            n_found += found.size();
            ++n_queries;
            return float(found.size());
        });
        if (half == 0.3f) mean_found = double(n_found) / double(n_queries);
        row += fmt::format("{:9.0f}", ns);
    }
    report.answer(fmt::format("{}{:9.1f}\n", row, mean_found));
}

/// Sum of the derivatives of f cos with respect to both directions, by dual numbers.
float gradient_by_dual(const Bsdf<float>& bsdf, const Vector3f& wo, const Vector3f& wi) {
    using T = Dual<6>;
    const auto variable = [](const Vector3f& v, int i) {
        return Vector3<T>{T::variable(v.x, i), T::variable(v.y, i + 1), T::variable(v.z, i + 2)};
    };
    const Rgb<T> f = f_cos_pdf(Bsdf<T>(bsdf), variable(wo, 0), variable(wi, 3)).f_cos;
    float sum = f.g.value;
    for (int i = 0; i < 6; ++i) sum += f.g.d[std::size_t(i)] + f.r.d[std::size_t(i)];
    return sum;
}

}  // namespace

void kernels(const Options&, app::Report& report) {
    report.answer(fmt::format("Kernels, ns on one core\n{:40}{:>9}{:>9}{:>9}{:>9}\n", "BSDF", "sample", "f, pdf",
                              "gradient", "by Dual"));
    std::vector<test::Draw> draws;
    std::vector<Vector3f> wo, wi;
    for (int i = 0; i < n; ++i) {
        draws.emplace_back(SamplerKind::independent, 1, i);
        wo.push_back(sample_cosine_hemisphere(draws[i].v));
        wi.push_back(sample_cosine_hemisphere(draws[i].u));
    }
    std::set<std::pair<BsdfKind, Microfacet>> seen;
    for (const test::BsdfCase& c : test::bsdf_cases()) {
        if (!seen.emplace(c.model.kind, c.model.distribution).second) continue;
        const Bsdf<float> bsdf(c.model);
        const double sampling =
            ns_per_element([&](int i) { return sample(bsdf, wo[i], draws[i].u_lobe, draws[i].u).weight.g; });
        const double evaluating = ns_per_element([&](int i) {
            const BsdfValue<float> value = f_cos_pdf(bsdf, wo[i], wi[i]);
            return value.f_cos.g + value.pdf_w;
        });
        const double gradient = ns_per_element([&](int i) {
            const DirectionGradient g = f_cos_gradient(bsdf, wo[i], wi[i]);
            float sum = g.f_cos.g;
            for (int k = 0; k < 3; ++k) sum += g.by_wo[k].g + g.by_wi[k].r;
            return sum;
        });
        const double by_dual = ns_per_element([&](int i) { return gradient_by_dual(bsdf, wo[i], wi[i]); });
        report.answer(
            fmt::format("{:40}{:9.1f}{:9.1f}{:9.1f}{:9.1f}\n", c.name, sampling, evaluating, gradient, by_dual));
    }
    report.answer(fmt::format("{:40}{:>9}\n", "sampler", "pair"));
    report.answer(fmt::format("{:40}{:9.1f}\n{:40}{:9.1f}\n\n", "sobol", ns_per_pair<SamplerKind::sobol>(),
                              "independent", ns_per_pair<SamplerKind::independent>()));
    report.answer(fmt::format("{:40}{:>9}{:>9}{:>9}{:>9}\n", "silhouettes towards a light of width", "0.6 m", "0.2 m",
                              "0.02 m", "found"));
    const Mesh square{
        {{-0.4f, -0.4f, 1}, {0.4f, -0.4f, 1}, {0.4f, 0.4f, 1}, {-0.4f, 0.4f, 1}}, {}, {}, {0, 1, 2, 2, 3, 0}};
    silhouettes("square", square, report);
    for (const int levels : {2, 3, 4, 5}) silhouettes("icosphere", test::icosphere(levels, {0, 0, 1}, 0.4f), report);
    report.answer("\n");
}

}  // namespace loom::bench
