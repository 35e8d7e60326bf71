#pragma once
// Pairs of paths, one in each scene of an edit, and their contributions to pixels. Paths are sampled by all techniques
// and paired by the same random stream or by path mappings.

#include <functional>
#include <vector>

#include "stages/residual/dynamic/path_mapper.h"

namespace loom::residual {

/// One technique per scene with the same random stream; a shape that is dynamic in one scene may be a ghost in the
/// other.
struct Family {
    const char* name;
    Technique in_new, in_old;
    Site site_new, site_old;
};
inline constexpr std::size_t max_families = 10;

/// Returns the families that an edit requires, path tracing last. Ghosts require a moving shape.
std::vector<Family> families_of(const DynamicScenes& scenes);

/// Contribution of one path to one pixel:  value / (density.site_density + n h density.camera_density),  n: camera
/// paths of the pixel
struct Part {
    std::uint32_t pixel;
    Radiance value;  // f of the path, with the sign of its scene and its share of a pair
    double h;        // reconstruction filter of the pixel, pixels^-2
    const Evaluation& density;
    const std::vector<Term>& terms;  // of the same path
    double own;                      // density of the technique that sampled the pair
    bool by_camera;                  // `own` is per h and per camera path of a pixel
    bool at_first;                   // the edit is on the path's first segment or vertex
};

/// State of one thread.
///   A pair by the same random stream adds both paths as they are. A path p of one scene that is mapped to q of the
///   other adds
///   omega (F(p) - rho F(q)),  rho = p_q |T'| / p_p,  omega = 1 / (1 + rho)
/// The samples of the other scene do the same, so that together they cover both. Where the mapping is rejected, omega
/// is 1 and the partner is left to the other scene's samples.
/// differs: each term has the weight of its own scene, and limits are symmetric; as printed, both are biased
class PathPairs {
  public:
    using Sink = std::function<void(const Part&)>;
    struct Options {
        bool mapping = true;
        MappingLimits limits;
        /// Uses [RP] as printed, to measure its bias: both paths of a pair have the weight of the sampled one, Eq.
        /// (16); a mapping with a Jacobian above 10 is rejected, §5, but its inverse, below 1/10, is not.
        bool as_printed = false;
    };

    /// in:  samples  of each family, for the whole image; the entry of path tracing is unused
    ///      first_to_camera  as SampleCounts
    PathPairs(const DynamicScenes& scenes, const std::vector<Family>& families, const std::vector<double>& samples,
              bool first_to_camera, const PathOptions& path, const Options& options);

    void from_site(std::size_t family, const Numbers& numbers, const Sink& sink);
    /// Returns whether the edit may have changed the path.
    bool from_camera(PathId id, const Sampler& numbers, const Sink& sink);

    const FirstHit& first_hit() const { return in_new_.first_hit; }  // of the last camera path
    std::uint64_t rays() const { return in_new_.n_rays + in_old_.n_rays + from_new_.n_rays + from_old_.n_rays; }
    std::uint64_t vertices() const { return in_new_.n_vertices + in_old_.n_vertices; }
    std::uint64_t unrelocated() const { return in_new_.n_unrelocated + in_old_.n_unrelocated; }
    std::uint64_t nonfinite = 0;  // dropped paths: contribution or density is not finite

  private:
    void add(bool is_new, const FullPath& p, const Found& found, std::int64_t only_pixel, const Sink& sink);
    void show(const FullPath& p, const Evaluation& e, const std::vector<Term>& terms, double factor, double own,
              bool by_camera, std::int64_t only_pixel, const Sink& sink) const;
    double own_density(const std::vector<Term>& terms, const Evaluation& of, const Found& found,
                       std::uint32_t place) const;

    const DynamicScenes& scenes_;
    const std::vector<Family>& families_;
    PathOptions path_;
    Options options_;
    SampleCounts counts_new_, counts_old_;
    PathFinder in_new_, in_old_;
    PathMapper from_new_, from_old_;
    std::vector<Term> terms_, partner_terms_;
};

}  // namespace loom::residual
