// The steady derivative of a shadow by its occluder: loom-derive's two samplings of direct edges against edge sampling.

#include <fmt/format.h>
#include <tbb/global_control.h>

#include <algorithm>
#include <cmath>
#include <ctime>
#include <filesystem>
#include <fstream>
#include <functional>
#include <numeric>

#include "stages/core/app/report.h"
#include "stages/core/edges/boundary.h"
#include "stages/core/scene/shading.h"
#include "stages/derive/boundary.h"
#include "tests/bench/bench.h"
#include "tests/traced_graph.h"
#include "tests/unit/icosphere.h"

namespace loom::bench {
namespace {

using Vec = Vector3<double>;
using Pt = Point3<double>;

constexpr int width = 32;
constexpr std::uint32_t occluder = 1;  // its shape
constexpr std::size_t n_pixels = std::size_t(width) * width;

/// A floor 2 m wide, seen as a whole from below the occluder, which is 1 m above it and moves by x; a square light 3 m
/// above it.
constexpr const char* scene_text = R"(<scene version="3.0.0"><default name="x" value="0"/>
<integrator type="path"><integer name="max_depth" value="2"/></integrator>
<sensor type="orthographic"><transform name="to_world"><lookat origin="0, 0, 0.2" target="0, 0, 0" up="0, 1, 0"/></transform>
<film type="hdrfilm"><integer name="width" value="{0}"/><integer name="height" value="{0}"/><rfilter type="box"/></film></sensor>
<shape type="rectangle"><transform name="to_world"><scale value="2"/></transform><bsdf type="diffuse"><rgb name="reflectance" value="0.5, 0.5, 0.5"/></bsdf></shape>
<shape type="obj"><string name="filename" value="{1}"/><boolean name="face_normals" value="true"/><transform name="to_world"><translate x="$x"/></transform>
<bsdf type="diffuse"><rgb name="reflectance" value="0, 0, 0"/></bsdf></shape>
<shape type="rectangle"><transform name="to_world"><scale value="{2}"/><rotate x="1" angle="180"/><translate z="3"/></transform>
<bsdf type="diffuse"><rgb name="reflectance" value="0, 0, 0"/></bsdf><emitter type="area"><rgb name="radiance" value="1, 1, 1"/></emitter></shape>
</scene>)";

struct MovingShadow {
    std::unique_ptr<Scene> scene;
    std::optional<derive::SceneTangents> tangents;

    MovingShadow(const Mesh& mesh, double half) {
        const auto mesh_file = testing::scratch_file(".obj"), file = testing::scratch_file(".xml");
        {
            std::ofstream out(mesh_file);
            for (const Point3f& p : mesh.positions) out << fmt::format("v {} {} {}\n", p.x, p.y, p.z);
            for (std::size_t i = 0; i < mesh.indices.size(); i += 3)
                out << fmt::format("f {} {} {}\n", mesh.indices[i] + 1, mesh.indices[i + 1] + 1,
                                   mesh.indices[i + 2] + 1);
            std::ofstream(file) << fmt::format(scene_text, width, mesh_file.string(), half);
        }
        const SceneDescription description = read_scene(file, {}, {});
        scene = build_scene(description);
        tangents.emplace(derive::find_tangents(*scene, description, file, {}, {}, {"x"}));
        std::filesystem::remove(file);
        std::filesystem::remove(mesh_file);
    }
};

using Image = std::vector<double>;  // [pixel] of the green channel

/// Edge sampling of pairs (edge point, light point), guided by a grid that projected samples have trained: shadowed
/// segments between the floor and the light, moved to the next silhouette.                          [Zhang2023]
class EdgeSampling {
  public:
    /// in:      n_light  cells of the grid along each side of the light; 0: no grid
    EdgeSampling(const MovingShadow& shadow, std::size_t n_along, std::size_t n_light)
        : scene_(*shadow.scene), light_(scene_.emitters[0]), n_along_(n_along), n_light_(n_light) {
        std::vector<bool> wanted(scene_.shapes.size());
        wanted[occluder] = true;
        edges_ = find_edges(scene_.shapes, wanted);
        std::vector<double> lengths;
        for (const Edge& edge : edges_.edges) lengths.push_back(edge.length());
        length_ = std::accumulate(lengths.begin(), lengths.end(), 0.0);
        by_length_ = Distribution1(lengths);
    }

