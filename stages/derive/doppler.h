#pragma once
// Doppler shifts of stored paths: how fast each optical path grows as the scene moves.
//
//   d(opl)/dt = sum_i eta_i u_i . (v_i - v_(i-1)) + eta_i' r_i,   u_i: unit, from x_(i-1) to x_i
//
// Light keeps the phase of the matter that scatters it. So v_i is the velocity of a material point at every vertex, the
// first hit included, unlike in interior/dopl, whose first hit stays in its pixel. A wall that moves within its own plane
// shifts light off axis, while its distance along a pixel's ray never changes. At mirrors and smooth interfaces the path
// is stationary (Fermat): sliding along them changes no length to first order, so that their material points serve, too.

#include <span>
#include <string>
#include <vector>

#include "formats/doppler.h"
#include "formats/path_graph.h"
#include "stages/core/graph/time_of_flight.h"
#include "stages/derive/surface_motion.h"

namespace loom::app {
class Command;
class Report;
}  // namespace loom::app

namespace loom::derive {

/// Numbers of a sensor.
struct DopplerOptions {
    double wavelength = 1.55e-6;  // m
    double chirp = 0;             // Hz/s; 0: no beat
    std::uint32_t n_bins = 128;   // of each spectrum
    double metres_per_unit = 1;
    int threads = 0;
};

/// What the command line requires.
struct DopplerRequest {
    std::string output;               // empty: derivatives instead
    std::vector<std::string> graphs;  // besides the first
    std::vector<std::string> speeds;  // name=speed
    DopplerOptions numbers;
};
void declare_doppler(app::Command& command, DopplerRequest& request);

struct Options;
/// throws:  InputError
void run_doppler(const Options& options, app::Report& report);

/// Speeds of all parameters from texts NAME=SPEED; 1 of a single parameter without a text.
/// throws:  InputError
std::vector<double> speeds_of(const SceneTangents& tangents, const std::vector<std::string>& texts);

/// Velocities of a scene whose parameters all change at once, as those of one parameter.
/// in:      speeds  of each parameter, its unit per second
SceneTangents motion_of(const Scene& scene, const SceneTangents& tangents, std::span<const double> speeds);

/// Columns that the graph lacks for `motion`, as options of loom-trace; empty: none.
std::string missing_for_doppler(const PathGraph& graph, const SceneTangents& motion);

/// Walks along paths with the rate at which their lengths grow. Borrows its arguments.
/// needs:   motion has one parameter, a time
class DopplerWalker {
  public:
    DopplerWalker(const PathGraph& graph, const Scene& scene, const SceneTangents& motion);

    /// Light of a path: its luminance, and its length (m; infinite from infinity) with that length's rate per second.
    struct Light {
        double luminance, opl, rate;
    };
    /// Calls on_light(Light) for all light that reaches the camera from a surface, a directly visible emitter included.
    /// An emitter at infinity is at rest: its light has the rate of the last vertex against the direction to it.
    template <class OnLight>
    void walk(std::size_t path, OnLight&& on_light) const {
        const PathGraph& g = graph_;
        std::size_t edge = first_light_edge(g, g.paths.first_vertex[path]);
        Tip tip = at_camera(path);
        if (vertices_of(g, path).begin == vertices_of(g, path).end) return;
        const std::size_t first = vertices_of(g, path).begin;
        walk_path(
            OwnSamples(reader_), path, edge,
            [&](std::size_t j, const ShadingPoint&) {
                advance(j, tip);
                if (const double y = luminance(rgb(g.paths.Le, path)); j == first && y > 0)
                    on_light(Light{y, tip.opl, tip.rate});
            },
            [&](std::size_t, std::size_t k, const Spectrum& L) {
                const Tip end = at_light(path, k, tip);
                on_light(Light{double(luminance(L)), end.opl, end.rate});
            });
    }

  private:
    /// The end of a path so far.
    struct Tip {
        Point3<double> x;
        Vector3<double> v;
        double opl = 0, rate = 0;
    };
    Tip at_camera(std::size_t path) const;
    void advance(std::size_t j, Tip& tip) const;
    Tip at_light(std::size_t path, std::size_t k, Tip tip) const;
    void extend(Tip& tip, const Point3<double>& x, const Vector3<double>& v, double eta, double deta) const;
    Vector3<double> material(std::uint32_t shape, std::uint32_t primitive, const Point3<double>& p) const;
    double index_rate(const Column<std::uint16_t>& media, std::size_t row) const;

    const PathGraph& graph_;
    const Scene& scene_;
    const SceneTangents& motion_;
    GraphReader reader_;
    SurfaceMotions motions_;
};

/// Bins the light of graphs of one scene with different samples by velocity and, with a chirp, by beat frequency. The
/// bins of velocity hold all light. Those of the beat start at the lowest and hold 99.9 % of the light of some paths.
/// in:      graphs  of films of one size
Doppler doppler_of(std::span<const PathGraph> graphs, const Scene& scene, const SceneTangents& motion,
                   const DopplerOptions& options);

}  // namespace loom::derive
