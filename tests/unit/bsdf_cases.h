#pragma once
// BSDFs for the tests of scattering: each kind at several roughnesses, from both sides.

#include <string>
#include <vector>

#include "stages/core/sampling/sampler.h"
#include "stages/core/scattering/bsdf.h"

namespace loom::test {

/// Upper bound on the number of statistical comparisons of the unit binary; each is judged at sidak_alpha(this).
inline constexpr int n_comparisons = 1000;

struct BsdfCase {
    std::string name;
    BsdfModel model;
};

inline bool transmits(const BsdfModel& m) {
    return m.kind == BsdfKind::dielectric || m.kind == BsdfKind::thin_dielectric ||
           m.kind == BsdfKind::rough_dielectric || m.kind == BsdfKind::null;
}

inline std::vector<BsdfCase> bsdf_cases() {
    std::vector<BsdfCase> cases;
    const auto add = [&](std::string name, BsdfKind kind, auto&& set) {
        BsdfModel m;
        m.kind = kind;
        m.diffuse = {0.5f, 0.4f, 0.3f};
        m.int_ior = 1.49f;
        m.ext_ior = 1.000277f;
        m.eta_c = {0.2f, 0.9f, 1.4f};
        m.k_c = {3.9f, 2.4f, 1.9f};
        set(m);
        prepare(m);
        cases.push_back({std::move(name), m});
    };
    add("diffuse", BsdfKind::diffuse, [](BsdfModel&) {});
    add("diffuse two-sided mask", BsdfKind::diffuse, [](BsdfModel& m) { m.two_sided = true, m.opacity = 0.6f; });
    add("conductor", BsdfKind::conductor, [](BsdfModel&) {});
    add("dielectric", BsdfKind::dielectric, [](BsdfModel&) {});
    add("dielectric inverted", BsdfKind::dielectric, [](BsdfModel& m) { m.int_ior = 1, m.ext_ior = 1.5f; });
    add("dielectric tinted mask", BsdfKind::dielectric, [](BsdfModel& m) {
        m.specular = {0.9f, 0.8f, 0.7f}, m.transmittance = {0.6f, 0.8f, 1.0f}, m.opacity = 0.7f;
    });
    add("thin_dielectric", BsdfKind::thin_dielectric, [](BsdfModel&) {});
    add("plastic", BsdfKind::plastic, [](BsdfModel&) {});
    add("plastic nonlinear two-sided", BsdfKind::plastic, [](BsdfModel& m) { m.nonlinear = true, m.two_sided = true; });
    add("null", BsdfKind::null, [](BsdfModel&) {});
    for (const float alpha : {0.0f, 0.2f, 0.5f})
        add("rough_diffuse " + std::to_string(alpha), BsdfKind::rough_diffuse,
            [=](BsdfModel& m) { m.alpha_u = m.alpha_v = alpha; });
    for (const float n : {1.0f, 10.0f, 100.0f})
        add("phong " + std::to_string(n), BsdfKind::phong,
            [=](BsdfModel& m) { m.exponent = n, m.specular = Spectrum(0.3f); });
    for (const float alpha : {0.1f, 0.3f})
        add("ward " + std::to_string(alpha), BsdfKind::ward,
            [=](BsdfModel& m) { m.alpha_u = alpha, m.alpha_v = 0.5f * alpha, m.specular = Spectrum(0.3f); });
    for (const Microfacet distribution : {Microfacet::ggx, Microfacet::beckmann}) {
        const std::string type = distribution == Microfacet::ggx ? " ggx " : " beckmann ";
        for (const auto& [u, v] : {std::pair{0.05f, 0.05f}, {0.1f, 0.3f}, {0.4f, 0.4f}, {1.0f, 1.0f}}) {
            const auto rough = [=](BsdfModel& m) { m.distribution = distribution, m.alpha_u = u, m.alpha_v = v; };
            const std::string alphas = type + std::to_string(u) + " " + std::to_string(v);
            add("rough_conductor" + alphas, BsdfKind::rough_conductor, rough);
            add("rough_dielectric" + alphas, BsdfKind::rough_dielectric, rough);
            add("rough_dielectric inverted" + alphas, BsdfKind::rough_dielectric, [=](BsdfModel& m) {
                rough(m);
                m.int_ior = 1, m.ext_ior = 1.33f, m.specular = {0.9f, 0.8f, 0.7f};
            });
            if (u == v) add("rough_plastic" + alphas, BsdfKind::rough_plastic, rough);
        }
        const auto all_normals = [=](BsdfModel& m) {
            m.distribution = distribution, m.alpha_u = m.alpha_v = 0.3f, m.sample_visible = false;
        };
        add("rough_conductor all normals" + type, BsdfKind::rough_conductor, all_normals);
        add("rough_dielectric all normals" + type, BsdfKind::rough_dielectric, all_normals);
        add("rough_plastic all normals" + type, BsdfKind::rough_plastic, all_normals);
    }
    return cases;
}

/// Returns a direction at `cos` above (or below) the surface, at an azimuth off all axes.
inline Vector3f direction(float cos, float azimuth_rad = 0.7f) {
    const float sin = std::sqrt(1 - cos * cos);
    return {sin * std::cos(azimuth_rad), sin * std::sin(azimuth_rad), cos};
}

/// Uniform samples for one BSDF sample, a function of (seed, i) alone.
struct Draw {
    float u_lobe;
    Point2f u, v;
    Draw(SamplerKind kind, std::uint64_t seed, std::uint64_t i) {
        const Sampler sampler(kind, seed, 0, i);
        u = sampler.pair(0);
        u_lobe = sampler.pair(1).x;
        v = sampler.pair(2);
    }
};

}  // namespace loom::test