    void train(std::uint64_t n) {
        std::vector<double> sum(n_along_ * n_light_ * n_light_), count(sum.size());
        for (std::uint64_t i = 0; i < n; ++i) {
            const Sampler sampler(SamplerKind::independent, 77, i, 0);
            const Point2f u_floor = sampler.pair(0), u_light = sampler.pair(1);
            const Pt x{2 * double(u_floor.x) - 1, 2 * double(u_floor.y) - 1, 0};
            LightPoint light;
            sample_area_point(scene_, light_, u_light, light);
            const Vec omega = normalize(x - Pt(light.y));
            const Hit hit = scene_.intersect(spawn_ray({light.y, light.n, light.hit_error}, Vector3f(omega)));
            if (!hit || hit.shape_idx != occluder) continue;
            const double along = nearest_silhouette(Pt(light.y), omega);
            if (along < 0) continue;
            const std::size_t c = cell(along, u_light);
            std::size_t pixel = 0;
            sum[c] += std::abs(value(along, light, pixel)), ++count[c];
        }
        // Of projected samples the density is unknown: a cell counts by its mean.
        for (std::size_t c = 0; c < sum.size(); ++c) sum[c] = count[c] > 0 ? sum[c] / count[c] : 0;
        grid_ = Distribution1(sum);
    }

    void sample(std::uint64_t n, std::uint64_t seed, Image& image) const {
        constexpr float uniform = 0.1f;  // share of samples without the grid
        const bool guided = n_light_ > 0;
        const double n_cells = guided ? double(n_along_ * n_light_ * n_light_) : 1;
        for (std::uint64_t i = 0; i < n; ++i) {
            const Sampler sampler(SamplerKind::independent, seed, i, 0);
            float u = sampler.pair(0).x;
            double along = double(sampler.pair(0).y);
            Point2f u_light = sampler.pair(1);
            if (guided && u >= uniform) {
                u = (u - uniform) / (1 - uniform);
                const std::size_t c = grid_.sample(u);
                along = (double(c / (n_light_ * n_light_)) + along) / double(n_along_);
                u_light.x = (float(c / n_light_ % n_light_) + u_light.x) / float(n_light_);
                u_light.y = (float(c % n_light_) + u_light.y) / float(n_light_);
            }
            double density = 1;
            if (guided)
                density = double(uniform) + double(1 - uniform) * double(grid_.pmf(cell(along, u_light))) * n_cells;
            LightPoint light;
            sample_area_point(scene_, light_, u_light, light);
            std::size_t pixel = 0;
            const double v = value(along, light, pixel);
            if (v != 0) image[pixel] += v / (density * double(n));
        }
    }

  private:
    std::size_t cell(double along, Point2f u) const {
        const auto of = [](double x, std::size_t n) { return std::min(std::size_t(x * double(n)), n - 1); };
        return (of(along, n_along_) * n_light_ + of(double(u.x), n_light_)) * n_light_ + of(double(u.y), n_light_);
    }

    bool is_silhouette(const Edge& edge, const Vec& omega) const {
        return edge.kind == EdgeKind::border || faces_towards(edge.n0, -omega) != faces_towards(edge.n1, -omega);
    }

