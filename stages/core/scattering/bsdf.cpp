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

/// Nodes over the two variables that choose a microfacet; the second one is an azimuth.
struct FacetQuadrature {
    Quadrature first, azimuth;
};

/// Computes Gauss-Legendre nodes: the roots of the Legendre polynomial, by Newton's method.
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

FacetQuadrature facet_quadrature(int first, int azimuth) {
    return {gauss_legendre(first), gauss_legendre(azimuth)};
}

/// Samples a normal of an isotropic GGX surface visible from (sin, 0, cos), by the projected hemisphere. Slower than
/// MicrofacetDistribution::sample, but even in the first variable and thus better for a quadrature.
///                                                                     [Heitz2018] listing 1
template <class T>
Vector3<T> visible_normal_even(const T& alpha, const Vector3<T>& w, Point2f u) {
    const Vector3<T> o = normalize(Vector3<T>{alpha * w.x, T(0), w.z});
    const Point2f disk = sample_concentric_disk(u);
    const T y = lerp(T(0.5f) * (T(1) + o.z), T(safe_sqrt(1 - disk.x * disk.x)), T(disk.y));
    const T x(disk.x), z = safe_sqrt(T(1) - x * x - y * y);
    return normalize(Vector3<T>{-alpha * (o.z * y - o.x * z), -alpha * x, o.x * y + o.z * z});
}

/// Returns the mean of `what` over the microfacets visible from the direction of cosine `mu`. The surface is isotropic,
/// so half of the azimuths suffice. Values are summed in double precision.
/// differs: nodes and parametrisation are those of Mitsuba 3, so that the tables agree to rounding
template <class T, class What>
auto mean_over_facets(const MicrofacetDistribution<T>& facets, float mu, const FacetQuadrature& q, What&& what) {
    const Vector3<T> w{T(std::sqrt(1 - mu * mu)), T(0), T(mu)};
    std::conditional_t<std::is_same_v<T, float>, double, T> sum(0);
    for (std::size_t i = 0; i < q.first.node.size(); ++i)
        for (std::size_t j = 0; j < q.azimuth.node.size() / 2; ++j) {
            const float a = float(q.first.node[i]), b = float(q.azimuth.node[j]);
            const Vector3<T> m = facets.type == Microfacet::ggx ? visible_normal_even(facets.alpha_u, w, {b, a})
                                                                : facets.sample(w, {a, b}, true);
            sum += 2 * q.first.weight[i] * q.azimuth.weight[j] * what(w, m);
        }
    return sum;
}

/// Cosine of entry i of the table.
float entry_cosine(int i) {
    return std::max(1e-6f, float(i) / float(n_transmittance - 1));
}

/// Fraction of the light that a rough interface reflects, or transmits: single scattering, F G1.
template <class T>
auto rough_reflectance(const MicrofacetDistribution<T>& facets, float mu, const T& eta, const FacetQuadrature& q) {
    return mean_over_facets(facets, mu, q, [&](const Vector3<T>& w, const Vector3<T>& m) {
        const Vector3<T> out = reflect(w, m);
        return out.z > T(0) ? fresnel_dielectric(dot(w, m), eta).reflectance * facets.G1(out, m) : T(0);
    });
}
template <class T>
auto rough_transmittance(const MicrofacetDistribution<T>& facets, float mu, const T& eta, const FacetQuadrature& q) {
    return mean_over_facets(facets, mu, q, [&](const Vector3<T>& w, const Vector3<T>& m) {
        const FresnelDielectric<T> f = fresnel_dielectric(dot(w, m), eta);
        const Vector3<T> out = refract(w, m, f);
        return out.z < T(0) ? (T(1) - f.reflectance) * facets.G1(out, m) : T(0);
    });
}

/// Returns the mean reflectance of diffuse light from inside.
/// differs: a sum over the entries of the table, which Mitsuba 3 uses for the integral, so that values agree
double internal_reflectance(Microfacet distribution, float alpha, float eta, const FacetQuadrature& q) {
    const MicrofacetDistribution<float> facets(distribution, alpha, alpha);
    double sum = 0;
    for (int i = 0; i < n_transmittance; ++i)
        sum += 2 * entry_cosine(i) * rough_reflectance(facets, entry_cosine(i), 1 / eta, q) / n_transmittance;
    return sum;
}

