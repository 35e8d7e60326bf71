// Every sample() against its density. Detected mutations: leave the cosine out of sample_cosine_hemisphere's density;
// replace 1/(4 wo.z) by 1/(4 wi.z) in the rough conductor's pdf; drop eta² from the refraction Jacobian; swap
// p_specular and 1 - p_specular in a mixture; use the rational fit for the Beckmann G1 of the density (caught by the
// sum).

#include <gtest/gtest.h>

#include <functional>
#include <vector>

#include "stages/core/stats/chi_square.h"
#include "tests/unit/bsdf_cases.h"

namespace loom::test {
namespace {

constexpr int n_z = 32, n_phi = 32;  // cells of equal solid angle; the horizon lies between two of them

struct Cell {
    double z0, z1, phi0, phi1;
};

/// ∫ pdf over a cell by Gauss-Legendre with 3 x 3 nodes.
double gauss(const std::function<double(double, double)>& pdf, const Cell& c) {
    constexpr double node[] = {-0.7745966692414834, 0, 0.7745966692414834};
    constexpr double weight[] = {5.0 / 18, 8.0 / 18, 5.0 / 18};
    double sum = 0;
    for (int i = 0; i < 3; ++i)
        for (int j = 0; j < 3; ++j)
            sum += weight[i] * weight[j] *
                   pdf(0.5 * (c.z0 + c.z1) + 0.5 * (c.z1 - c.z0) * node[i],
                       0.5 * (c.phi0 + c.phi1) + 0.5 * (c.phi1 - c.phi0) * node[j]);
    return sum * (c.z1 - c.z0) * (c.phi1 - c.phi0);
}
double integrate(const std::function<double(double, double)>& pdf, const Cell& c, double whole, int depth) {
    const double z = 0.5 * (c.z0 + c.z1), phi = 0.5 * (c.phi0 + c.phi1);
    const Cell parts[] = {
        {c.z0, z, c.phi0, phi}, {c.z0, z, phi, c.phi1}, {z, c.z1, c.phi0, phi}, {z, c.z1, phi, c.phi1}};
    double values[4], sum = 0;
    for (int i = 0; i < 4; ++i) sum += values[i] = gauss(pdf, parts[i]);
    // A narrow lobe may lie between all nodes of a coarse cell: go down once in any case.
    if (depth >= 1 && (std::abs(sum - whole) < 1e-6 || depth == 8)) return sum;
    double refined = 0;
    for (int i = 0; i < 4; ++i) refined += integrate(pdf, parts[i], values[i], depth + 1);
    return refined;
}

int cell_of(const Vector3f& w) {
    double phi = std::atan2(w.y, w.x) / (2 * pi_double);
    if (phi < 0) phi += 1;
    const int i = std::min(n_z - 1, int((w.z + 1) * 0.5 * n_z));
    return i * n_phi + std::min(n_phi - 1, int(phi * n_phi));
}

/// Share of sample() that fails, one jittered point in each of 64³ cells: its standard error is below 3e-4.
double failed_mass(const Bsdf<float>& bsdf, const Vector3f& wo) {
    constexpr int n = 64;
    int failed = 0;
    for (int i = 0; i < n * n * n; ++i) {
        const Draw jitter(SamplerKind::independent, 9, i);
        const Point2f u{(float(i % n) + jitter.u.x) / n, (float(i / n % n) + jitter.u.y) / n};
        failed += sample(bsdf, wo, (float(i / n / n) + jitter.u_lobe) / n, u).lobe == Lobe::none;
    }
    return double(failed) / (n * n * n);
}

class BsdfDensity : public testing::TestWithParam<BsdfCase> {};

TEST_P(BsdfDensity, SamplesFollowItAndItSumsToOne) {
    const BsdfModel& model = GetParam().model;
    const Bsdf<float> bsdf(model);
    constexpr int n = 1 << 16;
    std::vector<float> cosines = {0.9f, 0.12f};
    if (transmits(model) || model.two_sided) cosines.push_back(-0.4f);
    for (const float cos : cosines) {
        const Vector3f wo = direction(cos);
        const auto pdf = [&](double z, double phi) -> double {
            const double r = std::sqrt(1 - z * z);
            const Vector3f wi{float(r * std::cos(phi)), float(r * std::sin(phi)), float(z)};
            return f_cos_pdf(bsdf, wo, wi).pdf_w;
        };
        std::vector<double> expected(n_z * n_phi + 1), observed(n_z * n_phi + 1);
        double smooth_mass = 0;
        if (has_smooth_lobe(bsdf))
            for (int i = 0; i < n_z; ++i)
                for (int j = 0; j < n_phi; ++j) {
                    const Cell c{2.0 * i / n_z - 1, 2.0 * (i + 1) / n_z - 1, 2 * pi_double * j / n_phi,
                                 2 * pi_double * (j + 1) / n_phi};
                    const double mass = integrate(pdf, c, gauss(pdf, c), 0);
                    smooth_mass += mass;
                    expected[i * n_phi + j] = n * mass;
                }
        double delta_mass = 0;
        for (const Lobe lobe : {Lobe::delta_reflection, Lobe::delta_transmission, Lobe::null})
            delta_mass += delta_pmf(bsdf, wo, lobe);
        // The last cell counts samples without density: delta lobes and failed samples.
        expected.back() = n * std::max(0.0, 1 - smooth_mass);

        for (int i = 0; i < n; ++i) {
            const Draw draw(SamplerKind::independent, 7, i);
            const BsdfSample<float> s = sample(bsdf, wo, draw.u_lobe, draw.u);
            ++observed[s.lobe == Lobe::none || is_delta(s.lobe) ? n_z * n_phi : cell_of(s.wi)];
        }
        EXPECT_NEAR(smooth_mass + delta_mass + failed_mass(bsdf, wo), 1, 1e-3) << "cos_o " << cos;
        const ChiSquareResult result = chi_square_test(observed, expected);
        EXPECT_GE(result.p_value, sidak_alpha(n_comparisons))
            << "cos_o " << cos << " chi2 " << result.statistic << " dof " << result.dof;
        EXPECT_EQ(result.stray, 0) << "cos_o " << cos;
    }
}

INSTANTIATE_TEST_SUITE_P(Kinds, BsdfDensity, testing::ValuesIn(bsdf_cases()),
                         [](const auto& info) { return "case_" + std::to_string(info.index); });

}  // namespace
}  // namespace loom::test
