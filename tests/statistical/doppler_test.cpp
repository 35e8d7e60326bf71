// Velocities of paths: closed forms of moving planes and mirrors, and differences of lengths whose vertices all move as
// matter. All comparisons are path by path, so that no noise enters.
//
// Detected mutations: the first hit attached to its pixel (plane in its own plane); a segment's rate with only one of its
// ends; indices of refraction left out; the camera or the emitter at rest; light from infinity without its rate; a beat
// with the other sign; bins a width off.

#include <fmt/format.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <cmath>

#include "formats/io/error.h"
#include "formats/io/hdf5_handle.h"
#include "formats/transient_cube.h"
#include "stages/core/app/report.h"
#include "tests/statistical/derivative_support.h"

namespace loom {
namespace {

namespace fs = std::filesystem;
using derive::DopplerWalker;
using Vec = Vector3<double>;
using Pt = Point3<double>;

class Dopplers : public ::testing::Test {
  protected:
    void SetUp() override {
        std::string name = (fs::temp_directory_path() / "loom-doppler-XXXXXX").string();
        ASSERT_NE(mkdtemp(name.data()), nullptr);
        folder = name;
    }
    void TearDown() override { fs::remove_all(folder); }

    /// A scene with a camera at the origin that looks along z, and $t.
    fs::path write(const std::string& body, int depth) const {
        const fs::path file = folder / "scene.xml";
        std::ofstream(file) << fmt::format(
            R"(<scene version="3.0.0"><default name="t" value="0"/><default name="s" value="0"/><default name="one" value="1"/>
<integrator type="path"><integer name="max_depth" value="{}"/></integrator>
<sensor type="perspective"><float name="fov" value="60"/><transform name="to_world"><lookat origin="0,0,0" target="0,0,1" up="0,1,0"/></transform>
<film type="hdrfilm"><integer name="width" value="12"/><integer name="height" value="12"/><rfilter type="box"/></film></sensor>
{}
</scene>)",
            depth, body);
        return file;
    }
    /// Calls check(path, light) for all light of all paths; returns how much there is.
    template <class Check>
    static std::size_t each(const PathGraph& graph, const DerivableScene& s, std::vector<double> speeds,
                            Check&& check) {
        const derive::SceneTangents motion = derive::motion_of(*s.scene, s.tangents, speeds);
        const DopplerWalker walker(graph, *s.scene, motion);
        std::size_t n = 0;
        for (std::size_t path = 0; path < graph.n_paths(); ++path)
            walker.walk(path, [&](const DopplerWalker::Light& light) {
                if (!(light.luminance > 0)) return;
                ++n;
                check(path, light);
            });
        return n;
    }
    static Vec first_direction(const PathGraph& graph, std::size_t path) {
        return normalize(position<double>(graph, vertices_of(graph, path).begin) - camera_origin<double>(graph, path));
    }
    fs::path folder;
};

constexpr const char* light = R"(<emitter type="point"><point name="position" x="0" y="0" z="0"/></emitter>)";

std::string wall(const std::string& moves) {
    return fmt::format(
        R"(<shape type="rectangle" id="wall"><transform name="to_world"><scale value="9"/><rotate y="1" angle="180"/><translate z="4"/><translate {}/></transform><bsdf type="diffuse"/></shape>)",
        moves);
}

// rate = 2 v . u, so that a plane that approaches shifts by 2 v cos / wavelength.
TEST_F(Dopplers, plane_beside_sensor_and_light) {
    constexpr double v = 1.7;
    for (const auto& [moves, velocity] : {std::pair{R"(z="$t")", Vec{0, 0, v}}, std::pair{R"(x="$t")", Vec{v, 0, 0}}}) {
        const DerivableScene s(write(light + wall(moves), 2), {"t"});
        const PathGraph graph = trace_derivable(*s.scene, 4, 1);
        double largest = 0;
        const std::size_t n = each(graph, s, {v}, [&](std::size_t path, const DopplerWalker::Light& l) {
            const double expected = 2 * dot(velocity, first_direction(graph, path));
            EXPECT_NEAR(l.rate, expected, 1e-6) << moves;
            largest = std::max(largest, std::abs(l.rate));
        });
        EXPECT_EQ(n, graph.n_paths());
        EXPECT_GT(largest, 0.5 * v);
        // Images: 2 v / wavelength within the cosines of a pixel.
        const derive::SceneTangents motion = derive::motion_of(*s.scene, s.tangents, std::vector{-v});
        derive::DopplerOptions options;
        options.chirp = 1e14;
        const Doppler d = derive::doppler_of({&graph, 1}, *s.scene, motion, options);
        EXPECT_EQ(d.problem(), "");
        for (std::size_t pixel = 0; pixel < d.n_pixels(); ++pixel) {
            double low = INFINITY, high = -INFINITY, mean_of_spectrum = 0, of_light = 0, beat = 0, in_beat = 0;
            for (std::size_t path = pixel; path < graph.n_paths(); path += graph.n_pixels()) {
                const double rate = dot(-velocity, first_direction(graph, path));
                low = std::min(low, rate), high = std::max(high, rate);
            }
            EXPECT_GE(d.velocity[pixel], low - 1e-6);
            EXPECT_LE(d.velocity[pixel], high + 1e-6);
            for (std::uint32_t k = 0; k < d.velocity_bins.n; ++k) {
                const double y = d.spectrum[pixel * d.velocity_bins.n + k];
                of_light += y;
                mean_of_spectrum += y * (d.velocity_bins.start + (k + 0.5) * d.velocity_bins.width);
            }
            EXPECT_NEAR(of_light, d.light[pixel], 1e-5 * d.light[pixel]);
            EXPECT_NEAR(mean_of_spectrum / of_light, d.velocity[pixel], 0.5 * d.velocity_bins.width + 1e-6);
            // The beat of the mean length and the mean velocity.
            double opl = 0, weights = 0;
            for (std::size_t path = pixel; path < graph.n_paths(); path += graph.n_pixels()) {
                opl += 2 * length(position<double>(graph, vertices_of(graph, path).begin) - Pt{0, 0, 0});
                weights += 1;
            }
            for (std::uint32_t k = 0; k < d.beat_bins.n; ++k) {
                const double y = d.beat[pixel * d.beat_bins.n + k];
                in_beat += y;
                beat += y * (d.beat_bins.start + (k + 0.5) * d.beat_bins.width);
            }
            if (d.beat_after[pixel] > 0) continue;
            const double expected = options.chirp * opl / weights / (speed_of_light * 1e9) +
                                    2 * double(d.velocity[pixel]) / options.wavelength;
            // Means of path lengths by number and by light differ within a pixel.
            EXPECT_NEAR(beat / in_beat, expected, d.beat_bins.width + 5e-3 * std::abs(expected)) << moves;
        }
    }
}

TEST_F(Dopplers, rests) {
    const DerivableScene s(
        write(
            light + wall(R"(z="$t")") +
                R"(<shape type="cube"><transform name="to_world"><scale value="0.3"/><translate x="1" z="3"/></transform></shape>)",
            4),
        {"t"});
    const PathGraph graph = trace_derivable(*s.scene, 4, 1);
    const std::size_t n =
        each(graph, s, {0}, [&](std::size_t, const DopplerWalker::Light& l) { EXPECT_EQ(l.rate, 0); });
    EXPECT_GT(n, graph.n_paths());
}

// The image of the light in a mirror at z = a recedes at twice the mirror's velocity: opl = |image - x| + |x|, with the
// image at 2 a - z of the light; a mirror that slides within its plane changes nothing.
TEST_F(Dopplers, mirror) {
    const auto body = [](const char* moves) {
        return fmt::format(
            R"(<shape type="rectangle" id="m"><transform name="to_world"><scale value="9"/><rotate y="1" angle="180"/><translate z="4"/><translate {}/></transform><bsdf type="conductor"/></shape>
<shape type="sphere"><point name="center" x="0.5" y="0.25" z="-3"/><float name="radius" value="1.5"/><emitter type="area"><rgb name="radiance" value="1"/></emitter></shape>)",
            moves);
    };
    for (const auto& [moves, slides] : {std::pair{R"(z="$t")", false}, std::pair{R"(x="$t" y="$t")", true}}) {
        const DerivableScene s(write(body(moves), 3), {"t"});
        const PathGraph graph = trace_derivable(*s.scene, 16, 1);
        const std::size_t n = each(graph, s, {1}, [&](std::size_t path, const DopplerWalker::Light& l) {
            const Vec u = first_direction(graph, path);
            // To the mirror and back: u_z on either side.
            EXPECT_NEAR(l.rate, slides ? 0.0 : 2 * u.z, 2e-5) << moves;
        });
        EXPECT_GT(n, 50u);
    }
}

