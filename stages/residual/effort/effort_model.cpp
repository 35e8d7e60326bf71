#include "stages/residual/effort/effort_model.h"

#include <algorithm>
#include <numeric>

namespace loom::residual {
namespace {

constexpr double least_share = 0.005;

/// A sample's value in a pixel, and its derivatives with respect to the factors.
struct GroupValue {
    double r[3]{}, dr[3][max_families]{};
};

GroupValue value_of(const Pilot& pilot, std::size_t family, const PilotSamples::Group& group, bool first_to_camera,
                    const Factors& x) {
    const std::size_t K = pilot.n(), camera = K - 1;
    GroupValue out;
    for (std::uint32_t p = group.begin; p < group.end; ++p) {
        const PilotPart& part = pilot.families[family].part(p);
        const bool left = first_to_camera && part.at_first;
        if (left && family != camera) continue;
        double density = 0;
        for (std::size_t k = left ? camera : 0; k < K; ++k) density += x[k] * double(part.w[k]);
        if (!(density > 0)) continue;
        for (int c = 0; c < 3; ++c) {
            const double r = double(part.v[c]) / density;
            out.r[c] += r;
            for (std::size_t k = left ? camera : 0; k < K; ++k) out.dr[c][k] -= r * double(part.w[k]) / density;
        }
    }
    return out;
}

}  // namespace

void PilotSamples::end_sample(std::vector<PilotPart>& found, std::vector<std::uint32_t>& pixels) {
    order_.resize(found.size());
    std::iota(order_.begin(), order_.end(), 0u);
    std::stable_sort(order_.begin(), order_.end(),
                     [&](std::uint32_t a, std::uint32_t b) { return pixels[a] < pixels[b]; });
    for (const std::uint32_t k : order_) {
        const auto at = std::uint32_t(parts_.size());
        if (k == order_.front() || groups_.back().pixel != pixels[k]) groups_.push_back({pixels[k], at, at});
        parts_.push_back(found[k]);
        ++groups_.back().end;
    }
    found.clear();
    pixels.clear();
}

void PilotSamples::append(const PilotSamples& other) {
    const auto shift = std::uint32_t(parts_.size());
    parts_.insert(parts_.end(), other.parts_.begin(), other.parts_.end());
    for (const Group& g : other.groups_) groups_.push_back({g.pixel, g.begin + shift, g.end + shift});
}

Objective variance_of(const Pilot& pilot, bool first_to_camera, const Factors& x) {
    const std::size_t K = pilot.n();
    Objective o;
    o.slope.assign(K, 0);
    for (std::size_t f = 0; f + 1 < K; ++f) {
        if (!(x[f] > 0)) continue;
        double sum = 0;
        for (const PilotSamples::Group& group : pilot.families[f].groups()) {
            const GroupValue g = value_of(pilot, f, group, first_to_camera, x);
            for (int c = 0; c < 3; ++c) {
                sum += g.r[c] * g.r[c] / 3;
                for (std::size_t k = 0; k < K; ++k) o.slope[k] += x[f] * 2 / 3 * g.r[c] * g.dr[c][k];
            }
        }
        o.M += x[f] * sum;
        o.slope[f] += sum;
    }
    const double per_pixel = double(pilot.per_pixel), scale = pilot.camera_scale * per_pixel / (per_pixel - 1) / 3;
    const std::vector<PilotSamples::Group>& groups = pilot.families[K - 1].groups();
    std::vector<GroupValue> values;  // of a pixel's samples; missing ones are 0
    for (std::size_t begin = 0; begin < groups.size();) {
        values.clear();
        double mean[3]{};
        for (std::size_t g = begin; g < groups.size() && groups[g].pixel == groups[begin].pixel; ++g) {
            values.push_back(value_of(pilot, K - 1, groups[g], first_to_camera, x));
            for (int c = 0; c < 3; ++c) mean[c] += values.back().r[c] / per_pixel;
        }
        for (int c = 0; c < 3; ++c) {
            double sum = (per_pixel - double(values.size())) * mean[c] * mean[c];
            for (const GroupValue& v : values) sum += sqr(v.r[c] - mean[c]);
            o.of_cameras += x[K - 1] * scale * sum;
            o.slope[K - 1] += scale * sum;
            for (const GroupValue& v : values)
                for (std::size_t k = 0; k < K; ++k)
                    o.slope[k] += x[K - 1] * scale * 2 * (v.r[c] - mean[c]) * v.dr[c][k];
        }
        begin += values.size();
    }
    o.M += o.of_cameras;
    return o;
}

double camera_variance_by_all(const Pilot& pilot, double x_camera) {
    constexpr float least_share_of_camera = 1e-6f;  // of a part's density: rounding errors must not dominate
    double sum = 0;
    for (const PilotSamples& family : pilot.families)
        for (const PilotSamples::Group& group : family.groups())
            for (std::uint32_t p = group.begin; p < group.end; ++p) {
                const PilotPart& part = family.part(p);
                const double share = std::max(part.w[pilot.n() - 1], least_share_of_camera),
                             scale = &family == &pilot.families.back() ? pilot.camera_scale : 1;
                for (const float v : part.v) sum += scale * double(v) * v / (3 * x_camera * share);
            }
    return sum;
}

Spending best_spending(const Pilot& pilot, bool first_to_camera, double budget, double map_gain, double least_cameras) {
    const std::size_t K = pilot.n();
    Spending best;
    best.first_to_camera = first_to_camera;
    best.M = INFINITY;
    Factors x(K, 1);
    const auto normalise = [&] {
        double cost = 0;
        for (std::size_t k = 0; k < K; ++k) cost += x[k] * pilot.cost[k];
        for (double& v : x) v *= budget / cost;
        // VarMean requires two camera paths in every pixel.
        const double least = std::max(2.0 / double(pilot.per_pixel), least_cameras * budget / pilot.cost[K - 1]);
        if (x[K - 1] >= least) return;
        const double others = std::max(budget - x[K - 1] * pilot.cost[K - 1], 1e-30),
                     left = std::max(budget - least * pilot.cost[K - 1], 0.05 * budget);
        for (std::size_t k = 0; k + 1 < K; ++k) x[k] *= left / others;
        x[K - 1] = least;
    };
    normalise();
    constexpr int n_steps = 16;
    for (int step = 0; step < n_steps; ++step) {
        const Objective o = variance_of(pilot, first_to_camera, x);
        if (const double M = o.M - o.of_cameras * (1 - 1 / map_gain); M < best.M) {
            best.x = x;
            best.M = M;
        }
        const double lambda = o.M / budget;
        for (std::size_t k = 0; k < K; ++k) {
            if (!(x[k] > 0) || !(pilot.cost[k] > 0)) continue;
            x[k] *= std::sqrt(clamp(-o.slope[k] / (lambda * pilot.cost[k]), 0.1, 10.0));
            if (k + 1 < K && x[k] * pilot.cost[k] < least_share * budget) x[k] = 0;
        }
        normalise();
    }
    return best;
}

}  // namespace loom::residual
