#pragma once
#include <cstddef>
#include <cstdint>
#include <memory>
#include <vector>

namespace loom {

struct Shape;
struct Ray;
struct Hit;

/// The acceleration structure over all shapes of a scene. The shapes are borrowed and must outlive it.
class RayEngine {
  public:
    enum class Use {
        all_rays,
        crossings,   // crossings() too, which slows down the other queries slightly
        camera_rays  // for a scene that hides its emitters: without shapes that emit
    };
    explicit RayEngine(const std::vector<Shape>& shapes, Use use = Use::all_rays);
    /// The shapes that another engine lacks, beside that engine, whose hits stay the same to the bit. Of two hits at the same
    /// distance either counts.
    /// in:      shapes   all, those of `base` included
    ///          of_base  [shape of base] its index in `shapes`
    ///          base     alone, not beside yet another
    RayEngine(const std::vector<Shape>& shapes, std::shared_ptr<const RayEngine> base,
              std::vector<std::uint32_t> of_base, Use use = Use::all_rays);
    ~RayEngine();
    RayEngine(const RayEngine&) = delete;
    RayEngine& operator=(const RayEngine&) = delete;

    Hit intersect(const Ray& ray) const;
    bool occluded(const Ray& ray) const;
    /// Finds all surfaces along a ray, unordered, each once; a sphere may be crossed twice.
    void crossings(const Ray& ray, std::vector<Hit>& hits) const;

    /// intersect() and occluded() of many rays, sixteen at a time.
    /// in:      rays, n
    ///          coherent  neighbouring rays have similar origins and directions
    void intersect(const Ray* const* rays, std::size_t n, Hit* hits, bool coherent) const;
    void occluded(const Ray* const* rays, std::size_t n, bool* blocked) const;

  private:
    /// in:      left_out  [shape]
    void build(const std::vector<Shape>& shapes, Use use, const std::vector<bool>& left_out);

    struct Impl;
    std::unique_ptr<Impl> impl_;
};

}  // namespace loom
