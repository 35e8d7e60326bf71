#include "stages/derive/adjoint.h"

#include <fmt/format.h>

#include <cmath>

#include "formats/io/error.h"
#include "formats/path_graph.h"

namespace loom::derive {

TimeResponse response_of(const TransientCubeHeader& header, const std::string& name) {
    const auto& t = header.time;
    const auto& r = header.response;
    const auto positive = [&](double x, const char* what) {
        if (!(x > 0) || !std::isfinite(x)) throw InputError(fmt::format("{}: {} is {}, not positive", name, what, x));
        return x;
    };
    TimeResponse response;
    response.n_bins = t.n_bins;
    response.start = t.start_opl;
    response.width = positive(t.bin_width_opl, "time/bin_width_opl");
    response.gate = positive(t.gate_opl, "time/gate_opl");
    if (!std::isfinite(t.start_opl)) throw InputError(fmt::format("{}: time/start_opl is not finite", name));
    const auto length = [&] { return positive(r.length_opl, "response/length_opl"); };
    if (r.pulse == "box") {
        response.pulse = Pulse::box(length());
    } else if (r.pulse == "gaussian") {
        response.pulse = Pulse::gaussian(length());
    } else if (r.pulse == "expgauss") {
        response.pulse = Pulse::exponential_gaussian(length(), positive(r.tail_opl, "response/tail_opl"));
    } else if (r.pulse == "sine" || r.pulse == "square") {
        response.modulation = r.pulse == "sine" ? Modulation::sine : Modulation::square;
        response.period = positive(r.period_opl, "response/period_opl");
    } else if (r.pulse != "delta") {
        throw InputError(fmt::format(
            "{}: response/pulse is '{}'; weights need delta, box, gaussian, expgauss, sine or square, which "
            "the file describes whole",
            name, r.pulse));
    }
    return response;
}

Adjoint::Adjoint(TransientCube cube, const PathGraph& graph, const std::string& name)
    : cube_(std::move(cube)), response_(response_of(cube_, name)) {
    if (cube_.film.width != graph.sensor.width || cube_.film.height != graph.sensor.height)
        throw InputError(fmt::format("{}: is {} x {} pixels, but the graph is {} x {}", name, cube_.film.width,
                                     cube_.film.height, graph.sensor.width, graph.sensor.height));
    for (const float weight : cube_.radiance)
        if (!std::isfinite(weight)) throw InputError(fmt::format("{}: radiance: a weight is not finite", name));
}

bool Adjoint::at(std::size_t pixel, double opl, LightWeight& weight) const {
    weight = {};
    if (std::isinf(opl)) return false;
    const float* bins = cube_.radiance.data() + pixel * 3 * response_.n_bins;
    bool any = false;
    response_.spread_with_slopes(opl, [&](std::uint32_t k, double w, double slope) {
        for (std::size_t c = 0; c < 3; ++c) {
            const double by = double(bins[3 * k + c]);
            weight.value[int(c)] += by * w;
            weight.slope[int(c)] += by * slope;
            any |= by != 0;
        }
    });
    return any;
}

Rgb<double> Adjoint::value_at(std::size_t pixel, double opl) const {
    Rgb<double> sum;
    if (!(opl >= 0) || std::isinf(opl)) return sum;
    const float* bins = cube_.radiance.data() + pixel * 3 * response_.n_bins;
    response_.spread(opl, [&](std::uint32_t k, double w) {
        for (int c = 0; c < 3; ++c) sum[c] += double(bins[3 * k + std::uint32_t(c)]) * w;
    });
    return sum;
}

}  // namespace loom::derive
