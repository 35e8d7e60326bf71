#pragma once
// Images of a doppler file.

#include "formats/doppler.h"
#include "formats/image.h"
#include "stages/frames/pictures.h"

namespace loom::frames {

/// Mean velocity as the luminance of an image; NaN where there is no light.
Image velocity_image(const Doppler& doppler);

/// Plots the spectrum over velocity and, with a chirp, that over the beat frequency below it, as means over all pixels:
/// beat.svg, beat.png; data beat.tsv.
Plot spectra(const Doppler& doppler);

/// Writes velocities as false colours to `options.output` and the spectra beside it.
void draw_doppler(const Options& options, app::Report& report);

}  // namespace loom::frames