    /// Position, by length over all edges, of the silhouette point that is nearest to a ray; -1: none.
    double nearest_silhouette(const Pt& from, const Vec& omega) const {
        double nearest = INFINITY, along = -1, before = 0;
        for (const Edge& edge : edges_.edges) {
            const double length = edge.length();
            if (is_silhouette(edge, normalize(edge.point(0.5) - from))) {
                // Across the ray.
                const auto across = [&](const Pt& p) { return (p - from) - omega * dot(p - from, omega); };
                const Vec a = across(Pt(edge.a)), d = across(Pt(edge.b)) - a;
                const double t = std::clamp(-dot(a, d) / length2(d), 0.0, 1.0), r2 = length2(a + d * t);
                if (r2 < nearest) nearest = r2, along = (before + t * length) / length_;
            }
            before += length;
        }
        return std::min(along, 1 - 1e-12);
    }

    ///   W f_cos Le swept cos_y / (r^2 cos_x), over the density of the edge point and the light point
    double value(double along, const LightPoint& light, std::size_t& pixel) const {
        auto u = float(along);
        const Edge& edge = edges_.edges[by_length_.sample(u)];
        const Pt b = edge.point(double(u)), y(light.y);
        const Vec to_edge = b - y, omega = normalize(to_edge);
        const double r = length(to_edge), cos_light = dot(Vec(light.n), omega);
        if (!is_silhouette(edge, omega) || !(cos_light > 0)) return 0;
        const Vec out = outward(edge, omega);
        constexpr double clearance = 2e-5;
        const Vec d = normalize(omega + out * (clearance / length(out)));
        const Ray ray = spawn_ray({light.y, light.n, light.hit_error}, Vector3f(d));
        const Hit hit = scene_.intersect(ray);
        if (!hit || !(double(hit.t) > r)) return 0;
        const SurfacePoint at = scene_.surface(ray, hit);
        const std::optional<FilmPoint> film = scene_.sensor.project(at.p);
        if (!film || !(film->film.x >= 0 && film->film.x < width && film->film.y >= 0 && film->film.y < width))
            return 0;
        const ShadingPoint here = shading_point(scene_, at, -film->d);
        const double f_cos = double(f_cos_pdf(here, Vector3f(-omega)).f_cos.g);
        if (f_cos == 0 || scene_.occluded(spawn_segment(here.end(), {film->from}))) return 0;
        const double cos_camera = std::abs(dot(Vec(at.ng), Vec(film->d))), cos_floor = std::abs(dot(Vec(at.ng), omega));
        pixel = std::size_t(film->film.y) * width + std::size_t(film->film.x);
        return film->scale * cos_camera * f_cos * double(light.Li.g) * swept(out, {1, 0, 0}) * cos_light /
               (r * r * cos_floor) * length_ * double(light.area);
    }

    const Scene& scene_;
    const Emitter& light_;
    EdgeSet edges_;
    double length_ = 0;
    Distribution1 by_length_, grid_;
    std::size_t n_along_, n_light_;
};

struct Measured {
    double moment = 0;  // mean over pixels of the derivative times their x, m: the mean alone is 0 by symmetry
    double cost = 0;    // variance, summed over pixels, times CPU seconds of an image
};
/// in:      image_of(seed)  an image of the derivative
Measured measure(int replicates, const std::function<Image(std::uint64_t)>& image_of) {
    std::vector<double> sum(n_pixels), square(n_pixels);
    double seconds = 0;
    for (int i = 0; i < replicates; ++i) {
        const std::clock_t start = std::clock();
        const Image image = image_of(std::uint64_t(i) + 1);
        seconds += double(std::clock() - start) / CLOCKS_PER_SEC;
        for (std::size_t p = 0; p < n_pixels; ++p) sum[p] += image[p], square[p] += image[p] * image[p];
    }
    Measured out;
    double variance = 0;
    for (std::size_t p = 0; p < n_pixels; ++p) {
        out.moment += sum[p] / replicates / double(n_pixels) * ((double(p % width) + 0.5) * 2 / width - 1);
        variance += (square[p] - sum[p] * sum[p] / replicates) / (replicates - 1);
    }
    out.cost = variance * seconds / replicates;
    return out;
}

/// The derivative by one of the families 1 and 2, from a graph of the scene.
Image by_family(const derive::BoundaryScene& s, std::uint64_t n_light_points) {
    app::Report silent;
    silent.set_quiet(true);
    std::vector<derive::BoundaryRows> rows;
    std::vector<std::uint64_t> samples(n_boundary_families);
    if (n_light_points == 0)
        derive::add_vertex_light(s, 1, {derive::reached_by::any}, rows, samples, silent);
    else
        derive::add_edge_light(s, n_light_points, {1}, rows, samples, silent);
    Image image(n_pixels);
    for (const derive::BoundaryRows& part : rows)
        for (std::size_t i = 0; i < part.pixel.size(); ++i) image[part.pixel[i]] += double(part.dL[3 * i + 1]);
    return image;
}

}  // namespace

