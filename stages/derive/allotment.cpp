#include "stages/derive/allotment.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <functional>

#include "stages/derive/interior_pilot.h"

namespace loom::derive {
namespace {

using Rows = std::vector<BoundaryRows>;
using Samples = std::span<std::uint64_t>;
using ByParameter = std::vector<double>;

/// Sum of the squares of derivatives: the variance of pixels and bins, but for the square of the mean.
/// A light in a pulse of one bin spreads over two, whose squares are 2/3 of the light's in the mean.
ByParameter second_moments(const BoundaryScene& s, const Rows& rows) {
    const double share = s.graph.transient.n_bins.empty() ? 1 : 2.0 / 3;
    ByParameter sum(s.n());
    for (const BoundaryRows& part : rows)
        for (std::size_t p = 0; p < part.square.size(); ++p) sum[p] += share * part.square[p];
    return sum;
}

/// Number of samples of equal size with such sums of squares: the least over the parameters that have any.
double effective_number(const Rows& rows) {
    ByParameter square, fourth;
    for (const BoundaryRows& part : rows) {
        square.resize(std::max(square.size(), part.square.size()));
        fourth.resize(square.size());
        for (std::size_t p = 0; p < part.square.size(); ++p) square[p] += part.square[p], fourth[p] += part.fourth[p];
    }
    double least = INFINITY;
    for (std::size_t p = 0; p < square.size(); ++p)
        if (fourth[p] > 0) least = std::min(least, sqr(square[p]) / fourth[p]);
    return least;
}

std::uint64_t number_of(const Rows& rows) {
    std::uint64_t n = 0;
    for (const BoundaryRows& part : rows) n += part.n_rows;
    return n;
}

std::uint64_t count(double n) {
    return std::uint64_t(std::max(1.0, std::ceil(n)));
}

class Allotment {
  public:
    Allotment(BoundaryScene& s, const Parts& parts, app::Report& report)
        : s_(s), parts_(parts), report_(report), silent_(report.name()), n_paths_(double(s.graph.n_paths())) {
        silent_.set_quiet(true);
        path_cost_ = cost_of_path(s.graph);
        least_share_ = std::min(1.0, 256 / std::max(n_paths_, 1.0));
    }

    std::uint64_t sample(Rows& rows, Samples samples) {
        const std::uint64_t seed = s_.seed;
        s_.seed = streams::pilot(seed);
        list_families();
        for (Family& family : families_) family.pilot = run_pilot(family);
        s_.seed = seed;
        const double scale = scale_of_samples();
        std::string shares;
        double total = 0;
        for (std::size_t f = 0; f < families_.size(); ++f) {
            const Family& family = families_[f];
            // A pilot that does not tell may have been too small.
            const double least = family.pilot.tells ? family.least : family.pilot.n;
            const double wanted = full_[f] ? family.most : scale * std::sqrt(variance_[f] / family.pilot.cost);
            const double n = std::min(std::max(wanted, least), family.most);
            rays_ += family.run(n, rows, samples, report_).rays;
            const double effort = n * family.pilot.cost / (n_paths_ * path_cost_);
            total += effort;
            shares += fmt::format("{}{} {:.2g}", f > 0 ? ", " : "", boundary_family_name(family.name), effort);
        }
        if (!families_.empty())
            report_.info("effort of boundary samples, over that of tracing and binning: {:.2g} ({})", total, shares);
        return rays_;
    }

  private:
    struct Pilot {
        double n = 0;          // samples, or share of the paths
        ByParameter variance;  // of one sample, or of all paths
        double cost = 0;       // of one, or of all
        std::uint64_t n_rows = 0;
        bool tells = false;  // enough rows make the variance, not a few
    };
    struct Family {
        BoundaryFamily name;
        std::function<Effort(double, Rows&, Samples, app::Report&)> run;
        double least, most;  // number of samples, or share of the paths
        Pilot pilot;
    };