/// The interface from outside: the table, and 1 - ∫ 2 μ T(μ) dμ of its linear interpolant, exact for each piece.
template <class T>
struct CoatFromOutside {
    std::array<T, n_transmittance> transmittance;
    T reflectance;

    CoatFromOutside(Microfacet distribution, const T& alpha, const T& eta) {
        using Sum = std::conditional_t<std::is_same_v<T, float>, double, T>;
        const MicrofacetDistribution<T> facets(distribution, alpha, alpha);
        const FacetQuadrature q = facet_quadrature(32, 32);
        for (int i = 0; i < n_transmittance; ++i)
            transmittance[std::size_t(i)] = T(rough_transmittance(facets, entry_cosine(i), eta, q));
        Sum through(0);
        const double h = 1.0 / (n_transmittance - 1);
        for (std::size_t i = 0; i + 1 < n_transmittance; ++i) {
            const double a = double(i) * h;
            const Sum ta(transmittance[i]), tb(transmittance[i + 1]);
            through += 2 * h * (a * (ta + tb) / 2.0 + h * (ta + 2.0 * tb) / 6.0);
        }
        reflectance = T(Sum(1) - through);
    }
};

RoughCoat rough_coat(Microfacet distribution, float alpha, float eta) {
    const CoatFromOutside<float> outside(distribution, alpha, eta);
    return {float(internal_reflectance(distribution, alpha, eta, facet_quadrature(128, 128))), outside.reflectance,
            outside.transmittance};
}

/// From outside the derivatives come from Dual. From inside the derivative is singular at total reflection, and its
/// quadrature does not converge (4 % error with 128 x 128 nodes, 0.5 % with 512 x 512). Differences of the value
/// converge (0.3 % with 128 x 512).
RoughCoatSlopes rough_coat_slopes(Microfacet distribution, float alpha, float eta) {
    using D = Dual<2, double>;
    const CoatFromOutside<D> outside(distribution, D::variable(double(alpha), 0), D::variable(double(eta), 1));
    const FacetQuadrature q = facet_quadrature(128, 512);
    const float h = std::min(0.02f, alpha / 2);
    const auto slope = [&](std::size_t i, double inside) {
        RoughCoat by{float(inside), float(outside.reflectance.d[i]), {}};
        for (std::size_t k = 0; k < n_transmittance; ++k)
            by.external_transmittance[k] = float(outside.transmittance[k].d[i]);
        return by;
    };
    const auto inside = [&](float a, float e) { return internal_reflectance(distribution, a, e, q); };
    return {slope(0, (inside(alpha + h, eta) - inside(alpha - h, eta)) / (2 * double(h))),
            slope(1, (inside(alpha, eta + h) - inside(alpha, eta - h)) / (2 * double(h)))};
}

/// Result of compute(distribution, alpha, eta), cached for the life of the process: integrals take 0.1 s or more, and
/// scenes have many plastics of one roughness.
template <class Result, Result compute(Microfacet, float, float)>
const Result& known(Microfacet distribution, float alpha, float eta) {
    static std::mutex mutex;
    static std::map<std::tuple<Microfacet, float, float>, Result> results;
    const std::lock_guard lock(mutex);
    const auto [entry, inserted] = results.try_emplace({distribution, alpha, eta});
    if (inserted) entry->second = compute(distribution, alpha, eta);
    return entry->second;
}

const RoughCoat& known_rough_coat(Microfacet distribution, float alpha, float eta) {
    return known<RoughCoat, rough_coat>(distribution, alpha, eta);
}
const RoughCoatSlopes& known_rough_coat_slopes(Microfacet distribution, float alpha, float eta) {
    return known<RoughCoatSlopes, rough_coat_slopes>(distribution, alpha, eta);
}

/// Table rows per unit of roughness: interpolated values are off by at most 5e-4 (5e-3 at grazing angles).
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

void prepare_coat_slopes(BsdfModel& model, RoughCoats* own_coats) {
    if (model.kind != BsdfKind::rough_plastic) return;
    if (!own_coats) {
        model.slopes = &known_rough_coat_slopes(model.distribution, model.alpha_u, model.eta());
        return;
    }
    own_coats->slopes.clear();
    for (std::size_t row = 0; row < own_coats->rows.size(); ++row)
        own_coats->slopes.push_back(known_rough_coat_slopes(model.distribution, own_coats->alpha(row), model.eta()));
}

}  // namespace loom
