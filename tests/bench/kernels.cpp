#include <fmt/format.h>

#include <cmath>
#include <set>
#include <vector>

#include "stages/core/app/report.h"
#include "stages/core/scattering/gradient.h"
#include "tests/bench/bench.h"
#include "tests/unit/bsdf_cases.h"

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
}

}  // namespace loom::bench