    void list_families() {
        const bool deep = s_.graph.tracing.max_depth < 0 || s_.graph.tracing.max_depth >= 3;
        bool environment = false;
        for (const Emitter& e : s_.scene.emitters)
            environment |= parts_.direct && (e.kind == EmitterKind::constant || e.kind == EmitterKind::envmap);
        if (parts_.direct) choose_direct(deep);
        const auto any = [](const std::vector<char>& of) {
            return std::any_of(of.begin(), of.end(), [](char x) { return x != 0; });
        };
        if (parts_.primary)
            families_.push_back({BoundaryFamily::primary,
                                 [this](double n, Rows& rows, Samples samples, app::Report& to) {
                                     return add_primary(s_, count(n), rows, samples, to);
                                 },
                                 1024,
                                 INFINITY,
                                 {}});
        if (any(by_vertex_))
            families_.push_back({BoundaryFamily::vertex_light,
                                 [this](double share, Rows& rows, Samples samples, app::Report& to) {
                                     return add_vertex_light(s_, share, by_vertex_, rows, samples, to);
                                 },
                                 least_share_,
                                 1,
                                 {}});
        if (any(by_light_))
            families_.push_back({BoundaryFamily::edge_light,
                                 [this](double n, Rows& rows, Samples samples, app::Report& to) {
                                     return add_edge_light(s_, count(n), by_light_, rows, samples, to);
                                 },
                                 64,
                                 INFINITY,
                                 {}});
        if (any(by_joining_))
            families_.push_back({BoundaryFamily::joined_light,
                                 [this](double share, Rows& rows, Samples samples, app::Report& to) {
                                     return add_joined_light(s_, share, by_joining_, rows, samples, to);
                                 },
                                 least_share_,
                                 1,
                                 {}});
        if (parts_.indirect || environment) {
            const IndirectUnits units = indirect_units(s_, parts_.indirect, environment);
            constexpr double most = 8;  // shares above 1 are more points of the same paths
            families_.push_back({BoundaryFamily::indirect,
                                 [=, this](double share, Rows& rows, Samples samples, app::Report& to) {
                                     return add_indirect(s_, share, units, parts_.indirect, environment, rows, samples,
                                                         to);
                                 },
                                 least_share_,
                                 most,
                                 {}});
        }
    }

    /// Samples until some rows are found and a few of them no longer make the variance, or for a hundredth of the cost of
    /// tracing and binning.
    Pilot run_pilot(const Family& family) {
        constexpr std::uint64_t enough = 300;
        constexpr double enough_of_equal_size = 30, most_unseen = 10;
        const double most_cost = std::max(0.01 * n_paths_ * path_cost_, 4096.0);
        Pilot pilot;
        for (double n = family.least;; n *= 4) {
            n = std::min(n, family.most);
            Rows tried;
            std::vector<std::uint64_t> n_tried(n_boundary_families);
            const Effort effort = family.run(n, tried, n_tried, silent_);
            rays_ += effort.rays;
            pilot = {n, second_moments(s_, tried), std::max(effort.cost() / n, 1e-9), number_of(tried)};
            // Where a few rows make the variance, rarer and larger ones are likely.
            const double effective = effective_number(tried),
                         unseen = std::clamp(enough_of_equal_size / effective, 1.0, most_unseen);
            for (double& v : pilot.variance) v *= n * unseen;
            pilot.tells = pilot.n_rows >= enough && effective >= enough_of_equal_size;
            // Without any work there is nothing to sample.
            if (effort.cost() == 0 || pilot.tells || effort.cost() >= most_cost || n >= family.most) return pilot;
        }
    }

    /// Computes a of n_f = a sqrt(V_f / c_f), and V_f over all parameters.
    double scale_of_samples() {
        const double traced = n_paths_ * path_cost_;
        const bool automatic = !s_.options.effort && !s_.options.adjoint;
        const double effort = s_.options.effort.value_or(default_effort);
        ByParameter interior(s_.n());
        if (automatic && !s_.options.interior_variance.empty()) interior = s_.options.interior_variance;
        variance_.assign(families_.size(), 0);
        double rest = 0;
        for (std::size_t p = 0; p < s_.n(); ++p) {
            double root = 0;
            for (const Family& family : families_) root += std::sqrt(family.pilot.variance[p] * family.pilot.cost);
            const double sum = interior[p] + sqr(root) / (effort * traced);
            if (!(sum > 0)) continue;
            rest += interior[p] / sum;
            for (std::size_t f = 0; f < families_.size(); ++f) variance_[f] += families_[f].pilot.variance[p] / sum;
        }
        // Families that are sampled as much as they can be leave their share to the others.
        full_.assign(families_.size(), 0);
        constexpr double with_interior = 1.3;
        const double most = automatic ? with_interior * traced : effort * traced;
        for (;;) {
            double root = 0, full_cost = 0, full_variance = 0;
            for (std::size_t f = 0; f < families_.size(); ++f) {
                const Family& family = families_[f];
                if (full_[f])
                    full_cost += family.pilot.cost * family.most, full_variance += variance_[f] / family.most;
                else
                    root += std::sqrt(variance_[f] * family.pilot.cost);
            }
            if (!(root > 0)) return 0;
            double scale = std::max(most - full_cost, 0.0) / root;
            if (automatic && rest + full_variance > 0)
                scale = std::min(scale, std::sqrt((with_interior * traced + full_cost) / (rest + full_variance)));
            bool fills = false;
            for (std::size_t f = 0; f < families_.size(); ++f) {
                if (full_[f] || scale * std::sqrt(variance_[f] / families_[f].pilot.cost) < families_[f].most) continue;
                full_[f] = 1, fills = true;
            }
            if (!fills) return scale;
        }
    }

