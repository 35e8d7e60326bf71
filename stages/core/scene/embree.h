#pragma once
#include <cstddef>
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
        crossings,   // crossings() too, which costs the others a little
        camera_rays  // of a scene that hides its emitters: shapes that emit are not there
    };
    explicit RayEngine(const std::vector<Shape>& shapes, Use use = Use::all_rays);
    ~RayEngine();
    RayEngine(const RayEngine&) = delete;
    RayEngine& operator=(const RayEngine&) = delete;

    Hit intersect(const Ray& ray) const;
    bool occluded(const Ray& ray) const;
    /// All surfaces that a ray passes through, in no order, each once; a sphere may be passed through twice.
    void crossings(const Ray& ray, std::vector<Hit>& hits) const;

    /// intersect() and occluded() of many rays, sixteen at a time. in: rays, n; coherent: neighbours start and go alike
    void intersect(const Ray* const* rays, std::size_t n, Hit* hits, bool coherent) const;
    void occluded(const Ray* const* rays, std::size_t n, bool* blocked) const;

  private:
    struct Impl;
    std::unique_ptr<Impl> impl_;
};

}  // namespace loom