void edge_sampling(const Options& options, app::Report& report) {
    const tbb::global_control one_thread(tbb::global_control::max_allowed_parallelism, 1);
    const int replicates = 8 * options.rounds;
    constexpr std::uint64_t spp = 16, n_edge_samples = 200'000, n_light_points = 10'000, n_training = 100'000;
    report.answer(fmt::format(
        "Shadow of an occluder that moves, {0} x {0} px: variance x CPU s, and the mean of derivative times x\n"
        "{1:30}{2:>22}{3:>22}{4:>22}{5:>22}{6:>9}\n",
        width, "occluder, width of the light", "edge sampling", "guided", "stored vertices", "points of the light",
        "gain"));
    const Mesh square{
        {{-0.4f, -0.4f, 1}, {0.4f, -0.4f, 1}, {0.4f, 0.4f, 1}, {-0.4f, 0.4f, 1}}, {}, {}, {0, 1, 2, 2, 3, 0}};
    for (const bool ball : {false, true})
        for (const double half : {0.3, 0.1, 0.03, 0.01, 0.003}) {
            const MovingShadow shadow(ball ? test::icosphere(3, {0, 0, 1}, 0.4f) : square, half);
            const EdgeSampling plain(shadow, 0, 0);
            const auto edges = [&](const EdgeSampling& by) {
                return measure(replicates, [&](std::uint64_t seed) {
                    Image image(n_pixels);
                    by.sample(n_edge_samples, seed, image);
                    return image;
                });
            };
            const Measured unguided = edges(plain);
            Measured guided{0, INFINITY};
            for (const std::size_t n_along : {64, 512, 1920})
                for (const std::size_t n_light : {1, 4, 8}) {
                    EdgeSampling by(shadow, n_along, n_light);
                    by.train(n_training);
                    const Measured m = edges(by);
                    if (m.cost < guided.cost) guided = m;
                }
            std::vector<PathGraph> graphs;
            for (int i = 0; i < replicates; ++i)
                graphs.push_back(testing::trace_graph(*shadow.scene,
                                                      testing::path_options(*shadow.scene, std::uint64_t(i) + 1), spp,
                                                      0, {false, true, true}));
            const auto family = [&](std::uint64_t n) {
                std::vector<derive::BoundaryOptions> of(graphs.size());
                std::vector<std::unique_ptr<derive::BoundaryScene>> scenes;
                for (std::size_t i = 0; i < graphs.size(); ++i) {
                    of[i].seed = 500 + i;
                    scenes.push_back(
                        std::make_unique<derive::BoundaryScene>(graphs[i], *shadow.scene, *shadow.tangents, of[i]));
                }
                return measure(replicates, [&](std::uint64_t seed) { return by_family(*scenes[seed - 1], n); });
            };
            const Measured vertices = family(0), lights = family(n_light_points);
            std::string row =
                fmt::format("{:30}", fmt::format("{}, {} m", ball ? "ball, 1920 edges" : "square", 2 * half));
            for (const Measured& m : {unguided, guided, vertices, lights})
                row += fmt::format("{:>22}", fmt::format("{:.1e} {:+.4e}", m.cost, m.moment));
            report.answer(fmt::format("{}{:9.1f}\n", row, guided.cost / std::min(vertices.cost, lights.cost)));
        }
    report.answer("\n");
}

}  // namespace loom::bench
