// Temporal rows of derivatives: how they are made, stored, checked, and added to bins.
#include <fmt/format.h>
#include <gtest/gtest.h>

#include <cmath>

#include "formats/io/error.h"
#include "stages/derive/derive.h"
#include "stages/derive/temporal.h"
#include "stages/transient/transient.h"
#include "tests/traced_graph.h"

namespace loom {
namespace {

/// A floor, a wall, and a light that moves; a graph of it and its derivative at the borders of 32 bins.
struct Case {
    std::unique_ptr<Scene> scene;
    std::unique_ptr<derive::SceneTangents> tangents;
    PathGraph graph;
    static constexpr derive::TemporalBins window{3, .125, 32, true};

    Case() {
        const auto file = testing::scratch_file(".xml");
        std::ofstream(file) << R"(<scene version="3.0.0"><default name="up" value="0"/><default name="turn" value="0"/>
<integrator type="path"><integer name="max_depth" value="3"/></integrator>
<sensor type="perspective"><float name="fov" value="50"/><transform name="to_world">
<lookat origin="0, -3, 1.5" target="0, 0.2, 0.2" up="0, 0, 1"/></transform>
<film type="hdrfilm"><integer name="width" value="4"/><integer name="height" value="3"/><rfilter type="box"/></film></sensor>
<shape type="rectangle"><transform name="to_world"><scale value="2"/></transform></shape>
<shape type="rectangle"><transform name="to_world"><rotate x="1" angle="90"/><translate y="2" z="1"/></transform></shape>
<shape type="rectangle"><transform name="to_world"><scale x=".5" y=".3"/><rotate x="1" angle="160"/><rotate z="1" angle="$turn"/>
<translate y=".3" z="2.4"/><translate z="$up"/></transform>
<emitter type="area"><rgb name="radiance" value="5, 4, 3"/></emitter></shape></scene>)";
        const SceneDescription description = read_scene(file, {}, {});
        scene = build_scene(description);
        tangents = std::make_unique<derive::SceneTangents>(
            derive::find_tangents(*scene, description, file, {}, {}, {"up", "turn"}));
        std::filesystem::remove(file);
        graph = testing::trace_graph(*scene, testing::path_options(*scene, 1), 200);
    }
    Derivative derivative(int threads = 0) const {
        app::Report report;
        report.set_quiet(true);
        derive::DeriveCounts counts;
        derive::Parts parts;
        Derivative d =
            derive::differentiate(graph, *scene, *tangents, parts, {.light_points_per_side = 1}, report, counts);
        derive::differentiate_temporal(graph, *scene, *tangents, {}, window, threads, report, d);
        EXPECT_EQ(d.problem(), "");
        return d;
    }
    struct Cube {
        std::vector<float> bins, before, after, steady;  // [parameter, pixel, …]
    };
    Cube cube(const Derivative& d, std::uint32_t first, std::uint32_t step, std::uint32_t n) const {
        TimeResponse response;
        response.n_bins = n;
        response.start = window.start + first * window.width;
        response.width = response.gate = step * window.width;
        app::Report report;
        report.set_quiet(true);
        app::Progress progress(report, "binning", graph.n_pixels());
        Cube c;
        const transient::ExactBorders borders{first, step};
        transient::bin_graphs({&graph, 1}, {}, {&d, 1}, response, {}, std::uint64_t(1) << 30, 1, progress,
                              [&](std::uint32_t, const TransientRows& rows) {
                                  const auto& r = rows.derivative;
                                  c = {{r.bins.begin(), r.bins.end()},
                                       {r.before.begin(), r.before.end()},
                                       {r.after.begin(), r.after.end()},
                                       {r.steady.begin(), r.steady.end()}};
                              },
                              {&borders, 1});
        return c;
    }
};

const Case& the_case() {
    static const Case c;
    return c;
}

template <class T>
std::vector<T> values(const Column<T>& column) {
    return {column.begin(), column.end()};
}

TEST(TemporalRows, AreTheSameForAnyNumberOfThreads) {
    const Derivative one = the_case().derivative(1), three = the_case().derivative(3);
    ASSERT_GT(one.temporal.pixel.size(), 20u);
    EXPECT_EQ(values(one.temporal.pixel), values(three.temporal.pixel));
    EXPECT_EQ(values(one.temporal.border), values(three.temporal.border));
    EXPECT_EQ(values(one.temporal.flux), values(three.temporal.flux));
    EXPECT_EQ(values(one.temporal.var_mean), values(three.temporal.var_mean));
    EXPECT_EQ(values(one.temporal.is_exact), values(three.temporal.is_exact));
    EXPECT_EQ(values(one.temporal_bins.exact_energy), values(three.temporal_bins.exact_energy));
}

TEST(TemporalRows, MoveLightBetweenBinsAndFromOutside) {
    const Derivative d = the_case().derivative();
    // All bins, some of them, and pairs of them.
    for (const auto& [first, step, n] : {std::tuple(0u, 1u, 32u), {5u, 1u, 7u}, {2u, 2u, 10u}, {0u, 32u, 1u}}) {
        SCOPED_TRACE(fmt::format("{} {} {}", first, step, n));
        const Case::Cube c = the_case().cube(d, first, step, n);
        const Case::Cube fine = the_case().cube(d, first, 1, step * n);
        for (std::size_t i = 0; i < c.steady.size() / 3; ++i)
            for (std::size_t channel = 0; channel < 3; ++channel) {
                const std::size_t at = 3 * i + channel;
                double sum = c.before[at] + c.after[at], size = std::abs(sum);
                for (std::uint32_t k = 0; k < n; ++k) {
                    const double bin = c.bins[(i * n + k) * 3 + channel];
                    sum += bin, size += std::abs(bin);
                    double of_fine = 0, of_sizes = 0;
                    for (std::uint32_t j = 0; j < step; ++j) {
                        const double part = fine.bins[((i * n + k) * step + j) * 3 + channel];
                        of_fine += part, of_sizes += std::abs(part);
                    }
                    EXPECT_NEAR(bin, of_fine, 1e-6 * of_sizes + 1e-9);
                }
                EXPECT_NEAR(sum, c.steady[at], 1e-6 * size + 1e-9);
            }
    }
}

TEST(TemporalRows, BadOnesAreRefused) {
    const Derivative good = the_case().derivative();
    const auto problem = [](auto&& damage) {
        Derivative d = the_case().derivative();
        damage(d);
        return d.problem();
    };
    ASSERT_EQ(good.problem(), "");
    const auto with = []<class T>(const Column<T>& column, std::size_t i, T value) {
        std::vector<T> all(column.begin(), column.end());
        all[i] = value;
        return all;
    };
    EXPECT_NE(problem([&](Derivative& d) { d.temporal_bins.n = std::vector<std::uint32_t>{}; }).find("no temporal/n"),
              std::string::npos);
    EXPECT_NE(problem([&](Derivative& d) { d.temporal_bins.n = std::vector<std::uint32_t>{0}; }).find("temporal/n"),
              std::string::npos);
    EXPECT_NE(problem([&](Derivative& d) { d.temporal_bins.width_opl = std::vector<double>{0}; }).find("width_opl"),
              std::string::npos);
    EXPECT_NE(problem([&](Derivative& d) { d.temporal.is_exact = std::vector<std::uint8_t>{1}; }).find("is_exact"),
              std::string::npos);
    EXPECT_NE(problem([&](Derivative& d) {
                  d.temporal.is_exact = with(d.temporal.is_exact, 3, std::uint8_t(2));
              }).find("row 3 is 2"),
              std::string::npos);
    EXPECT_NE(problem([&](Derivative& d) {
                  d.temporal.border = with(d.temporal.border, 1, std::uint32_t(33));
              }).find("row 1 is 33"),
              std::string::npos);
    EXPECT_NE(problem([&](Derivative& d) {
                  d.temporal.border = with(d.temporal.border, 1, d.temporal.border[0]);
              }).find("row 1 is not after"),
              std::string::npos);
    EXPECT_NE(problem([&](Derivative& d) { d.temporal.flux = std::vector<float>{1}; }).find("different numbers"),
              std::string::npos);
    EXPECT_NE(
        problem([&](Derivative& d) { d.temporal_bins.exact_energy = std::vector<double>{1}; }).find("exact_energy"),
        std::string::npos);
}

class TemporalOption : public ::testing::Test {
  protected:
    void SetUp() override {
        graph = testing::scratch_file(".h5"), derivative = testing::scratch_file(".h5");
        cube = testing::scratch_file(".h5");
        write_path_graph(the_case().graph, graph, Sync::no);
        store(the_case().derivative());
    }
    void TearDown() override {
        for (const auto& file : {graph, derivative, cube}) {
            std::filesystem::remove(file);
            std::filesystem::remove(file.native() + ".cost.json");
        }
    }
    void store(Derivative d) {
        const InputId id = identify_by_header(read_path_graph(graph), graph.native());
        d.graph = id.hash;
        d.provenance = the_case().graph.provenance;
        d.provenance.inputs = {{"s.xml", "0"}, id};
        write_derivative(d, derivative, Sync::no);
    }
    /// Returns the error, or parameters/temporal.
    std::string run(double start, double width, std::uint32_t bins, transient::Temporal temporal,
                    transient::Shape pulse = transient::Shape::delta) {
        transient::Options options;
        options.graphs = {graph.native()};
        options.derivatives = {derivative.native()};
        options.output = cube.native();
        options.start = start, options.width = width, options.bins = bins;
        options.temporal = temporal, options.pulse = pulse;
        if (pulse == transient::Shape::box) options.pulse_length = width;
        app::Report report;
        report.set_quiet(true);
        try {
            transient::run(options, report);
        } catch (const InputError& error) {
            return error.what();
        }
        return read_transient_cube(cube).parameters.temporal.at(0);
    }
    std::filesystem::path graph, derivative, cube;
};

TEST_F(TemporalOption, UsesExactRowsOrRefuses) {
    using transient::Temporal;
    EXPECT_EQ(run(3, .125, 32, Temporal::exact), "exact");
    EXPECT_EQ(run(3.5, .25, 14, Temporal::exact), "exact");
    EXPECT_EQ(run(3, .125, 32, Temporal::widen), "widened");
    for (const auto& [start, width, bins] :
         {std::tuple(3.01, .125, 32u), {3., .13, 16u}, {3., .125, 33u}, {2., .125, 8u}}) {
        const std::string error = run(start, width, bins, Temporal::exact);
        EXPECT_NE(error.find(fmt::format("{} bins of {:.9g} m from {:.9g} m", bins, width, start)), std::string::npos)
            << error;
        EXPECT_NE(error.find("32 bins of 0.125 m from 3 m"), std::string::npos) << error;
    }
    EXPECT_NE(run(3, .125, 32, Temporal::exact, transient::Shape::box).find("needs --derivative and a delta pulse"),
              std::string::npos);
    EXPECT_NE(run(3, .125, 32, Temporal::refuse).find("--temporal refuse"), std::string::npos);

    // A part of the light without exact rows.
    Derivative d = the_case().derivative();
    std::vector<std::uint8_t> is_exact(d.temporal.is_exact.begin(), d.temporal.is_exact.end());
    is_exact[0] = 0;
    d.temporal.is_exact = is_exact;
    store(std::move(d));
    EXPECT_EQ(run(3, .125, 32, Temporal::exact), "partly");

    // None at all.
    d = the_case().derivative();
    d.temporal = {};
    d.temporal_bins = {};
    store(std::move(d));
    EXPECT_NE(run(3, .125, 32, Temporal::exact).find("has no samples at the borders of bins"), std::string::npos);
}

}  // namespace
}  // namespace loom