// A glass slab whose far face recedes by 2 per unit lengthens paths by 2 (eta cos inside - cos outside).
TEST_F(Dopplers, growing_slab_of_glass) {
    const DerivableScene s(
        write(
            R"(<shape type="cube" id="slab"><bsdf type="dielectric"><float name="int_ior" value="1.5"/><float name="ext_ior" value="1"/></bsdf>
<transform name="to_world"><translate z="1"/><scale x="9" y="9" z="$one"/><translate z="2"/></transform></shape>
<shape type="rectangle"><transform name="to_world"><scale value="20"/><rotate y="1" angle="180"/><translate z="6"/></transform><emitter type="area"><rgb name="radiance" value="1"/></emitter></shape>)",
            3),
        {"one"});
    const PathGraph graph = trace_derivable(*s.scene, 4, 1);
    const std::size_t n = each(graph, s, {1}, [&](std::size_t path, const DopplerWalker::Light& l) {
        const double outside = first_direction(graph, path).z;
        const double inside = std::sqrt(1 - (1 - sqr(outside)) / sqr(1.5));
        EXPECT_NEAR(l.rate, 2 * (1.5 * inside - outside), 1e-5);
    });
    EXPECT_GT(n, graph.n_paths() / 2);
}

// Light of a path is re-measured with all its vertices moved as matter.
TEST_F(Dopplers, differences_of_moved_paths) {
    const std::string body =
        R"(<shape type="rectangle" id="floor"><transform name="to_world"><scale value="6"/><rotate x="1" angle="-90"/><translate y="-1" z="3"/><translate x="$t" y="$t"/></transform></shape>
<shape type="sphere" id="ball"><point name="center" x="$s" y="0.2" z="4"/><float name="radius" value="0.8"/></shape>
<shape type="rectangle" id="lamp"><transform name="to_world"><scale value="0.7"/><rotate x="1" angle="90"/><translate y="3" z="3"/></transform><emitter type="area"><rgb name="radiance" value="4"/></emitter></shape>)";
    const DerivableScene s(write(body, 4), {"t", "s", "shape:lamp/pose", "sensor/pose"});
    ASSERT_EQ(s.tangents.n(), 14u);
    std::vector<double> speeds(14);
    for (std::size_t p = 0; p < speeds.size(); ++p) speeds[p] = 0.3 * double(p + 1) * (p % 2 == 0 ? 1 : -1);
    const PathGraph graph = trace_derivable(*s.scene, 32, 1);
    // The scene's own velocities, parameter by parameter.
    const auto sum = [&](const auto& effects, const Pt& x) {
        Vec v;
        for (const auto& [p, velocity] : effects) v = v + velocity.at(x) * speeds[p];
        return v;
    };
    const OpticalLengths lengths(graph, {});
    std::vector<double> rates, expected, opls, expected_opls;
    for (std::size_t path = 0; path < graph.n_paths(); ++path) {
        const auto [begin, end] = vertices_of(graph, path);
        std::size_t edge = first_light_edge(graph, graph.paths.first_vertex[path]);
        const Pt camera = camera_origin<double>(graph, path);
        const auto length_at = [&](double time, std::size_t last, const Pt* y, std::size_t lamp) {
            Pt from = camera + sum(s.tangents.camera, camera) * time;
            double total = 0;
            for (std::size_t j = begin; j <= last; ++j) {
                const Pt x = position<double>(graph, j);
                const Pt to = x + sum(s.tangents.shapes[graph.vertices.shape[j]], x) * time;
                total += length(to - from);
                from = to;
            }
            if (y) total += length(*y + sum(s.tangents.shapes[lamp], *y) * time - from);
            return total;
        };
        constexpr double h = 1e-4;
        const auto expect = [&](std::size_t last, const Pt* y, std::size_t lamp) {
            expected.push_back((length_at(h, last, y, lamp) - length_at(-h, last, y, lamp)) / (2 * h));
            expected_opls.push_back(length_at(0, last, y, lamp));
        };
        if (begin == end) continue;
        if (luminance(rgb(graph.paths.Le, path)) > 0) expect(begin, nullptr, 0);
        for (; edge < graph.n_light_edges() && graph.light_edges.vertex[edge] < end; ++edge) {
            const float* y = graph.light_edges.y.data() + 4 * edge;
            const Pt at{y[0], y[1], y[2]};
            expect(graph.light_edges.vertex[edge], &at, s.scene->emitters[graph.light_edges.emitter[edge]].shape_idx);
        }
    }
    const derive::SceneTangents motion = derive::motion_of(*s.scene, s.tangents, speeds);
    const DopplerWalker walker(graph, *s.scene, motion);
    for (std::size_t path = 0; path < graph.n_paths(); ++path)
        walker.walk(path, [&](const DopplerWalker::Light& l) { rates.push_back(l.rate), opls.push_back(l.opl); });
    ASSERT_EQ(rates.size(), expected.size());
    ASSERT_GT(rates.size(), 1000u);
    for (std::size_t i = 0; i < rates.size(); ++i) {
        EXPECT_NEAR(rates[i], expected[i], 1e-5 * (1 + std::abs(expected[i])));
        EXPECT_NEAR(opls[i], expected_opls[i], 1e-9 * expected_opls[i]);
    }
}

