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

ResumedPaths::ResumedPaths(const ScenePair& scenes, const EditReach& reach, const PathOptions& options)
    : old_scene_(scenes.old_scene),
      scene_(scenes.new_scene),
      reach_(reach),
      options_(options),
      shares_sky_(reach.sky && scene_.environment_idx >= 0 &&
                  scene_.emitters[std::size_t(scene_.environment_idx)].proposals),
      same_shapes_(reach.old_places.empty() && reach.new_places.empty()),
      batch_(scene_, options) {
    states_.reserve(PathBatch::capacity);
    pairs_.reserve(PathBatch::capacity);
}

void ResumedPaths::add_light(Spectrum& sum, const Spectrum& light, std::uint32_t ray) {
    if (ray == is_seen && first_term_ == terms_.size())
        sum += light;
    else
        terms_.push_back({&sum, light, ray});
}

void ResumedPaths::ask_sky(Spectrum& sum, const Vector3f& d, const AskedSky& asked) {
    LightQuery query;
    query.kind = LightQuery::Kind::environment;
    query.d = d;
    skies_.push_back(query);
    if (asked.of_old) old_skies_.push_back(query);
    asked_skies_.push_back(asked);
    asked_skies_.back().term = terms_.size();
    terms_.push_back({&sum, {}, is_seen});
}

void ResumedPaths::look_up_skies() {
    look_up_lights(scene_, skies_);
    look_up_lights(old_scene_, old_skies_);
    const LightQuery* old = old_skies_.data();
    for (std::size_t i = 0; i < skies_.size(); ++i) {
        const AskedSky& asked = asked_skies_[i];
        terms_[asked.term].light = light_hit_contribution(asked.beta, asked.of_old ? (old++)->Le : skies_[i].Le,
                                                          asked.density, asked.is_sampled ? skies_[i].pdf_w : 0.0f);
    }
    asked_skies_.clear();
    skies_.clear();
    old_skies_.clear();
}

std::uint32_t ResumedPaths::ask(const Ray& ray) {
    shadow_rays_.push_back(ray);
    return std::uint32_t(shadow_rays_.size() - 1);
}

std::uint32_t ResumedPaths::ask_old(const Ray& ray) {
    if (same_shapes_) return ask(ray);
    old_shadow_rays_.push_back(ray);
    return std::uint32_t(old_shadow_rays_.size() - 1) | in_old_scene;
}

ShadingPoint ResumedPaths::repainted(const ShadingPoint& here, std::uint32_t shape) const {
    const Material* material = &scene_.materials[std::size_t(reach_.repainted[shape])];
    if (material->back_idx >= 0 && dot(here.frame.n, here.wo) < 0)
        material = &scene_.materials[std::size_t(material->back_idx)];
    ShadingPoint there = here;
    there.bsdf = Bsdf<float>(material->model);
    return there;
}

/// One stored path, followed vertex by vertex in both scenes.
class ResumedPaths::Walk {
  public:
    Walk(ResumedPaths& owner, StoredBlock& block, const PathChange& change, std::span<const std::uint32_t> again,
         std::span<const LightQuery> lights, PathPair& pair)
        : owner_(owner),
          block_(block),
          paths_(block.paths()),
          g_(paths_.graph()),
          change_(change),
          again_(again),
          lights_(lights),
          pair_(pair),
          first_(g_.paths.first_vertex[change.path]),
          last_(g_.paths.first_vertex[change.path + 1]),
          end_(change.cut != PathChange::never  ? first_ + change.cut
               : change.repainted || change.sky ? last_
               : again.empty()                  ? first_
                                                : again.back() + 1),
          sampler_(paths_.sampler(change.path)),
          vertices_(block.path(change.path, sampler_)),
          path_(sampler_),
          edge_(change.edge),
          known_(owner.shares_sky_ ? nullptr : block.known_light(change.path)),
          along_(change.cut > 0),
          resumes_(!along_) {}