    /// Chooses, by emitter, whether light points are the cheaper way: by variance times cost of a few samples of each.
    /// Lights without area have no other.
    void choose_direct(bool deep) {
        const std::size_t n_emitters = s_.scene.emitters.size();
        by_light_.assign(n_emitters, 0);
        by_joining_.assign(n_emitters, 0);
        by_vertex_.assign(n_emitters, 0);
        constexpr std::size_t most = 16;  // pilots; further emitters follow the majority
        std::size_t n_pilots = 0;
        std::array<std::size_t, 2> n_chosen = {};  // at first hits, beyond
        for (std::size_t e = 0; e < n_emitters; ++e) {
            const Emitter& emitter = s_.scene.emitters[e];
            if (emitter.kind == EmitterKind::area) {
                // Segments from vertex to vertex pass masks, those that join do not.
                const bool touched = s_.touched_emitters[e] != 0;
                const std::array<bool, 2> possible = {!touched, deep && !touched && !s_.scene.features.null_lobes};
                std::array<char, 2> chosen = {};
                const bool piloted = s_.options.direct == Direct::automatic && n_pilots++ < most;
                for (std::size_t k = 0; k < 2; ++k) {
                    if (!possible[k]) continue;
                    if (piloted)
                        chosen[k] = prefers_light_points(e, k == 1);
                    else
                        chosen[k] = s_.options.direct == Direct::automatic ? 2 * n_chosen[k] > most
                                                                           : s_.options.direct == Direct::lights;
                    n_chosen[k] += std::size_t(chosen[k]);
                }
                by_light_[e] = chosen[0], by_joining_[e] = chosen[1];
                by_vertex_[e] = char((chosen[0] ? 0 : reached_by::camera) | (chosen[1] ? 0 : reached_by::joined));
                if (deep) by_vertex_[e] |= reached_by::unjoined;
                if (s_.scene.features.delta_lobes || s_.scene.features.null_lobes) by_vertex_[e] |= reached_by::delta;
            } else if (emitter.is_delta()) {
                by_light_[e] = !s_.scene.nlos, by_joining_[e] = deep;
            }
        }
    }

    /// in:      beyond  at vertices behind the first hits
    char prefers_light_points(std::size_t e, bool beyond) {
        std::vector<char> only(s_.scene.emitters.size());
        only[e] = beyond ? reached_by::joined : reached_by::camera;
        const auto at_vertices = [&](double share, Rows& rows, Samples samples, app::Report& to) {
            return add_vertex_light(s_, share, only, rows, samples, to);
        };
        const auto joined = [&](double share, Rows& rows, Samples samples, app::Report& to) {
            return add_joined_light(s_, share, only, rows, samples, to);
        };
        const auto on_film = [&](double n, Rows& rows, Samples samples, app::Report& to) {
            return add_edge_light(s_, count(n), only, rows, samples, to);
        };
        const Pilot vertices = run_pilot({BoundaryFamily::vertex_light, at_vertices, least_share_, 1, {}}),
                    lights = beyond ? run_pilot({BoundaryFamily::joined_light, joined, least_share_, 1, {}})
                                    : run_pilot({BoundaryFamily::edge_light, on_film, 64, INFINITY, {}});
        double vertex_work = 0, light_work = 0;
        for (std::size_t p = 0; p < s_.n(); ++p) {
            const double v = vertices.variance[p] * vertices.cost, l = lights.variance[p] * lights.cost;
            if (!(v + l > 0)) continue;
            vertex_work += v / (v + l);
            light_work += l / (v + l);
        }
        // Rare vertices near an edge may make the variance.
        return light_work > 0 && (!vertices.tells || light_work < vertex_work);
    }

    static constexpr double default_effort = 0.25;

    BoundaryScene& s_;
    const Parts& parts_;
    app::Report& report_;
    app::Report silent_;
    double n_paths_, path_cost_ = 1, least_share_ = 1;
    std::vector<char> by_light_;    // by emitter: points of the light, for first hits
    std::vector<char> by_joining_;  // by emitter: the same beyond
    std::vector<char> by_vertex_;   // by emitter: the vertices (reached_by) that look for its edges
    std::vector<Family> families_;
    ByParameter variance_;    // [family], over all parameters
    std::vector<char> full_;  // [family] sampled as much as it can be
    std::uint64_t rays_ = 0;
};

}  // namespace

std::uint64_t sample_families(BoundaryScene& s, const Parts& parts, Rows& rows, Samples samples, app::Report& report) {
    return Allotment(s, parts, report).sample(rows, samples);
}

}  // namespace loom::derive
