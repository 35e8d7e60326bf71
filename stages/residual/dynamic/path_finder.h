#pragma once
// Samples whole paths by the seven techniques of [RP] §4, in one of the two scenes of an edit.

#include <functional>
#include <optional>
#include <vector>

#include "stages/residual/dynamic/dynamic_path.h"
#include "stages/residual/dynamic/numbers.h"

namespace loom::residual {

/// The technique that sampled a path, and the vertex or crossing where it started (as Term::place).
struct Found {
    Technique technique;
    std::uint32_t place;
    bool by_next_event = true;  // path tracing: next-event estimation, else hitting the light
};

/// Sampler of paths for one thread. The paths of one sample share its vertices. Each path is passed to the visitor once
/// and is invalid afterwards.
class PathFinder {
  public:
    using Visitor = std::function<void(const FullPath&, const Found&)>;

    PathFinder(const DynamicScenes& scenes, const DynamicScene& side, const PathOptions& options);

    /// Samples paths from one point of a site. Equal random streams give corresponding points in the two scenes. On a
    /// shape that is dynamic in both, it is the same point of the shape. Where the shape is dynamic in one scene and a
    /// ghost in the other, it is the same point in space.
    /// needs:   technique is 1 to 3 and the site dynamic here, or 4 to 6 and the site a ghost
    void find(Technique technique, Site site, const Numbers& numbers, const Visitor& visit);

    /// Samples the paths of one camera sample, with the random stream of loom-trace; static paths are skipped.
    /// out:     whether the same sample may give another path in the other scene
    bool find_from_camera(PathId id, const Sampler& numbers, const Visitor& visit);

    FirstHit first_hit;  // of the last camera sample
    std::uint64_t n_rays = 0, n_vertices = 0;
    std::uint64_t n_unrelocated = 0;  // samples of ghosts whose point is not among the crossings of the final segment

  private:
    /// A vertex of a walk, with its continuation and its connection to the sensor or a light.
    struct Stop {
        Vertex v;
        Vector3f back;   // to the previous vertex, or to the start of the walk
        Vector3f ahead;  // to the next vertex
        Lobe lobe = Lobe::none;
        Interaction onward;
        Segment segment;  // to the next vertex
        bool joined = false;
        Interaction end;
        Segment end_segment;
        SensorEnd sensor;
        LightEnd light;
        LightEnd met;  // of a camera path: emission of the vertex itself
    };
    enum class Towards : std::uint8_t { sensor, light };

    /// A point of a site, and the random numbers of the sample that starts from it.
    struct SiteSample {
        const SitePoint& point;
        std::uint32_t shape;  // of the point in this scene
        float u_side;
        Point2f u_light;
        const Numbers& numbers;
        const Visitor& visit;
    };
    void dynamic_from_emitter(const SiteSample& from);
    void ghost_from_emitter(const SiteSample& from);
    void dynamic_from_sensor(const SiteSample& from);
    void ghost_from_sensor(const SiteSample& from);
    void dynamic_two_ends(const SiteSample& from);
    void ghost_two_ends(const SiteSample& from);
    /// Samples paths from the light through `first`, the vertex next to it.
    /// in:      ghost  null, or the point that must lie between the two
    void from_light(const Stop& first, const LightEnd& light, const SitePoint* ghost, Technique technique,
                    const SiteSample& from);
    /// Whether a vertex reflects on its visible side.
    bool reflects_back(const Vertex& v) const;

    /// A camera path as traced; its vertices are y_.
    struct CameraPath {
        Ray first;             // from the camera
        LightEnd sky;          // where its last ray escaped
        bool touched = false;  // whether the edit touches it
        bool escaped = false;
    };
    CameraPath trace_from_camera(PathId id, const Sampler& numbers);
    void show_camera_path(const CameraPath& path, const Visitor& visit);
    bool crosses_movers(const Ray& ray) const;
    LightEnd sky_end(const Vector3f& d) const;
    /// Returns the emission of a vertex as a light; the caller sets its pdf.
    LightEnd emitted_end(const Stop& stop, int emitter) const;
    /// Samples a light from a vertex of a camera path.
    /// in, out: touched  whether the edit touches the path
    void join_sampled_light(Stop& stop, const Sampler& numbers, int depth, bool& touched);
    /// Samples the next direction of a camera path; false where the path ends.
    bool leave(Stop& stop, const Sampler& numbers, int depth) const;

    /// Extends the walk from its last vertex, and joins each vertex on the way (the first one only if join_first is
    /// set).
    void walk(std::vector<Stop>& stops, Towards towards, const Numbers& numbers, int n_max, bool join_first = true);
    /// in:      u_lobe_roulette  x, y
    bool step(Stop& from, Point2f u, Point2f u_lobe_roulette, Stop& next);
    void join_sensor(Stop& stop);
    void join_light(Stop& stop, Point2f u);

    bool occluded(const Ray& ray);
    Hit intersect(const Ray& ray, bool from_camera = false);
    bool hides_from_sensor(const Vertex& v, const FilmPoint& film);
    bool scatters(const Hit& hit) const;
    std::optional<FilmPoint> on_film(const Point3f& p) const;
    Segment segment_to_sensor(const Vertex& v, const FilmPoint& film);
    LightEnd light_end(const LightSample& light) const;
    /// Finds the sampled ghost point among the crossings of the resulting segment.
    bool relocate(const Segment& segment, const SitePoint& point, std::uint32_t& place);

    void from_sensor(std::size_t a, const Segment& ahead);
    void to_light(std::size_t b);
    void show_to_sensor(const LightEnd& light, const Segment& light_segment, const Found& found, const Visitor& visit);
    void show_from_sensor(const SensorEnd& sensor, const Segment& sensor_segment, const Found& found, std::size_t first,
                          const Visitor& visit);
    void show_two_ends(const Interaction* middle, const Vertex* middle_vertex, const Segment* between,
                       const Found& found, const Visitor& visit);

    int longest() const {
        return options_.max_depth < 0 ? most_vertices : std::min(options_.max_depth - 1, most_vertices);
    }

    static constexpr int most_vertices = 512;  // roulette survival is at most 0.95 per vertex

    const DynamicScenes& scenes_;
    const DynamicScene& side_;
    PathOptions options_;
    std::vector<Stop> z_, y_;  // walks towards the sensor and the light
    Crossings crossings_;
    FullPath path_;
};

}  // namespace loom::residual
