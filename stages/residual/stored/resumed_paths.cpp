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

void ResumedPaths::ask(PathPair& pair, const tracing::ShadowRequest& shadow) {
    add_light(pair, shadow.contribution, std::uint32_t(shadow_rays_.size()));
    shadow_rays_.push_back(shadow.ray);
}

ShadingPoint ResumedPaths::repainted(const ShadingPoint& here, std::uint32_t shape) const {
    const Material* material = &scene_.materials[std::size_t(reach_.repainted[shape])];
    if (material->back_idx >= 0 && dot(here.frame.n, here.wo) < 0)
        material = &scene_.materials[std::size_t(material->back_idx)];
    ShadingPoint there = here;
    there.bsdf = Bsdf<float>(material->model);
    return there;
}

bool ResumedPaths::sample_light_again(const ShadingPoint& here, SurfaceIdx surface, float q, int depth,
                                      const PathState& path, tracing::ShadowRequest& shadow) const {
    LightQuery lights;
    lights.u = path.sampler.pair(dimension(depth, Dimension::light));
    look_up_light(scene_, lights);
    return tracing::sample_next_event<false>(scene_, path, here, surface, q, lights, shadow, 0);
}

/// One stored path, followed vertex by vertex in both scenes.
class ResumedPaths::Walk {
  public:
    Walk(ResumedPaths& owner, const StoredPaths& paths, const PathChange& change, std::span<const std::uint32_t> again,
         PathPair& pair)
        : owner_(owner),
          paths_(paths),
          g_(paths.graph()),
          change_(change),
          again_(again),
          pair_(pair),
          first_(g_.paths.first_vertex[change.path]),
          last_(g_.paths.first_vertex[change.path + 1]),
          end_(change.cut != PathChange::never ? first_ + change.cut
               : change.repainted              ? last_
               : again.empty()                 ? first_
                                               : again.back() + 1),
          sampler_(paths.sampler(change.path)),
          path_(sampler_),
          edge_(change.edge),
          along_(change.cut > 0),
          resumes_(!along_) {}

    const Sampler& sampler() const { return sampler_; }
    PathState& path() { return path_; }
    /// Whether the path in the new scene continues on its own.
    bool resumes() const { return resumes_; }

    /// Adds directly visible light.
    void add_first_light() {
        pair_.before = rgb(g_.paths.Le, change_.path);
        pair_.after = Spectrum(0);
        if (change_.cut == 0) return;
        const int seen = paths_.seen_emitter(change_.path);
        pair_.after = seen < 0 ? pair_.before : new_light(std::size_t(seen), pair_.before);
    }

    void follow() {
        for (std::size_t j = first_; j < last_ && !done(j); ++j) {
            Reached here = reach(j);
            const bool light_seen = add_light_samples(here);
            if (done(j)) return;
            const BsdfSample<float> s = here.vertex.redraw(sampler_, here.depth);
            if (here.step_again)
                step_again(here, light_seen);
            else if (along_)
                step_as_before(here, s);
            if (along_ && std::uint32_t(here.depth) == change_.cut) {
                along_ = false;
                resumes_ = true;
                path_.ray = spawn_ray(paths_.end(j), direction(here));
            }
            beta_ = continued(beta_, s.weight, here.q);
            add_light_hits(j);
        }
    }

  private:
    /// Vertex that the walk has reached.
    struct Reached {
        std::size_t j;
        StoredVertex vertex;
        Point3f p;
        int depth;
        float q;          // survival probability in the old scene
        bool ask_again;   // sample the light again
        bool repaint;     // its BSDF differs in the new scene
        bool step_again;  // step again with its random numbers
    };

    [[gnu::always_inline]] Reached reach(std::size_t j) {
        const int depth = int(j - first_) + 1;
        const bool ask_again = along_ && !again_.empty() && again_.front() == j;
        const bool repaint = along_ && owner_.reach_.repainted[g_.vertices.shape[j]] >= 0;
        // Roulette depends on the throughput of the path.
        const bool other_survival = other_weight_ && roulette_at(owner_.options_, depth) == Roulette::throughput;
        const bool step_again = along_ && (repaint || other_survival) && depth != owner_.options_.max_depth;
        if (ask_again) again_ = again_.subspan(1);
        if (along_) ++path_.result.n_vertices;
        return {j,         StoredVertex(paths_, j), paths_.position(j), depth, paths_.survival(j), ask_again, repaint,
                step_again};
    }

    /// Whether neither scene contributes from vertex j on.
    bool done(std::size_t j) const {
        const auto& of = g_.light_edges.vertex;
        return (!along_ || j >= end_) && (edge_ == of.size() || of[edge_] >= last_);
    }

    /// Returns an emitter's light in the new scene; a relit one sends the same radiance to all points.
    Spectrum new_light(std::size_t emitter, const Spectrum& old_light) const {
        return owner_.reach_.relit[emitter] ? owner_.scene_.emitters[emitter].radiance : old_light;
    }