TEST_F(Dopplers, light_from_infinity) {
    const DerivableScene s(
        write(R"(<emitter type="directional"><vector name="direction" x="0" y="0.6" z="0.8"/></emitter>)" +
                  wall(R"(z="$t")"),
              2),
        {"t"});
    const PathGraph graph = trace_derivable(*s.scene, 2, 1);
    const std::size_t n = each(graph, s, {1}, [&](std::size_t path, const DopplerWalker::Light& l) {
        EXPECT_NEAR(l.rate, first_direction(graph, path).z + 0.8, 1e-6);
        EXPECT_FALSE(std::isfinite(l.opl));
    });
    EXPECT_EQ(n, graph.n_paths());
    derive::DopplerOptions options;
    options.chirp = 1e14;
    const derive::SceneTangents motion = derive::motion_of(*s.scene, s.tangents, std::vector{1.0});
    const Doppler d = derive::doppler_of({&graph, 1}, *s.scene, motion, options);
    EXPECT_EQ(d.problem(), "");
    for (std::size_t pixel = 0; pixel < d.n_pixels(); ++pixel) EXPECT_EQ(d.never[pixel], d.light[pixel]);
}

TEST_F(Dopplers, threads_change_no_number_and_files_keep_them) {
    const DerivableScene s(write(light + wall(R"(z="$t")"), 2), {"t"});
    const PathGraph graphs[2] = {trace_derivable(*s.scene, 4, 1), trace_derivable(*s.scene, 4, 2)};
    const derive::SceneTangents motion = derive::motion_of(*s.scene, s.tangents, std::vector{1.0});
    derive::DopplerOptions options;
    options.chirp = 1e14;
    options.n_bins = 7;
    options.threads = 1;
    const Doppler one = derive::doppler_of(graphs, *s.scene, motion, options);
    options.threads = 2;
    const Doppler two = derive::doppler_of(graphs, *s.scene, motion, options);
    write_doppler(one, folder / "d.h5", Sync::no);
    EXPECT_TRUE(is_doppler(folder / "d.h5"));
    const Doppler read = read_doppler(folder / "d.h5");
    EXPECT_EQ(one.film.samples_per_pixel, 8u);
    for (const Doppler* other : {&two, &read})
        for (const auto column : {&Doppler::light, &Doppler::velocity, &Doppler::velocity_var_mean, &Doppler::spectrum,
                                  &Doppler::beat, &Doppler::beat_after, &Doppler::never})
            EXPECT_TRUE(std::equal((one.*column).begin(), (one.*column).end(), (other->*column).begin(),
                                   (other->*column).end()));

    // Damaged files are refused, whatever is wrong.
    const auto refusal = [&](const char* dataset, hid_t type, const void* value) {
        write_doppler(one, folder / "bad.h5", Sync::no);
        {
            const Hdf5Handle file(H5Fopen((folder / "bad.h5").c_str(), H5F_ACC_RDWR, H5P_DEFAULT), H5Fclose);
            const Hdf5Handle of(H5Dopen2(file.get(), dataset, H5P_DEFAULT), H5Dclose);
            EXPECT_GE(H5Dwrite(of.get(), type, H5S_ALL, H5S_ALL, H5P_DEFAULT, value), 0);
        }
        try {
            read_doppler(folder / "bad.h5");
        } catch (const InputError& error) {
            return std::string(error.what());
        }
        return std::string("no error");
    };
    const std::uint32_t huge = 0xffffffffu, zero = 0, other_size = 5;
    const double nan = NAN, negative = -1, none = 0;
    for (const auto* n : {&huge, &zero, &other_size})
        for (const char* dataset : {"film/width", "film/height", "velocity_bins/n", "beat_bins/n"})
            EXPECT_NE(refusal(dataset, H5T_NATIVE_UINT32, n).find("bad.h5: "), std::string::npos) << dataset << *n;
    for (const auto* x : {&nan, &negative, &none})
        for (const char* dataset : {"velocity_bins/width", "beat_bins/width", "sensor/wavelength"})
            EXPECT_NE(refusal(dataset, H5T_NATIVE_DOUBLE, x).find("bad.h5: "), std::string::npos) << dataset << *x;
    EXPECT_NE(refusal("sensor/chirp", H5T_NATIVE_DOUBLE, &none).find("bad.h5: "), std::string::npos);
}

