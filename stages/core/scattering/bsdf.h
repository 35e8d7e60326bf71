#pragma once
// A BSDF in three steps, so that a path vertex on disk holds just what a neighbour needs:
//   BsdfModel   what a material says apart from its textures; one per material, stored once per graph
//   Bsdf<T>     the model with its texture-evaluated parameters at one vertex
//   f_cos_pdf, sample, albedo, delta_…: formulas over Bsdf<T>, written once for every number T,
//               which is float or Dual
//
// Directions are local: z is the shading normal, wo is where light leaves to (towards the camera),
// wi where it arrives from; both point away from the surface. Values are those of Mitsuba 3 (radiance
// mode: transmission carries 1/η²); the choice of lobes, and so the densities, are our own.

#include "stages/core/scattering/bsdf_model.h"

namespace loom {

/// Fills the derived fields of a model; call once per material after its parameters are known.
void prepare(BsdfModel& model);

/// Darkens a model of two lobes that would reflect more than it gets, as Mitsuba 0.6 does.
/// returns: the factor on diffuse and specular; 1: none
float conserve_energy(BsdfModel& model);

/// Fills coat and coats of a rough_plastic whose roughness a texture gives.
/// in:      alpha_min, alpha_max  of the texture; equal: one row, that of prepare() for this alpha
void prepare_coats(BsdfModel& model, float alpha_min, float alpha_max);

/// Fills the derivatives of a rough_plastic's coat by roughness and relative index, which formulas over a Dual need; a
/// second per model. Nothing to do for other kinds.
/// in, out: own_coats  the model's `coats`, if it has any
void prepare_coat_slopes(BsdfModel& model, RoughCoats* own_coats = nullptr);

/// BSDF times |cos(theta_i)| (sr^-1), and the density (sr^-1) with which sample() gives wi; delta lobes
/// are in neither.
template <class T>
BsdfValue<T> f_cos_pdf(const Bsdf<T>& bsdf, const Vector3<T>& wo, const Vector3<T>& wi);

/// A direction that light arrives from, chosen so that its weight stays near the reflectance.
///   weight = f_cos / pdf_w, with pdf_w as f_cos_pdf() says; for a delta lobe delta_value / delta_pmf
/// in:      u_lobe  float    [0,1)  chooses the lobe
///          u       float[2] [0,1)  chooses the direction
/// out:     lobe none: the sample failed, its weight is 0
template <class T>
BsdfSample<T> sample(const Bsdf<T>& bsdf, const Vector3<T>& wo, float u_lobe, Point2f u);

/// What a delta lobe reflects or transmits, not divided by its pmf; 0 where there is no such lobe.
template <class T>
Rgb<T> delta_value(const Bsdf<T>& bsdf, const Vector3<T>& wo, Lobe lobe);

/// Probability that sample() chooses this delta lobe.
template <class T>
T delta_pmf(const Bsdf<T>& bsdf, const Vector3<T>& wo, Lobe lobe);

/// The direction of a delta lobe, to the bit what sample() gave: a vertex need only store the lobe.
template <class T>
Vector3<T> delta_direction(const Bsdf<T>& bsdf, const Vector3<T>& wo, Lobe lobe);

/// Directional albedo in [0, 1]: exact for diffuse and delta lobes, Fresnel's reflectance at wo for rough
/// ones. For roulette and for the albedo image; energy, so without the 1/η² of transmission.
template <class T>
Rgb<T> albedo(const Bsdf<T>& bsdf, const Vector3<T>& wo);

/// Whether light sampling can find anything: false when every lobe is a delta.
template <class T>
bool has_smooth_lobe(const Bsdf<T>& bsdf);

}  // namespace loom

#include "stages/core/scattering/bsdf.inl"
