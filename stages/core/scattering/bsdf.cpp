#include "stages/core/scattering/bsdf.h"

#include <cmath>
#include <map>
#include <mutex>
#include <tuple>
#include <vector>

namespace loom {
namespace {

struct Quadrature {
    std::vector<double> node, weight;  // on [0, 1]; weights sum to 1
};

/// Gauss-Legendre nodes: the roots of the Legendre polynomial, by Newton's method.
Quadrature gauss_legendre(int n) {
    Quadrature q;
    for (int i = 0; i < n; ++i) {
        double x = std::cos(pi_double * (i + 0.75) / (n + 0.5)), slope = 0;
        for (int step = 0; step < 8; ++step) {
            double p = 1, previous = 0;
            for (int k = 1; k <= n; ++k) {
                const double next = ((2 * k - 1) * x * p - (k - 1) * previous) / k;
                previous = p;
                p = next;
            }
            slope = n * (x * p - previous) / (x * x - 1);
            x -= p / slope;
        }
        q.node.push_back(0.5 * (1 + x));
        q.weight.push_back(1 / ((1 - x * x) * slope * slope));
    }
    return q;
}

/// A visible normal of an isotropic GGX surface seen from (sin, 0, cos), by the projected hemisphere:
/// slower than MicrofacetDistribution::sample, but even in the first number and so better for a quadrature.
///                                                                     [Heitz2018] listing 1
Vector3f visible_normal_even(float alpha, const Vector3f& w, Point2f u) {
    const Vector3f o = normalize(Vector3f{alpha * w.x, 0, w.z});
    Point2f p = sample_concentric_disk(u);
    p.y = lerp(0.5f * (1 + o.z), safe_sqrt(1 - p.x * p.x), p.y);
    const float z = safe_sqrt(1 - p.x * p.x - p.y * p.y);
    return normalize(Vector3f{-alpha * (o.z * p.y - o.x * z), -alpha * p.x, o.x * p.y + o.z * z});
}

/// Mean of `what` over the microfacets that are visible from the direction of cosine `mu`. The surface is
/// isotropic, so half of the azimuths suffice.
/// differs: nodes and parametrisation are those of Mitsuba 3, so that the tables agree to rounding
template <class What>
double mean_over_facets(const MicrofacetDistribution<float>& facets, float mu, const Quadrature& q, What&& what) {
    const Vector3f w{std::sqrt(1 - mu * mu), 0, mu};
    const std::size_t n = q.node.size();
    double sum = 0;
    for (std::size_t i = 0; i < n; ++i)
        for (std::size_t j = 0; j < n / 2; ++j) {
            const float a = float(q.node[i]), b = float(q.node[j]);
            const Vector3f m = facets.type == Microfacet::ggx ? visible_normal_even(facets.alpha_u, w, {b, a})
                                                              : facets.sample(w, {a, b}, true);
            sum += 2 * q.weight[i] * q.weight[j] * what(w, m);
        }
    return sum;
}

/// Fraction of the light that a rough interface reflects, or transmits: single scattering, F G1.
double rough_reflectance(const MicrofacetDistribution<float>& facets, float mu, float eta, const Quadrature& q) {
    return mean_over_facets(facets, mu, q, [&](const Vector3f& w, const Vector3f& m) {
        const Vector3f out = reflect(w, m);
        return out.z > 0 ? fresnel_dielectric(dot(w, m), eta).reflectance * facets.G1(out, m) : 0.0f;
    });
}
double rough_transmittance(const MicrofacetDistribution<float>& facets, float mu, float eta, const Quadrature& q) {
    return mean_over_facets(facets, mu, q, [&](const Vector3f& w, const Vector3f& m) {
        const FresnelDielectric<float> f = fresnel_dielectric(dot(w, m), eta);
        const Vector3f out = refract(w, m, f);
        return out.z < 0 ? (1 - f.reflectance) * facets.G1(out, m) : 0.0f;
    });
}

/// The interface of a rough plastic: a table from outside, means under diffuse light from both sides.
/// differs: the mean from inside is the sum over the 64 entries that Mitsuba 3 takes for the integral, so
///          that values agree with its own
RoughCoat rough_coat(Microfacet distribution, float alpha, float eta) {
    const MicrofacetDistribution<float> facets(distribution, alpha, alpha);
    const Quadrature outside = gauss_legendre(32), inside = gauss_legendre(128);
    RoughCoat table;
    double internal = 0;
    for (int i = 0; i < n_transmittance; ++i) {
        const float mu = std::max(1e-6f, float(i) / float(n_transmittance - 1));
        table.external_transmittance[i] = float(rough_transmittance(facets, mu, eta, outside));
        internal += 2 * mu * rough_reflectance(facets, mu, 1 / eta, inside) / n_transmittance;
    }
    table.fdr_int = float(internal);

    // ∫ 2 μ T(μ) dμ of the linear interpolant: exact for each piece.
    double through = 0;
    const double h = 1.0 / (n_transmittance - 1);
    for (int i = 0; i + 1 < n_transmittance; ++i) {
        const double a = i * h, ta = table.external_transmittance[i], tb = table.external_transmittance[i + 1];
        through += 2 * h * (a * (ta + tb) / 2 + h * (ta + 2 * tb) / 6);
    }
    table.fdr_ext = float(1 - through);
    return table;
}

/// A tenth of a second each, and scenes have many plastics of one roughness: each is integrated once per process.
const RoughCoat& known_rough_coat(Microfacet distribution, float alpha, float eta) {
    static std::mutex mutex;
    static std::map<std::tuple<Microfacet, float, float>, RoughCoat> known;
    const std::lock_guard lock(mutex);
    const auto [entry, inserted] = known.try_emplace({distribution, alpha, eta});
    if (inserted) entry->second = rough_coat(distribution, alpha, eta);
    return entry->second;
}

/// Rows of a table over roughness: enough that values between them are off by at most 5e-4 (5e-3 at grazing angles).
constexpr float coat_rows_per_alpha = 24;

}  // namespace

float conserve_energy(BsdfModel& model) {
    const float total = max_channel(model.diffuse + model.specular);
    if (total <= 1) return 1;
    const float factor = 0.99f / total;
    model.diffuse *= factor;
    model.specular *= factor;
    return factor;
}

void prepare(BsdfModel& model) {
    if (model.kind == BsdfKind::rough_plastic)
        model.coat = known_rough_coat(model.distribution, model.alpha_u, model.eta());
    if (model.kind == BsdfKind::phong || model.kind == BsdfKind::ward) conserve_energy(model);
}

void prepare_coats(BsdfModel& model, float alpha_min, float alpha_max) {
    static std::mutex mutex;
    static std::map<std::tuple<Microfacet, float, float, float>, RoughCoats> known;  // never erased: models borrow
    const std::lock_guard lock(mutex);
    const auto [entry, inserted] = known.try_emplace({model.distribution, model.eta(), alpha_min, alpha_max});
    RoughCoats& coats = entry->second;
    if (inserted) {
        coats.alpha_min = alpha_min;
        coats.alpha_max = alpha_max;
        const int n =
            alpha_max > alpha_min ? 2 + int(std::ceil(coat_rows_per_alpha * std::min(alpha_max - alpha_min, 1.0f))) : 1;
        coats.rows.resize(std::size_t(n));
        for (std::size_t k = 0; k < coats.rows.size(); ++k)
            coats.rows[k] = known_rough_coat(model.distribution, coats.alpha(k), model.eta());
    }
    model.coat = coats.rows[coats.rows.size() / 2];
    model.coats = &coats;
}

}  // namespace loom