TEST_F(Dopplers, options_are_refused_by_name) {
    const DerivableScene s(write(light + wall(R"(z="$t")"), 2), {"shape:wall/pose"});
    const auto refusal = [&](std::vector<std::string> texts) {
        try {
            derive::speeds_of(s.tangents, texts);
        } catch (const InputError& error) {
            return std::string(error.what());
        }
        return std::string("no error");
    };
    EXPECT_NE(refusal({}).find("give --speed"), std::string::npos);
    for (const char* text : {"", "=", "t", "t=", "shape:wall/pose.x=nan", "shape:wall/pose.x=1e999", "nothing=1"})
        EXPECT_NE(refusal({text}).find("--speed "), std::string::npos) << text;
    const std::vector<double> speeds = derive::speeds_of(s.tangents, {s.tangents.parameters[2].name + "=-2.5"});
    EXPECT_EQ(speeds, (std::vector<double>{0, 0, -2.5, 0, 0, 0}));

    derive::Options options;
    options.scene = folder / "scene.xml";
    options.wrt = {"t"};
    options.doppler.speeds = {"t=1"};
    app::Report report;
    report.set_quiet(true);
    EXPECT_THROW(derive::run(options, report), InputError);
    options.doppler.output = folder / "d.h5";
    options.output = folder / "x.h5";
    EXPECT_THROW(derive::run(options, report), InputError);
}

}  // namespace
}  // namespace loom
