#include "stages/derive/outline.h"

#include <algorithm>
#include <bit>

namespace loom::derive {

using Vec = Vector3<double>;
using Pt = Point3<double>;

namespace {

/// Sum of the sizes of the components: a length without a root.
double size_of(const Vec& v) {
    return std::abs(v.x) + std::abs(v.y) + std::abs(v.z);
}

}  // namespace

Outline::Outline(const BoundaryScene& s) : s_(s), velocity_(s.n()), v_face_(s.n()) {
    // Many seams are listed in proportion to their lengths, those of each kind by themselves.
    constexpr double most = 128;
    const auto add = [&](std::size_t begin, std::size_t end) {
        double total = 0, sum = 0;
        for (std::size_t i = begin; i < end; ++i) total += s.seams[i].length();
        for (std::size_t i = begin; i < end; ++i) {
            const double share = double(end - begin) <= most ? 1 : std::min(1.0, most * s.seams[i].length() / total);
            seam_share_.push_back(share);
            seam_sum_.push_back(sum += share);
        }
    };
    add(0, s.n_moving_seams);
    add(s.n_moving_seams, s.seams.size());
}

void Outline::look(OutlinePoint& point) const {
    if (at_infinity_) {
        point.omega = -Vec(eye_);
        point.r = 1;
        return;
    }
    const Vec d = point.p - eye_;
    point.r = length(d);
    point.omega = d / point.r;
}

double Outline::Arc::at(double t) const {
    const double x = 2 * t;
    return x < 1 ? importance[0] + x * (importance[1] - importance[0])
                 : importance[1] + (x - 1) * (importance[2] - importance[1]);
}

double Outline::Arc::sample(double u) const {
    // The integral of the first half, then of the second.
    const double first = 0.25 * (importance[0] + importance[1]), target = u * mean();
    const bool second = target >= first;
    const double begin = importance[second ? 1 : 0], end = importance[second ? 2 : 1];
    const double area = 2 * (second ? target - first : target), slope = end - begin;
    // begin x + slope x^2 / 2 = area, by the root that does not cancel.
    const double root = std::sqrt(std::max(sqr(begin) + 2 * slope * area, 0.0));
    const double x = begin + root > 0 ? 2 * area / (begin + root) : 0;
    return std::min(0.5 * ((second ? 1 : 0) + std::min(x, 1.0)), 1.0);
}

double Outline::importance(const Pt& x, const Vec& out) const {
    double sum = 0;
    for (std::size_t p = 0; p < velocity_.size(); ++p) {
        // A part of the speeds covers edges that move along themselves.
        sum += std::abs(dot(out, velocity_[p] - v_eye_[p])) +
               0.05 * length(out) * (size_of(velocity_[p]) + size_of(v_eye_[p]) + 1e-9);
    }
    return at_infinity_ ? sum : sum / length(x - eye_);
}

void Outline::combine_weights(std::span<const double> far_speed) {
    // What lies behind a silhouette is not known yet. Where that can move, a share of the samples takes all silhouettes
    // alike: an edge at rest in front of a moving surface matters, too.
    constexpr double share = 0.25;
    double speed = 0, known = 0, extent = 0;
    for (const double v : far_speed) speed += v;
    for (const double w : known_) known += w;
    for (const double w : extent_) extent += w;
    cumulative_.clear();
    total_known_ = known;
    total_importance_ = known + part_of_behind * speed * extent;
    double total = 0;
    for (std::size_t i = 0; i < known_.size(); ++i) {
        if (known > 0) total += known_[i] / known;
        if (speed > 0 && extent > 0) total += share * extent_[i] / extent;
        cumulative_.push_back(total);
    }
}

bool Outline::collect(const Shaft& shaft, const Pt& eye, bool at_infinity, ConstVelocities v_eye,
                      std::span<const double> far_speed, const EdgeTree& tree, bool all, int n_points, float u) {
    tree_ = &tree;
    eye_ = eye;
    at_infinity_ = at_infinity;
    v_eye_.assign(v_eye.begin(), v_eye.end());
    arcs_.clear();
    exact_arc_ = no_arc;
    known_.clear();
    extent_.clear();
    segments_.clear();
    // Of many edges a random part: fewer blocks cost less time and more variance, with a flat optimum. In the shaft of a
    // light there are mostly few, and what lies behind them is the light.
    const bool to_light = shaft.planes().size() > 1;
    const std::size_t n_blocks = 16 * std::size_t(n_points), most_visits = (to_light ? 256 : 16) * n_blocks;
    const bool try_all = tree.n_edges() <= 8 * n_blocks || to_light;
    std::size_t n_visited = try_all ? tree.collect(shaft, segments_, most_visits) : 0;
    if (!try_all || n_visited > most_visits) {
        double end_speed = 0;
        if (!at_infinity)
            for (const Vec& v : v_eye) end_speed += length(v);
        if (to_light)
            for (const double v : far_speed) end_speed += v;
        n_visited += tree.collect_some(shaft, double(n_blocks), end_speed, std::bit_cast<std::uint32_t>(u), segments_);
    }
    creases_.clear();
    seams_.clear();
    OutlinePoint point;
    n_found_ += segments_.size() + n_visited / 4;
    for (const EdgeSegment& segment : segments_) add_segment(segment, [](double) { return 1.0; });
    rounds_ = at_infinity ? s_.rounds_along(Vec(eye), all) : s_.rounds_from(eye, all);
    for (const Round& round : rounds_) {
        constexpr int looked_at = 8;
        double sum = 0, extent = 0;
        for (int k = 0; k < looked_at; ++k) {
            const double phi = 2 * pi_double * (k + 0.5) / looked_at;
            point.p = round.point(phi);
            look(point);
            const Vec t = round.tangent(phi);
            point.out = outward(normalize(t), point.omega, round.middle - point.p);
            s_.shape_velocity(round.shape_idx, 0, point.p, velocity_);
            sum += importance(point.p, point.out) * length(t) / (at_infinity ? 1 : point.r);
            extent += length(point.out) * length(t) / (at_infinity ? 1 : sqr(point.r));
        }
        arcs_.push_back({0, 2 * pi_double});
        known_.push_back(sum * 2 * pi_double / looked_at);
        extent_.push_back(extent * 2 * pi_double / looked_at);
    }
    first_crease_ = first_seam_ = arcs_.size();
    combine_weights(far_speed);
    return !cumulative_.empty() && cumulative_.back() > 0;
}

bool Outline::add_creases(const Shaft& shaft, std::span<const double> far_speed, float u) {
    constexpr double most = 32;
    std::array<double, BoundaryScene::most_crease_groups> shares;
    double wanted = 0;
    for (std::size_t i = 0; i < s_.crease_groups.size(); ++i) {
        const BoundaryScene::CreaseGroup& group = s_.crease_groups[i];
        shares[i] = s_.passing_share(Attached::share_of(group.reach, distance(group.box, eye_)));
        wanted += shares[i] * double(group.end - group.begin);
    }
    const double scale = wanted > most ? most / wanted : 1;
    double before = 0, target = double(u);  // evenly spaced from a random start
    for (std::size_t i = 0; i < s_.crease_groups.size(); ++i) {
        const BoundaryScene::CreaseGroup& group = s_.crease_groups[i];
        const double share = shares[i] * scale, after = before + share * double(group.end - group.begin);
        for (; target < after; ++target)
            add_crease(s_.creases[std::min(group.begin + std::size_t((target - before) / share), group.end - 1)], share,
                       shaft);
        before = after;
    }
    first_seam_ = arcs_.size();
    combine_weights(far_speed);
    return !cumulative_.empty() && cumulative_.back() > 0;
}

void Outline::add_crease(std::uint32_t edge_idx, double share, const Shaft& shaft) {
    ++n_found_;
    const Edge& edge = s_.all_edges.edge(edge_idx);
    std::array<EdgeInterval, 2> inside;
    if (shaft.is_silhouette(edge) || shaft.clip(edge, inside) == 0) return;
    const EdgeSegment segment{inside[0].s0, inside[0].s1, edge_idx,
                              float(edge.length() * (inside[0].s1 - inside[0].s0)), float(share)};
    add_segment(segment, [&](double r) { return s_.slide_share(edge.shape_idx, r); });
    creases_.push_back(segment);
}

bool Outline::add_seams(const Shaft& shaft, std::span<const double> far_speed, bool all, float u) {
    const auto add = [&](std::size_t i) {
        std::array<EdgeInterval, 2> inside;
        ++n_found_;
        if (shaft.clip(s_.seams[i].a, s_.seams[i].b, inside) > 0) add_seam(i, inside[0], seam_share_[i]);
    };
    const auto list = [&](std::size_t begin, std::size_t end) {
        if (begin == end) return;
        const auto first = seam_sum_.begin() + std::ptrdiff_t(begin), last = seam_sum_.begin() + std::ptrdiff_t(end);
        if (last[-1] >= double(end - begin)) {
            for (std::size_t i = begin; i < end; ++i) add(i);
            return;
        }
        // Evenly spaced in the sum of the shares, from a random start.
        for (double target = double(u); target < last[-1]; ++target)
            add(std::size_t(std::upper_bound(first, last, target) - seam_sum_.begin()));
    };
    list(0, s_.n_moving_seams);
    if (all) list(s_.n_moving_seams, s_.seams.size());
    combine_weights(far_speed);
    return !cumulative_.empty() && cumulative_.back() > 0;
}

Outline::Arc Outline::arc_between(const Pt& a, const Pt& b, double begin, double end) const {
    Arc arc{begin, end};
    if (at_infinity_) return arc;
    const Vec t = normalize(b - a), to_eye = eye_ - a;
    arc.foot = dot(to_eye, t);
    arc.height = length(to_eye - t * arc.foot);
    if (arc.height > 0) {
        arc.begin = std::atan2(begin - arc.foot, arc.height);
        arc.end = std::atan2(end - arc.foot, arc.height);
    }
    return arc;
}

double Outline::along_arc(const Arc& arc, double t) const {
    const double angle = arc.begin + (arc.end - arc.begin) * t;
    return at_infinity_ ? angle : arc.foot + arc.height * std::tan(angle);
}

void Outline::add_seam(std::size_t seam_idx, const EdgeInterval& inside, double share) {
    const Seam& seam = s_.seams[seam_idx];
    const double len = seam.length();
    const Arc arc = arc_between(Pt(seam.a), Pt(seam.b), inside.s0 * len, inside.s1 * len);
    OutlinePoint point;
    point.p = seam.point(0.5 * (inside.s0 + inside.s1));
    look(point);
    point.out = cross((Pt(seam.b) - Pt(seam.a)) / len, point.omega);
    for (std::size_t i = 0; i < 2; ++i)
        s_.shape_velocity(seam.faces[i].shape_idx, seam.faces[i].triangle_idx, point.p, i == 0 ? velocity_ : v_face_);
    // Points that stay on the two surfaces pass the line; others may do so by the motion of the eye, too.
    double speed = 0;
    for (std::size_t p = 0; p < velocity_.size(); ++p) {
        const Vec v = seam.velocity(velocity_[p], v_face_[p]);
        for (const Vec& of_face : {velocity_[p], v_face_[p]}) speed += std::abs(dot(point.out, v - of_face)) / point.r;
        velocity_[p] = v;
    }
    const double slides =
        std::max(s_.slide_share(seam.faces[0].shape_idx, point.r), s_.slide_share(seam.faces[1].shape_idx, point.r));
    if (s_.attached.any_slides()) speed += slides * importance(point.p, point.out);
    const double extent = arc.height > 0 ? arc.end - arc.begin : 0;
    const double sine = std::max(length(point.out), 1e-6);
    seams_.push_back({inside, seam_idx, share});
    arcs_.push_back(arc);
    known_.push_back(extent * speed / (sine * share));
    extent_.push_back((at_infinity_ ? extent : extent / point.r) / share);
}

template <class ShareAt>
void Outline::add_segment(const EdgeSegment& segment, ShareAt&& share_at) {
    const Edge& edge = tree_->edge(segment.edge_idx);
    const Pt ends[2] = {edge.point(segment.s0), edge.point(segment.s1)};
    // Weights need no exact angles, which take most of the time. Light per angle falls with the distance; the sine of the
    // edge's slant is in the angle.
    Vec normal;          // of the plane through eye and edge
    double r[3], angle;  // distances of begin, middle and end; about the angle of the segment
    double to_middle = 0.5;
    if (at_infinity_) {
        const Vec along = ends[1] - ends[0];
        normal = cross(along, Vec(eye_));
        angle = length(along);
        r[0] = r[1] = r[2] = 1;
    } else {
        const Vec d0 = ends[0] - eye_, d1 = ends[1] - eye_;
        normal = cross(d0, d1);
        r[0] = length(d0), r[2] = length(d1);
        const double cosine = std::min(dot(d0, d1) / (r[0] * r[2]), 1.0);
        angle = std::sqrt(2 * (1 - cosine));  // the chord
        // The line that halves the angle.
        to_middle = r[0] / (r[0] + r[2]);
        r[1] = std::max(to_middle * r[2] * std::sqrt(2 * std::max(1 + cosine, 0.0)), 1e-9 * r[2]);
    }
    const double size = length(normal);
    Arc arc;
    if (size > 0) {
        normal = normal / size;
        s_.edge_velocity(tree_->set(), edge, segment.s0, velocity_);
        const bool varies = !s_.motions.only_translates(edge.shape_idx);
        if (varies) s_.edge_velocity(tree_->set(), edge, segment.s1, v_face_);
        double speed[3] = {};
        for (std::size_t p = 0; p < velocity_.size(); ++p) {
            const Vec begin = velocity_[p] - v_eye_[p], end = varies ? v_face_[p] - v_eye_[p] : begin;
            const double across0 = dot(normal, begin), across2 = dot(normal, end),
                         across1 = across0 + (across2 - across0) * to_middle;
            const double rest = 0.05 * (size_of(velocity_[p]) + size_of(v_eye_[p]) + 1e-9);
            speed[0] += std::abs(across0) + rest;
            speed[1] += std::abs(across1) + rest;
            speed[2] += std::abs(across2) + rest;
        }
        for (std::size_t k = 0; k < 3; ++k) arc.importance[k] = speed[k] / r[k];
    }
    arcs_.push_back(arc);
    const double weight = size > 0 ? angle * share_at(r[1]) / double(segment.share) : 0;
    known_.push_back(weight * arc.mean());
    extent_.push_back(weight / r[1]);
}

bool Outline::place_on_edge(std::size_t i, double t, OutlinePoint& point) {
    const bool is_crease = i >= first_crease_;
    const EdgeSegment& segment = is_crease ? creases_[i - first_crease_] : segments_[i];
    const Edge& edge = tree_->edge(segment.edge_idx);
    const double len = edge.length();
    if (i != exact_arc_) exact_ = arc_between(Pt(edge.a), Pt(edge.b), segment.s0 * len, segment.s1 * len);
    exact_arc_ = i;
    const Arc& arc = exact_;
    if (!(arc.height > 0) || !(arc.end > arc.begin)) return false;
    point.edge = &edge;
    point.seam = nullptr;
    point.is_crease = is_crease;
    const double s = std::clamp(along_arc(arc, t) / len, segment.s0, segment.s1);
    point.p = edge.point(s);
    look(point);
    point.out = outward(edge, point.omega);
    point.shape_idx = edge.shape_idx;
    // d angle / d length = height / r^2
    point.density = (at_infinity_ ? 1 : arc.height / sqr(point.r)) / (arc.end - arc.begin);
    point.density *= double(segment.share);
    s_.edge_velocity(tree_->set(), edge, s, velocity_);
    return true;
}

bool Outline::place_on_seam(std::size_t i, double t, OutlinePoint& point) {
    const SeamPart& part = seams_[i - first_seam_];
    const Seam& seam = s_.seams[part.seam_idx];
    const Arc& arc = arcs_[i];
    point.edge = nullptr;
    point.seam = &seam;
    point.is_crease = true;
    const double len = seam.length();
    point.p = seam.point(std::clamp(along_arc(arc, t) / len, part.inside.s0, part.inside.s1));
    look(point);
    point.out = cross((Pt(seam.b) - Pt(seam.a)) / len, point.omega);
    point.shape_idx = seam.faces[0].shape_idx;
    point.density = part.share * (at_infinity_ ? 1 : arc.height / sqr(point.r)) / (arc.end - arc.begin);
    s_.seam_velocity(seam, point.p, velocity_);
    return true;
}

bool Outline::place_on_round(std::size_t i, double t, OutlinePoint& point) {
    const Round& round = rounds_[i - segments_.size()];
    const double phi = 2 * pi_double * t;
    const Vec tangent = round.tangent(phi);
    const double speed = length(tangent);
    point.p = round.point(phi);
    point.edge = nullptr;
    point.seam = nullptr;
    point.is_crease = false;
    point.phi = phi;
    look(point);
    if (!(speed > 0)) return false;
    point.out = outward(tangent / speed, point.omega, round.middle - point.p);
    point.shape_idx = round.shape_idx;
    point.density = 1 / (2 * pi_double * speed);
    s_.shape_velocity(round.shape_idx, 0, point.p, velocity_);
    return true;
}

bool Outline::sample(Point2f u, OutlinePoint& point) {
    const double total = cumulative_.back(), target = double(u.x) * total;
    const std::size_t i =
        std::min(std::size_t(std::upper_bound(cumulative_.begin(), cumulative_.end(), target) - cumulative_.begin()),
                 cumulative_.size() - 1);
    const double before = i > 0 ? cumulative_[i - 1] : 0, weight = cumulative_[i] - before;
    if (!(weight > 0)) return false;
    const bool is_round = i >= segments_.size() && i < first_crease_;
    const Arc& arc = arcs_[i];
    // Of the weight one part is by importance along the arc, the rest by angle.
    const double by_importance = total_known_ > 0 ? std::min(known_[i] / total_known_, weight) : 0;
    const double t = target - before < by_importance ? arc.sample(double(u.y)) : double(u.y);
    if (!(is_round           ? place_on_round(i, t, point)
          : i >= first_seam_ ? place_on_seam(i, t, point)
                             : place_on_edge(i, t, point)))
        return false;
    const double uneven = by_importance > 0 ? by_importance * arc.at(t) / arc.mean() : 0;
    point.density *= (uneven + weight - by_importance) / total;
    return length2(point.out) > 0;
}

}  // namespace loom::derive
