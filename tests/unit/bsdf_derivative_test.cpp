// Derivatives by Dual against central differences of the same formula in double. Detected mutation: the sign of the
// derivative of atan2; sqrt(0) with an infinite derivative (NaN at mirror symmetry).

#include <gtest/gtest.h>

#include <array>

#include "stages/core/math/dual.h"
#include "tests/unit/bsdf_cases.h"

namespace loom::test {
namespace {

constexpr int n_variables = 9;  // wo, wi, alpha_u, alpha_v, eta

template <class T>
std::array<T, 4> value_and_density(const BsdfModel& model, const std::array<T, n_variables>& x) {
    Bsdf<T> bsdf(model);
    bsdf.alpha_u = x[6];
    bsdf.alpha_v = x[7];
    bsdf.eta = x[8];
    const BsdfValue<T> v = f_cos_pdf(bsdf, Vector3<T>{x[0], x[1], x[2]}, Vector3<T>{x[3], x[4], x[5]});
    return {v.f_cos.r, v.f_cos.g, v.f_cos.b, v.pdf_w};
}

class BsdfDerivative : public testing::TestWithParam<BsdfCase> {};

TEST_P(BsdfDerivative, AgreesWithCentralDifferences) {
    using D = Dual<n_variables, double>;
    BsdfModel model = GetParam().model;
    prepare_coat_slopes(model);
    const Bsdf<float> bsdf(model);
    for (int k = 0; k < 200; ++k) {
        const Draw draw(SamplerKind::independent, 5, k);
        const Vector3f wo = direction(0.1f + 0.85f * draw.v.x, 6 * draw.v.y);
        const BsdfSample<float> s = sample(bsdf, wo, draw.u_lobe, draw.u);
        if (s.lobe == Lobe::none || is_delta(s.lobe) || std::abs(s.wi.z) < 0.05f) continue;
        const std::array<double, n_variables> x = {wo.x,   wo.y,          wo.z,          s.wi.x,     s.wi.y,
                                                   s.wi.z, model.alpha_u, model.alpha_v, model.eta()};
        std::array<D, n_variables> dual_x;
        for (int i = 0; i < n_variables; ++i) dual_x[i] = D::variable(x[i], i);
        const auto dual = value_and_density(model, dual_x);
        const auto plain = value_and_density(model, x);
        for (int i = 0; i < n_variables; ++i) {
            const double h = 1e-6;
            if (x[i] < h && i >= 6) continue;  // a smooth rough_diffuse has no roughness below 0
            auto low = x, high = x;
            low[i] -= h, high[i] += h;
            const auto below = value_and_density(model, low), above = value_and_density(model, high);
            for (int c = 0; c < 4; ++c) {
                EXPECT_DOUBLE_EQ(dual[c].value, plain[c]);
                const double difference = (above[c] - below[c]) / (2 * h);
                // The scale of the rounding of the difference is that of the value over h.
                const double scale = std::abs(difference) + std::abs(plain[c]) + 1e-3;
                // A step across a kink (table entry, shadowing, total reflection) shows one-sided slopes.
                const double left = (plain[c] - below[c]) / h, right = (above[c] - plain[c]) / h;
                EXPECT_NEAR(dual[c].d[i], difference, 1e-4 * scale + std::abs(right - left))
                    << "sample " << k << " variable " << i << " channel " << c;
            }
        }
    }
}

INSTANTIATE_TEST_SUITE_P(Kinds, BsdfDerivative, testing::ValuesIn(bsdf_cases()),
                         [](const auto& info) { return "case_" + std::to_string(info.index); });

}  // namespace
}  // namespace loom::test
