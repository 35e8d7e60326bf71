#include <fmt/format.h>

#include <cmath>
#include <set>
#include <vector>

#include "stages/core/app/report.h"
#include "tests/bench/bench.h"
#include "tests/unit/bsdf_cases.h"

namespace loom::bench {
namespace {

constexpr int n = 1 << 14;  // in the cache

/// Nanoseconds per element of body(i) over n elements, the fastest of many rounds. Its sum is kept.
template <class Body>
double ns_per_element(Body&& body) {
    static volatile float sink;
    double fastest = INFINITY;
    for (int round = 0; round < 15; ++round)
        fastest = std::min(fastest, seconds_of([&] {
                               float sum = 0;
                               for (int i = 0; i < n; ++i) sum += body(i);
                               sink = sum;
                           }));
    return fastest / n * 1e9;
}

}  // namespace

void kernels(const Options&, app::Report& report) {
    report.answer(fmt::format("Kernels, ns on one core\n{:40}{:>9}{:>9}\n", "BSDF", "sample", "f, pdf"));
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
        const double sampling = ns_per_element([&](int i) { return sample(bsdf, wo[i], draws[i].u_lobe, draws[i].u).weight.g; });
        const double evaluating = ns_per_element([&](int i) {
            const BsdfValue<float> value = f_cos_pdf(bsdf, wo[i], wi[i]);
            return value.f_cos.g + value.pdf_w;
        });
        report.answer(fmt::format("{:40}{:9.1f}{:9.1f}\n", c.name, sampling, evaluating));
    }
    report.answer(fmt::format("{:40}{:>9}\n", "sampler", "pair"));
    for (const auto& [name, kind] : {std::pair{"sobol", SamplerKind::sobol}, {"independent", SamplerKind::independent}}) {
        const double ns = ns_per_element([kind = kind](int i) {
            const Sampler sampler(kind, 1, 2, std::uint64_t(i) >> 4);
            const Point2f u = sampler.pair(std::uint32_t(i) & 15);
            return u.x + u.y;
        });
        report.answer(fmt::format("{:40}{:9.1f}\n", name, ns));
    }
    report.answer("\n");
}

}  // namespace loom::bench
