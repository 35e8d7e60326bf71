#pragma once
// A BSDF in three layers, so that a path vertex on disk stores only what a neighbouring vertex needs:
//   BsdfModel   parameters of a material without its textures; one per material, stored once per graph
//   Bsdf<T>     the model with its texture-evaluated parameters at one vertex
//   f_cos_pdf, sample, albedo, delta_…: formulas over Bsdf<T>, templates over the number T,
//               which is float or Dual
//
// Directions are local: z is the shading normal, wo the direction in which light leaves (towards the camera), wi the
// direction from which it arrives. Both point away from the surface. Values equal those of Mitsuba 3 (radiance mode:
// transmission carries 1/η²). The choice of lobes, and thus the densities, are this project's own.

#include "stages/core/scattering/bsdf_model.h"

namespace loom {

/// Computes the derived fields of a model; call once per material after its parameters are set.
void prepare(BsdfModel& model);

/// Scales down a model of two lobes whose reflectances sum to more than 1, as Mitsuba 0.6 does.
/// out:     the factor on diffuse and specular; 1: not scaled
float conserve_energy(BsdfModel& model);

/// Fills coat and coats of a rough_plastic with textured roughness.
/// in:      alpha_min, alpha_max  range of the texture; if equal: one row, that of prepare() for this alpha
void prepare_coats(BsdfModel& model, float alpha_min, float alpha_max);

/// Fills the derivatives of a rough_plastic's coat with respect to roughness and relative index, required by formulas
/// over a Dual; takes a second per model. Does nothing for other kinds.
/// in, out: own_coats  the model's `coats`, if it has any
void prepare_coat_slopes(BsdfModel& model, RoughCoats* own_coats = nullptr);

/// Returns BSDF times |cos(theta_i)| (sr^-1), and the density (sr^-1) with which sample() chooses wi; both exclude
/// delta lobes.
template <class T>
BsdfValue<T> f_cos_pdf(const Bsdf<T>& bsdf, const Vector3<T>& wo, const Vector3<T>& wi);

/// Samples the direction from which light arrives; the weight stays near the reflectance.
///   weight = f_cos / pdf_w, with pdf_w from f_cos_pdf(); for a delta lobe delta_value / delta_pmf
/// in:      u_lobe  float    [0,1)  chooses the lobe
///          u       float[2] [0,1)  chooses the direction
/// out:     lobe none: the sample failed, its weight is 0
template <class T>
BsdfSample<T> sample(const Bsdf<T>& bsdf, const Vector3<T>& wo, float u_lobe, Point2f u);

/// Returns the reflectance or transmittance of a delta lobe, not divided by its pmf; 0 where there is no such lobe.
template <class T>
Rgb<T> delta_value(const Bsdf<T>& bsdf, const Vector3<T>& wo, Lobe lobe);

/// Returns the probability that sample() chooses this delta lobe.
template <class T>
T delta_pmf(const Bsdf<T>& bsdf, const Vector3<T>& wo, Lobe lobe);

/// Returns the direction of a delta lobe, bit for bit that of sample(): a vertex only stores the lobe.
template <class T>
Vector3<T> delta_direction(const Bsdf<T>& bsdf, const Vector3<T>& wo, Lobe lobe);

/// Returns the directional albedo in [0, 1], for roulette and for the albedo image: exact for diffuse and delta lobes,
/// Fresnel's reflectance at wo for rough ones. It is a ratio of energies, so without the 1/η² of transmission.
template <class T>
Rgb<T> albedo(const Bsdf<T>& bsdf, const Vector3<T>& wo);

/// Whether light sampling can contribute; false when every lobe is a delta.
template <class T>
bool has_smooth_lobe(const Bsdf<T>& bsdf);

}  // namespace loom

#include "stages/core/scattering/bsdf.inl"