    const Sampler& sampler() const { return sampler_; }
    PathState& path() { return path_; }
    /// Whether the path in the new scene continues on its own.
    bool resumes() const { return resumes_; }

    void follow() {
        add_first_light();
        owner_.first_term_ = owner_.terms_.size();
        for (std::size_t j = first_; j < last_ && !done(j); ++j) {
            Reached here = reach(j);
            const bool light_seen = add_light_samples(here);
            if (here.shares_sky) sample_skies(here);
            if (done(j)) break;
            if (here.step_again)
                step_again(here, light_seen);
            else if (along_)
                step_as_before(here);
            if (along_ && std::uint32_t(here.depth) == change_.cut) {
                along_ = false;
                resumes_ = true;
                path_.ray = spawn_ray(here.vertex.end, direction(here));
            }
            beta_ = continued(beta_, here.vertex.weight, here.vertex.q);
            if (owner_.shares_sky_)
                old_is_straight_ &=
                    goes_straight_on(here.vertex.lobe, paths_.reader().model(g_.vertices.material[j]).kind);
            add_light_hits(here);
        }
        if (known_)
            pair_.before = pair_.stored = *known_;
        else if (!owner_.shares_sky_)
            pair_.before = pair_.stored, block_.set_light(change_.path, pair_.stored);
    }

  private:
    /// Vertex that the walk has reached.
    struct Reached {
        std::size_t j;
        StoredVertex& vertex;
        int depth;
        bool ask_again;             // sample the light again
        bool repaint;               // its BSDF differs in the new scene
        bool step_again;            // step again with its random numbers
        bool by_proposals = false;  // both scenes' densities of the sky are the new scene's proposals
        bool shares_sky = false;    // and its light sample is one of the sky
        LightQuery lights = {};     // looked up, if ask_again
    };

    /// Adds directly visible light.
    void add_first_light() {
        pair_.before = pair_.stored = rgb(g_.paths.Le, change_.path);
        pair_.after = Spectrum(0);
        if (change_.cut == 0) return;
        if (change_.sky && first_ == last_) {
            const bool dark = owner_.options_.max_depth == 0 || hides_sky(owner_.scene_, true);
            if (!dark) pair_.after = environment(owner_.scene_, paths_.camera_ray(change_.path).d);
            return;
        }
        const int seen = paths_.seen_emitter(change_.path);
        pair_.after = seen < 0 ? pair_.before : new_light(std::size_t(seen), pair_.before);
    }

    [[gnu::always_inline]] Reached reach(std::size_t j) {
        const int depth = int(j - first_) + 1;
        const bool ask_again = along_ && !again_.empty() && again_.front() == j;
        const bool repaint = along_ && owner_.reach_.repainted[g_.vertices.shape[j]] >= 0;
        // Roulette depends on the throughput of the path.
        const bool other_survival = other_weight_ && roulette_at(owner_.options_, depth) == Roulette::throughput;
        const bool step_again = along_ && (repaint || other_survival) && depth != owner_.options_.max_depth;
        if (along_) ++path_.result.n_vertices;
        Reached here{j, vertices_[j - first_], depth, ask_again, repaint, step_again};
        if (ask_again) {
            here.lights = lights_.front();
            again_ = again_.subspan(1);
            lights_ = lights_.subspan(1);
        }
        here.by_proposals = along_ && owner_.shares_sky_;
        here.shares_sky =
            here.by_proposals && ask_again && int(here.lights.point.emitter_idx) == owner_.scene_.environment_idx;
        return here;
    }

    /// Whether neither scene contributes from vertex j on.
    bool done(std::size_t j) const {
        const auto& of = g_.light_edges.vertex;
        const bool no_more_light = edge_ >= of.size() || of[edge_] >= last_;
        return along_ ? j >= end_ && no_more_light : known_ || no_more_light;
    }

    /// Returns an emitter's light in the new scene; a relit one sends the same radiance to all points.
    Spectrum new_light(std::size_t emitter, const Spectrum& old_light) const {
        return owner_.reach_.relit[emitter] ? owner_.scene_.emitters[emitter].radiance : old_light;
    }

