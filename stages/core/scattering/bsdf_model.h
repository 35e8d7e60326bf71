#pragma once
// Parts of a BSDF: the kinds, the parameters of a material, the parameters at one vertex, and the results of an
// evaluation and of a sample. The formulas over them are in bsdf.h.

#include <array>
#include <cstdint>
#include <vector>

#include "stages/core/math/dual.h"
#include "stages/core/math/vector.h"

namespace loom {

/// Closed set; the value is stored in `materials/kind`. Append only.
enum class BsdfKind : std::uint8_t {
    diffuse = 0,
    rough_diffuse = 1,
    conductor = 2,
    rough_conductor = 3,
    dielectric = 4,
    thin_dielectric = 5,
    rough_dielectric = 6,
    plastic = 7,
    rough_plastic = 8,
    phong = 9,
    ward = 10,
    null = 11,
};
inline constexpr int n_bsdf_kinds = 12;

enum class Microfacet : std::uint8_t { ggx = 0, beckmann = 1 };

/// Normalisation of Ward's lobe; the value is stored in `materials/variant`. Append only.
enum class WardVariant : std::uint8_t { ward = 0, duer = 1, balanced = 2 };

/// Lobe of a sample; the value is stored in `vertices/lobe`. Append only.
enum class Lobe : std::uint8_t {
    none = 0,
    diffuse = 1,
    glossy_reflection = 2,
    glossy_transmission = 3,
    delta_reflection = 4,
    delta_transmission = 5,
    null = 6,  // passes straight through, as without a surface (mask, null)
};
constexpr bool is_delta(Lobe lobe) {
    return lobe >= Lobe::delta_reflection;
}
constexpr bool is_transmission(Lobe lobe) {
    return lobe == Lobe::glossy_transmission || lobe == Lobe::delta_transmission || lobe == Lobe::null;
}

/// Number of entries of BsdfModel::external_transmittance.
inline constexpr int n_transmittance = 64;

/// Interface of a rough plastic at one roughness and index: its diffuse reflectance from inside and from outside, and
/// its transmittance by cos(theta), evenly spaced over [0, 1].
struct RoughCoat {
    float fdr_int = 0.0f, fdr_ext = 0.0f;
    std::array<float, n_transmittance> external_transmittance{};
};

/// Derivatives of the entries of a RoughCoat with respect to roughness and relative index.
struct RoughCoatSlopes {
    RoughCoat by_alpha, by_eta;
};

/// Interface over a range of roughness: rows evenly spaced from alpha_min to alpha_max, interpolated linearly.
struct RoughCoats {
    float alpha_min = 0, alpha_max = 0;
    std::vector<RoughCoat> rows;
    std::vector<RoughCoatSlopes> slopes;  // [row]; empty until prepare_coat_slopes()

    float alpha(std::size_t row) const {
        return row + 1 == rows.size() ? alpha_max
                                      : alpha_min + (alpha_max - alpha_min) * float(row) / float(rows.size() - 1);
    }
    template <class T>
    struct Between {
        std::size_t row, next;
        T t;  // position between row and next, in [0, 1]
    };
    template <class T>
    Between<T> between(const T& alpha) const {
        const int last = int(rows.size()) - 1;
        const float range = alpha_max - alpha_min;
        const T part = range > 0 ? (alpha - T(alpha_min)) / T(range) : T(0);
        const T x = (part > T(0) ? (part < T(1) ? part : T(1)) : T(0)) * T(float(last));
        const int i = int(value_of(x)) < last ? int(value_of(x)) : last;
        return {std::size_t(i), std::size_t(i < last ? i + 1 : last), x - T(float(i))};
    }
};

/// Parameters of a material without its textures. Plain data; all arrays have fixed lengths.
struct BsdfModel {
    BsdfKind kind = BsdfKind::diffuse;
    Microfacet distribution = Microfacet::beckmann;
    WardVariant variant = WardVariant::balanced;
    bool bump_shadowing = true;            // bump or normal map: darkens the terminator of the bumps
    bool two_sided = false;                // reflects from behind as from the front (never with transmission)
    bool nonlinear = false;                // plastic: internal scattering shifts the colour
    bool sample_visible = true;            // microfacets: sample the normals visible from wo, else all of them
    float int_ior = 1.0f, ext_ior = 1.0f;  // absolute indices inside (behind the normal) and outside
    float opacity = 1.0f;                  // mask: 1 - probability of passing straight on
    float alpha_u = 0.1f, alpha_v = 0.1f;  // microfacet roughness
    float exponent = 30.0f;                // phong
    Spectrum diffuse{0.5f};                // reflectance of the diffuse lobe
    Spectrum specular{1.0f};               // factor on specular reflection
    Spectrum transmittance{1.0f};          // factor on specular transmission
    Spectrum eta_c{0.0f}, k_c{1.0f};       // conductor: complex index relative to the outside
    // Derived by prepare() for rough_plastic.
    RoughCoat coat;                           // at alpha_u
    const RoughCoats* coats = nullptr;        // with a textured alpha, else null; borrowed
    const RoughCoatSlopes* slopes = nullptr;  // of coat; null until prepare_coat_slopes(); borrowed

    float eta() const { return int_ior / ext_ior; }
};

/// The texture-evaluated parameters at one vertex. `model` is borrowed and outlives the Bsdf.
template <class T>
struct Bsdf {
    const BsdfModel* model = nullptr;
    Rgb<T> diffuse, specular, transmittance;
    T alpha_u{}, alpha_v{};
    T eta{1};      // relative index, int_ior / ext_ior
    T opacity{1};  // 1 - probability of the null lobe
    T exponent{};  // phong
    Rgb<T> eta_c, k_c;

    Bsdf() = default;
    /// Converts parameters that are constants.
    template <class U>
    requires(!std::is_same_v<U, T>) explicit Bsdf(const Bsdf<U>& o)
        : model(o.model),
          diffuse(o.diffuse),
          specular(o.specular),
          transmittance(o.transmittance),
          alpha_u(o.alpha_u),
          alpha_v(o.alpha_v),
          eta(o.eta),
          opacity(o.opacity),
          exponent(o.exponent),
          eta_c(o.eta_c),
          k_c(o.k_c) {}
    /// Takes the model's own parameters; textures then overwrite theirs.
    explicit Bsdf(const BsdfModel& m)
        : model(&m),
          diffuse(m.diffuse),
          specular(m.specular),
          transmittance(m.transmittance),
          alpha_u(m.alpha_u),
          alpha_v(m.alpha_v),
          eta(m.eta()),
          opacity(m.opacity),
          exponent(m.exponent),
          eta_c(m.eta_c),
          k_c(m.k_c) {}
};

/// BSDF times |cos(theta_i)| (sr^-1) and the density with which sample() chooses wi (sr^-1); both exclude delta lobes.
template <class T>
struct BsdfValue {
    Rgb<T> f_cos;
    T pdf_w{};
};

template <class T>
struct BsdfSample {
    Vector3<T> wi;           // local
    Rgb<T> weight;           // f cos / pdf_w, or the delta lobe's value / pmf
    T pdf_w{};               // of wi, sr^-1; 0 for a delta lobe
    T pmf{};                 // of choosing the delta lobe; 0 for any other
    Lobe lobe = Lobe::none;  // none: the sample failed (a null event)
    T eta{1};                // index on wi's side over that on wo's side; 1 unless transmitted

    /// Density in the measure of its lobe: pdf_w or pmf.
    T density() const { return pdf_w + pmf; }
};

}  // namespace loom
