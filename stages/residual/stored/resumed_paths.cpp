#include "stages/residual/stored/resumed_paths.h"

#include <array>
#include <bit>
#include <memory>
#include <numeric>

#include "stages/core/scene/embree.h"

namespace loom::residual {
namespace {

bool same_bits(const Vector3f& a, const Vector3f& b) {
    using Bits = std::array<std::uint32_t, 3>;
    return std::bit_cast<Bits>(a) == std::bit_cast<Bits>(b);
}

}  // namespace

ResumedPaths::ResumedPaths(const Scene& new_scene, const EditReach& reach, const PathOptions& options)
    : scene_(new_scene), reach_(reach), options_(options), batch_(new_scene, options) {
    states_.reserve(PathBatch::capacity);
    pairs_.reserve(PathBatch::capacity);
}

void ResumedPaths::add_light(PathPair& pair, const Spectrum& light, std::uint32_t ray) {
    if (ray == is_seen && first_term_ == terms_.size())
        pair.after += light;
    else
        terms_.push_back({&pair, light, ray});
}

void ResumedPaths::ask(PathPair& pair, const ShadowRequest& shadow) {
    add_light(pair, shadow.contribution, std::uint32_t(shadow_rays_.size()));
    shadow_rays_.push_back(shadow.ray);
}

ShadingPoint ResumedPaths::repainted(const ShadingPoint& here, std::uint32_t shape) const {
    const Material* material = &scene_.materials[std::size_t(reach_.repainted[shape])];
    if (material->back >= 0 && dot(here.frame.n, here.wo) < 0)
        material = &scene_.materials[std::size_t(material->back)];
    ShadingPoint there = here;
    there.bsdf = Bsdf<float>(material->model);
    return there;
}

bool ResumedPaths::sample_light_again(const ShadingPoint& here, std::uint32_t shape, float q, int depth,
                                      const PathState& path, ShadowRequest& shadow) const {
    LightQuery lights;
    lights.u = path.sampler.pair(dimension(depth, Dimension::light));
    look_up_light(scene_, lights);
    return sample_next_event<false>(scene_, path, here, shape, q, lights, shadow, 0);
}

void ResumedPaths::add(const StoredPaths& paths, const PathChange& change, std::span<const std::uint32_t> again,
                       PathPair& pair) {
    const PathGraph& g = paths.graph();
    const auto& v = g.vertices;
    const auto& e = g.light_edges;
    const std::size_t first = g.paths.first_vertex[change.path], last = g.paths.first_vertex[change.path + 1];
    const Sampler sampler = paths.sampler(change.path);
    PathState path(sampler);  // in the new scene
    Spectrum beta(1);         // in the old one
    pair.before = rgb(g.paths.Le, change.path);
    // A light that is relit sends the same to wherever it has been seen from.
    const auto new_light = [&](std::size_t emitter, const Spectrum& old_light) {
        return reach_.relit[emitter] ? scene_.emitters[emitter].radiance : old_light;
    };
    pair.after = Spectrum(0);
    if (change.cut > 0) {
        const int seen = paths.seen_emitter(change.path);
        pair.after = seen < 0 ? pair.before : new_light(std::size_t(seen), pair.before);
    }
    first_term_ = terms_.size();

    // The new path is followed as long as it goes along the old one. From vertex `end` on it has nothing of its own.
    bool along = change.cut > 0, resumes = !along, other_weight = false;
    const std::size_t end = change.cut != PathChange::never ? first + change.cut
                            : change.repainted              ? last
                            : again.empty()                 ? first
                                                            : again.back() + 1;
    std::size_t k = change.edge;
    for (std::size_t j = first; j < last; ++j) {
        const auto done = [&] { return (!along || j >= end) && (k == e.vertex.size() || e.vertex[k] >= last); };
        if (done()) break;
        StoredVertex vertex(paths, j);
        const Point3f p = paths.position(j);
        const int depth = int(j - first) + 1;
        const float q = paths.survival(j);
        const bool ask_again = along && !again.empty() && again.front() == j;
        const bool repaint = along && reach_.repainted[v.shape[j]] >= 0;
        // Roulette goes by the throughput of the path.
        const bool other_survival = other_weight && roulette_at(options_, depth) == Roulette::throughput;
        const bool step_again = along && (repaint || other_survival) && depth != options_.max_depth;
        if (ask_again) again = again.subspan(1);
        if (along) ++path.result.n_vertices;

        bool seen = false;
        for (; k < e.vertex.size() && e.vertex[k] == j && e.technique[k] == std::uint8_t(LightTechnique::next_event);
             ++k) {
            const Spectrum f_cos = vertex.f_cos(paths.reader().light_direction(p, k)), Li = rgb(e.Li, k);
            pair.before += light_sample_contribution(beta, f_cos, Li, e.pdf_nee_w[k], e.pdf_bsdf_w[k]);
            if (along && !ask_again && !step_again)
                add_light(pair, light_sample_contribution(path.beta, f_cos, new_light(e.emitter[k], Li), e.pdf_nee_w[k],
                                                          e.pdf_bsdf_w[k]));
            seen = true;
        }
        if (done()) break;
        const BsdfSample<float> s = vertex.redraw(sampler, depth);
        const auto wi = [&] { return j + 1 < last ? paths.arrival(j + 1) : vertex.direction(sampler, depth); };

        if (step_again) {
            const ShadingPoint& here = vertex.whole();
            const ShadingPoint there = repaint ? repainted(here, v.shape[j]) : here;
            if (repaint && depth == 1) pair.first.albedo = albedo(there.bsdf, there.wo_local);
            LightQuery lights;
            lights.u = sampler.pair(dimension(depth, Dimension::light));
            look_up_light(scene_, lights);
            ShadowRequest shadow;
            const Step step = leave<false>(scene_, options_, depth, there, v.shape[j], lights,
                                           sampler.pair(dimension(depth, Dimension::direction)), path, shadow, {});
            if (has(step, Step::needs_shadow_ray)) {
                const auto was_asked = [&] {
                    return !is_black(f_cos_pdf(here, sample_light(scene_, here.p, lights).wi).f_cos);
                };
                if (ask_again)
                    ask(pair, shadow);
                else if (seen)
                    add_light(pair, shadow.contribution);
                else if (!was_asked())
                    ask(pair, shadow);
            }
            const bool goes_on = has(step, Step::goes_on);
            along = goes_on && path.lobe == Lobe(v.lobe[j]) && same_bits(path.ray.d, wi());
            resumes = goes_on && !along;
            other_weight = true;
        } else if (along) {
            ShadowRequest shadow;
            if (ask_again && sample_light_again(vertex.whole(), v.shape[j], q, depth, path, shadow)) ask(pair, shadow);
            pass_vertex(path, p, paths.reader().model(v.material[j]), v.shape[j], s, q, v.pdf_w[j]);
        }
        if (along && std::uint32_t(depth) == change.cut) {
            along = false;
            resumes = true;
            path.ray = spawn_ray(paths.end(j), wi());
        }
        beta = continued(beta, s.weight, q);
        for (; k < e.vertex.size() && e.vertex[k] == j; ++k) {
            const Spectrum Li = rgb(e.Li, k);
            pair.before += light_hit_contribution(beta, Li, e.pdf_bsdf_w[k], e.pdf_nee_w[k]);
            if (along)
                add_light(pair,
                          light_hit_contribution(path.beta, new_light(e.emitter[k], Li), path.pdf_w, e.pdf_nee_w[k]));
        }
    }
    if (!resumes) return;
    if (change.cut == 0) {
        states_.emplace_back(scene_, sampler, paths.id(change.path), sampler.pair(film_pair));
    } else {
        path.result.first = pair.first;
        states_.push_back(path);
    }
    pairs_.push_back(&pair);
    if (states_.size() == PathBatch::capacity) finish();
}

void ResumedPaths::finish() {
    const std::size_t n = shadow_rays_.size();
    pointers_.resize(n);
    for (std::size_t i = 0; i < n; ++i) pointers_[i] = &shadow_rays_[i];
    const auto blocked = std::make_unique_for_overwrite<bool[]>(n);
    scene_.rays->occluded(pointers_.data(), n, blocked.get());
    for (const Term& term : terms_)
        if (term.ray == is_seen || !blocked[term.ray]) term.pair->after += term.light;
    counts.rays += n;
    shadow_rays_.clear();
    terms_.clear();

    under_way_.resize(states_.size());
    std::iota(under_way_.begin(), under_way_.end(), 0);
    for (std::size_t i = 0; i < states_.size(); ++i) {
        states_[i].result.L = pairs_[i]->after;
        counts.vertices -= states_[i].result.n_vertices;
    }
    batch_.resume(states_, under_way_);
    for (std::size_t i = 0; i < states_.size(); ++i) {
        counts.add(states_[i].result);
        pairs_[i]->after = states_[i].result.L;
        pairs_[i]->first = states_[i].result.first;
    }
    states_.clear();
    pairs_.clear();
}

}  // namespace loom::residual