    /// Adds the stored light samples of a vertex. Returns whether there are any.
    [[gnu::always_inline]] bool add_light_samples(Reached& here) {
        const auto& e = g_.light_edges;
        bool seen = false;
        for (; edge_ < e.vertex.size() && e.vertex[edge_] == here.j &&
               e.technique[edge_] == std::uint8_t(LightTechnique::next_event);
             ++edge_) {
            const std::size_t k = edge_;
            const Spectrum f_cos = here.vertex.f_cos(paths_.reader().light_direction(here.p, k)), Li = rgb(e.Li, k);
            pair_.before += light_sample_contribution(beta_, f_cos, Li, e.pdf_nee_w[k], e.pdf_bsdf_w[k]);
            if (along_ && !here.ask_again && !here.step_again)
                owner_.add_light(pair_, light_sample_contribution(path_.beta, f_cos, new_light(e.emitter[k], Li),
                                                                  e.pdf_nee_w[k], e.pdf_bsdf_w[k]));
            seen = true;
        }
        return seen;
    }

    /// Adds the light that the ray from vertex j has hit.
    [[gnu::always_inline]] void add_light_hits(std::size_t j) {
        const auto& e = g_.light_edges;
        for (; edge_ < e.vertex.size() && e.vertex[edge_] == j; ++edge_) {
            const std::size_t k = edge_;
            const Spectrum Li = rgb(e.Li, k);
            pair_.before += light_hit_contribution(beta_, Li, e.pdf_bsdf_w[k], e.pdf_nee_w[k]);
            if (along_)
                owner_.add_light(pair_, light_hit_contribution(path_.beta, new_light(e.emitter[k], Li), path_.density,
                                                               e.pdf_nee_w[k]));
        }
    }

    /// Returns the direction in which the old path leaves a vertex.
    Vector3f direction(Reached& here) const {
        return here.j + 1 < last_ ? paths_.arrival(here.j + 1) : here.vertex.direction(sampler_, here.depth);
    }

    /// Continues in the new scene with the same random numbers.
    /// in:      light_seen  whether the old path's light sample was visible
    void step_again(Reached& here, bool light_seen) {
        // Sample a light and the next direction.
        const SurfaceIdx surface = surface_of(here.j);
        const ShadingPoint& before = here.vertex.whole();
        const ShadingPoint now = here.repaint ? owner_.repainted(before, surface.shape) : before;
        if (here.repaint && here.depth == 1) pair_.first.albedo = albedo(now.bsdf, now.wo_local);
        LightQuery lights;
        lights.u = sampler_.pair(dimension(here.depth, Dimension::light));
        look_up_light(owner_.scene_, lights);
        tracing::ShadowRequest shadow;
        const tracing::Step step =
            tracing::leave<false>(owner_.scene_, owner_.options_, here.depth, now, surface, lights,
                                  sampler_.pair(dimension(here.depth, Dimension::direction)), path_, shadow, {});

        // Test visibility, where the old path did not.
        if (tracing::has(step, tracing::Step::needs_shadow_ray)) {
            const auto was_asked = [&] {
                return !is_black(f_cos_pdf(before, sample_light(owner_.scene_, before.p, lights).wi).f_cos);
            };
            if (here.ask_again)
                owner_.ask(pair_, shadow);
            else if (light_seen)
                owner_.add_light(pair_, shadow.contribution);
            else if (!was_asked())
                owner_.ask(pair_, shadow);
        }

        // Follow the old path as long as the directions are equal.
        const bool goes_on = tracing::has(step, tracing::Step::goes_on);
        along_ = goes_on && path_.lobe == Lobe(g_.vertices.lobe[here.j]) && same_bits(path_.ray.d, direction(here));
        resumes_ = goes_on && !along_;
        other_weight_ = true;
    }

    SurfaceIdx surface_of(std::size_t j) const { return {g_.vertices.shape[j], g_.vertices.material[j]}; }

    /// in:  s  sample of the BSDF, the same in both scenes
    [[gnu::always_inline]] void step_as_before(Reached& here, const BsdfSample<float>& s) {
        const auto& v = g_.vertices;
        tracing::ShadowRequest shadow;
        if (here.ask_again &&
            owner_.sample_light_again(here.vertex.whole(), surface_of(here.j), here.q, here.depth, path_, shadow))
            owner_.ask(pair_, shadow);
        pass_vertex(path_, here.p, paths_.reader().model(v.material[here.j]), surface_of(here.j), s, here.q,
                    v.pdf_w[here.j]);
    }

    ResumedPaths& owner_;
    const StoredPaths& paths_;
    const PathGraph& g_;
    const PathChange& change_;
    std::span<const std::uint32_t> again_;  // vertices ahead
    PathPair& pair_;
    std::size_t first_, last_;  // vertices
    std::size_t end_;           // from this vertex on the path in the new scene has no changes of its own
    Sampler sampler_;
    PathState path_;    // state in the new scene
    Spectrum beta_{1};  // throughput in the old scene
    std::size_t edge_;  // next light edge of the graph
    bool along_;        // the new path follows the old one
    bool resumes_;      // the new path continues on its own
    bool other_weight_ = false;
};

void ResumedPaths::add(const StoredPaths& paths, const PathChange& change, std::span<const std::uint32_t> again,
                       PathPair& pair) {
    Walk walk(*this, paths, change, again, pair);
    walk.add_first_light();
    first_term_ = terms_.size();
    walk.follow();
    if (!walk.resumes()) return;

    // Pass the rest of the path to the batch.
    if (change.cut == 0) {
        states_.emplace_back(scene_, walk.sampler(), paths.id(change.path), walk.sampler().pair(film_pair));
    } else {
        walk.path().result.first = pair.first;
        states_.push_back(walk.path());
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