    /// Adds light of the stored path to what it brings in the old scene.
    void add_stored(const Reached& here, const Spectrum& light, bool of_sky) {
        pair_.stored += light;
        if (owner_.shares_sky_ && !(here.by_proposals && of_sky)) owner_.add_light(pair_.before, light);
    }

    /// Adds the stored light samples of a vertex. Returns whether there are any.
    [[gnu::always_inline]] bool add_light_samples(Reached& here) {
        const auto& e = g_.light_edges;
        const bool adds_new = along_ && !here.ask_again && !here.step_again;
        bool seen = false;
        for (; edge_ < e.vertex.size() && e.vertex[edge_] == here.j &&
               e.technique[edge_] == std::uint8_t(LightTechnique::next_event);
             ++edge_) {
            const std::size_t k = edge_;
            seen = true;
            if (known_ && !adds_new) continue;
            const Spectrum f_cos =
                               block_.f_cos(here.vertex, here.j, paths_.reader().light_direction(here.vertex.end.p, k)),
                           Li = rgb(e.Li, k);
            if (!known_)
                add_stored(here, light_sample_contribution(beta_, f_cos, Li, e.pdf_nee_w[k], e.pdf_bsdf_w[k]),
                           int(e.emitter[k]) == owner_.old_scene_.environment_idx);
            if (adds_new)
                owner_.add_light(pair_.after, light_sample_contribution(path_.beta, f_cos, new_light(e.emitter[k], Li),
                                                                        e.pdf_nee_w[k], e.pdf_bsdf_w[k]));
        }
        return seen;
    }

    /// Evaluates a light sample at a vertex as it was in the old scene.
    /// out:     whether a shadow ray must be traced
    bool ask_light(Reached& here, const Spectrum& beta, const LightSample& light, tracing::ShadowRequest& shadow) {
        float pdf_bsdf = 0;
        return here.vertex.diffuse
                   ? tracing::ask_light(beta, DiffusePoint(here.vertex), here.vertex.q, light, shadow, pdf_bsdf)
                   : tracing::ask_light(beta, block_.whole(here.vertex, here.j), here.vertex.q, light, shadow,
                                        pdf_bsdf);
    }

    /// Adds the new scene's sample of the old sky.
    void sample_skies(Reached& here) {
        LightQuery old_sky = here.lights;
        old_sky.point.Li = environment(owner_.old_scene_, Vector3f(old_sky.point.y));
        tracing::ShadowRequest shadow;
        if (ask_light(here, beta_, sample_light(owner_.scene_, here.vertex.end.p, old_sky), shadow))
            owner_.add_light(pair_.before, shadow.contribution, owner_.ask_old(shadow.ray));
    }

    /// Adds the light that the ray from a vertex has hit.
    [[gnu::always_inline]] void add_light_hits(Reached& here) {
        const auto& e = g_.light_edges;
        const bool escapes =
            owner_.reach_.sky && here.j + 1 == last_ && ending_of(g_.vertices.flags[here.j]) == Ending::escaped;
        const bool other_sky = escapes && along_;
        if (escapes && (along_ || here.by_proposals)) add_skies(here, escape_direction(here));
        for (; edge_ < e.vertex.size() && e.vertex[edge_] == here.j; ++edge_) {
            const std::size_t k = edge_;
            const Spectrum Li = rgb(e.Li, k);
            if (!known_) add_stored(here, light_hit_contribution(beta_, Li, e.pdf_bsdf_w[k], e.pdf_nee_w[k]), escapes);
            if (along_ && !other_sky)
                owner_.add_light(pair_.after, light_hit_contribution(path_.beta, new_light(e.emitter[k], Li),
                                                                     path_.density, e.pdf_nee_w[k]));
        }
    }

    /// Returns the direction in which the path leaves the scene.
    Vector3f escape_direction(Reached& here) {
        const auto& e = g_.light_edges;
        if (edge_ == e.vertex.size() || e.vertex[edge_] != here.j) return direction(here);
        return {e.y[4 * edge_], e.y[4 * edge_ + 1], e.y[4 * edge_ + 2]};
    }

