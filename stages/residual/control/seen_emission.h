#pragma once
// Emission that the camera sees directly, at the edges of emitters: by many camera rays of its own in place of the few of
// the paths.

#include <array>
#include <cstdint>
#include <vector>

#include "formats/image.h"
#include "stages/core/edit/edit_reach.h"
#include "stages/core/edit/scene_pair.h"
#include "stages/residual/control/controlled.h"

namespace loom::residual {

struct FilmBox;

/// Means, over camera rays of their own, of the emission at the first hits in two scenes.
///
/// In a pixel of which an emitter covers a part, some paths start with its radiance and others do not: the noise of that
/// is larger than of all else that they bring, and a ray removes it at a fraction of the cost of a path. The pixels are
/// chosen by rays of a pilot, so that no ray whose emission counts decides whether it does: unbiased.
class SeenEmission {
  public:
    /// No pixels.
    SeenEmission() = default;
    /// Of an edit: pixels in which the emission that is seen differs between the scenes.
    /// in:      samples  paths per pixel
    SeenEmission(const ScenePair& scenes, const EditReach& reach, std::uint64_t seed, std::uint64_t samples,
                 int threads);
    /// Of one scene, which is the new one; nothing is seen in the old one.
    SeenEmission(const Scene& scene, std::uint64_t seed, std::uint64_t samples, int threads);

    bool empty() const { return pairs_.empty(); }
    std::uint64_t n_pixels() const { return pairs_.size(); }
    std::uint64_t n_rays() const { return n_rays_; }
    /// Whether the paths of a pixel must do without the emission that their camera rays find.
    bool has(std::uint64_t pixel) const { return !index_.empty() && index_[pixel] >= 0; }
    /// Moments of means of rays of a pixel that it has, [rgb].
    const std::array<PairMoments, 3>& of(std::uint64_t pixel) const { return pairs_[std::size_t(index_[pixel])]; }
    /// Adds the difference, new minus old, and its variance to an image of the paths without it.
    void add_to(Image& image) const;

  private:
    void estimate(const Scene* old_scene, const Scene& new_scene, const FilmBox& film, std::uint64_t seed,
                  std::uint64_t samples, int threads);

    std::vector<std::int32_t> index_;  // [pixel] in pairs_; -1: not chosen
    std::vector<std::array<PairMoments, 3>> pairs_;
    std::uint64_t n_rays_ = 0;
};

/// Emission of the surface that a camera ray hits first; 0 where there is none, for the sky too.
Spectrum emission_at_first_hit(const Scene& scene, const Ray& ray);

}  // namespace loom::residual
