#include "stages/residual/stored/path_terms.h"

namespace loom::residual {

Spectrum PathTerms::take_edge() {
    const auto& e = paths_.graph().light_edges;
    const std::size_t k = edge_++;
    const Spectrum Li = rgb(e.Li, k);
    if (is_hit(k)) {
        leave();
        return light_hit_contribution(beta_, Li, e.pdf_bsdf_w[k], e.pdf_nee_w[k]);
    }
    const Spectrum f_cos = block_.f_cos(vertices_[vertex_ - first_], vertex_,
                                        paths_.reader().light_direction(paths_.position(vertex_), k));
    return light_sample_contribution(beta_, f_cos, Li, e.pdf_nee_w[k], e.pdf_bsdf_w[k]);
}

void PathTerms::advance() {
    if (vertex_ + 1 < last_) leave();  // no sample leaves the last vertex without a light edge of its own
    left_ = false;
    ++vertex_;
}

void PathTerms::leave() {
    if (left_) return;
    left_ = true;
    const StoredVertex& here = vertices_[vertex_ - first_];
    beta_ = continued(beta_, here.weight, here.q);
}

}  // namespace loom::residual