    /// Adds the sky's light along a ray that leaves the scene: of the new one, and of the old one where both have the new
    /// one's densities.
    void add_skies(Reached& here, const Vector3f& d) {
        const bool is_sampled = !is_delta(here.vertex.lobe);
        if (along_ && !hides_sky(owner_.scene_, path_.is_straight))
            owner_.ask_sky(pair_.after, d, {0, path_.beta, path_.density, is_sampled, false});
        if (here.by_proposals && !hides_sky(owner_.old_scene_, old_is_straight_))
            owner_.ask_sky(pair_.before, d, {0, beta_, g_.vertices.pdf_w[here.j], is_sampled, true});
    }

    /// Returns the direction in which the old path leaves a vertex.
    Vector3f direction(Reached& here) {
        if (here.j + 1 < last_) return paths_.arrival(here.j + 1);
        return block_.direction(here.vertex, here.j, sampler_, here.depth);
    }

    /// Continues in the new scene with the same random numbers.
    /// in:      light_seen  whether the old path's light sample was visible
    void step_again(Reached& here, bool light_seen) {
        // Sample a light and the next direction.
        const SurfaceIdx surface = surface_of(here.j);
        const ShadingPoint& before = block_.whole(here.vertex, here.j);
        const ShadingPoint now = here.repaint ? owner_.repainted(before, surface.shape) : before;
        if (here.repaint && here.depth == 1) pair_.first.albedo = albedo(now.bsdf, now.wo_local);
        LightQuery& lights = here.lights;
        if (!here.ask_again) {
            lights.u = StoredBlock::u_light(here.vertex, sampler_, here.depth);
            look_up_light(owner_.scene_, lights);
        }
        tracing::ShadowRequest shadow;
        const tracing::Step step =
            tracing::leave<false>(owner_.scene_, owner_.options_, here.depth, now, surface, lights,
                                  sampler_.pair(dimension(here.depth, Dimension::direction)), path_, shadow, {});

        // Test visibility, where the old path did not.
        if (tracing::has(step, tracing::Step::needs_shadow_ray)) {
            const auto was_asked = [&] {
                return !is_black(f_cos_pdf(before, sample_light(owner_.scene_, before.p, lights).wi).f_cos);
            };
            if (here.ask_again || (!light_seen && !was_asked()))
                owner_.add_light(pair_.after, shadow.contribution, owner_.ask(shadow.ray));
            else if (light_seen)
                owner_.add_light(pair_.after, shadow.contribution);
        }

        // Follow the old path as long as the directions are equal.
        const bool goes_on = tracing::has(step, tracing::Step::goes_on);
        along_ = goes_on && path_.lobe == Lobe(g_.vertices.lobe[here.j]) && same_bits(path_.ray.d, direction(here));
        resumes_ = goes_on && !along_;
        other_weight_ = true;
    }

    SurfaceIdx surface_of(std::size_t j) const { return {g_.vertices.shape[j], g_.vertices.material[j]}; }

    [[gnu::always_inline]] void step_as_before(Reached& here) {
        const auto& v = g_.vertices;
        tracing::ShadowRequest shadow;
        if (here.ask_again &&
            ask_light(here, path_.beta, sample_light(owner_.scene_, here.vertex.end.p, here.lights), shadow))
            owner_.add_light(pair_.after, shadow.contribution, owner_.ask(shadow.ray));
        pass_vertex(path_, here.vertex.end.p, paths_.reader().model(v.material[here.j]), surface_of(here.j),
                    block_.sample(here.vertex), here.vertex.q, v.pdf_w[here.j]);
    }

    ResumedPaths& owner_;
    StoredBlock& block_;
    const StoredPaths& paths_;
    const PathGraph& g_;
    const PathChange& change_;
    std::span<const std::uint32_t> again_;  // vertices ahead
    std::span<const LightQuery> lights_;    // theirs, looked up
    PathPair& pair_;
    std::size_t first_, last_;  // vertices
    std::size_t end_;           // from this vertex on the path in the new scene has no changes of its own
    Sampler sampler_;
    std::span<StoredVertex> vertices_;
    PathState path_;         // state in the new scene
    Spectrum beta_{1};       // throughput in the old scene
    std::size_t edge_;       // next light edge of the graph
    const Spectrum* known_;  // what the path brings in the old scene; null: not yet known
    bool along_;             // the new path follows the old one
    bool resumes_;           // the new path continues on its own
    bool other_weight_ = false;
    bool old_is_straight_ = true;  // the old path has not been scattered; kept up where skies share samples
};

void ResumedPaths::add(StoredBlock& block, const PathChanges& changes, std::span<PathPair> pairs) {
    // All look-ups together, since tables of a sky are larger than caches.
    lights_.clear();
    const std::uint32_t* row = changes.again.data();
    for (const PathChange& change : changes.paths) {
        if (change.n_again == 0) continue;
        const Sampler sampler = block.paths().sampler(change.path);
        const std::span<StoredVertex> vertices = block.path(change.path, sampler);
        const std::size_t first = block.paths().graph().paths.first_vertex[change.path];
        for (std::uint32_t k = 0; k < change.n_again; ++k) {
            const std::size_t place = *row++ - first;
            lights_.emplace_back().u = StoredBlock::u_light(vertices[place], sampler, int(place) + 1);
        }
    }
    look_up_lights(scene_, lights_);

    std::span<const std::uint32_t> again(changes.again);
    std::span<const LightQuery> lights(lights_);
    for (std::size_t i = 0; i < changes.paths.size(); ++i) {
        const std::size_t n = changes.paths[i].n_again;
        follow(block, changes.paths[i], again.first(n), lights.first(n), pairs[i]);
        again = again.subspan(n);
        lights = lights.subspan(n);
    }
}

void ResumedPaths::add_untouched(StoredBlock& block, std::size_t path, PathPair& pair) {
    const PathGraph& graph = block.paths().graph();
    PathChange none;
    none.path = path;
    none.edge = first_row(graph.light_edges.vertex, graph.paths.first_vertex[path]);
    follow(block, none, {}, {}, pair);
}

void ResumedPaths::follow(StoredBlock& block, const PathChange& change, std::span<const std::uint32_t> again,
                          std::span<const LightQuery> lights, PathPair& pair) {
    Walk walk(*this, block, change, again, lights, pair);
    walk.follow();
    if (!walk.resumes()) return;

    // Pass the rest of the path to the batch.
    if (change.cut == 0) {
        states_.emplace_back(scene_, walk.sampler(), block.paths().id(change.path), walk.sampler().pair(film_pair));
    } else {
        walk.path().result.first = pair.first;
        states_.push_back(walk.path());
    }
    pairs_.push_back(&pair);
    if (states_.size() == PathBatch::capacity) finish();
}

/// Traces shadow rays and removes them.
/// out:     [ray] whether it is occluded
std::unique_ptr<bool[]> ResumedPaths::trace(const Scene& scene, std::vector<Ray>& rays) {
    const std::size_t n = rays.size();
    auto blocked = std::make_unique_for_overwrite<bool[]>(n);
    if (n == 0) return blocked;
    pointers_.resize(n);
    for (std::size_t i = 0; i < n; ++i) pointers_[i] = &rays[i];
    scene.rays->occluded(pointers_.data(), n, blocked.get());
    counts.rays += n;
    rays.clear();
    return blocked;
}

void ResumedPaths::finish() {
    look_up_skies();
    const auto blocked = trace(scene_, shadow_rays_), blocked_before = trace(old_scene_, old_shadow_rays_);
    for (const Term& term : terms_) {
        const bool is_dark = term.ray != is_seen &&
                             (term.ray & in_old_scene ? blocked_before[term.ray & ~in_old_scene] : blocked[term.ray]);
        if (!is_dark) *term.sum += term.light;
    }
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
