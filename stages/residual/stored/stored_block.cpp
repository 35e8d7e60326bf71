#include "stages/residual/stored/stored_block.h"

namespace loom::residual {

void StoredBlock::start(const StoredPaths& paths, std::size_t begin, std::size_t end) {
    const auto& first = paths.graph().paths.first_vertex;
    paths_ = &paths;
    begin_ = begin;
    first_vertex_ = first[begin];
    if (const std::size_t n = first[end] - first_vertex_; vertices_.size() < n) vertices_.resize(n);
    known_.assign(end - begin, 0);
    has_light_.assign(end - begin, 0);
    light_.resize(end - begin);
    wholes_.clear();
}

void StoredBlock::read(std::size_t path, const Sampler& sampler) {
    const auto& first = paths_->graph().paths.first_vertex;
    for (std::size_t j = first[path]; j < first[path + 1]; ++j)
        read(j, sampler, int(j - first[path]) + 1, vertices_[j - first_vertex_]);
    known_[path - begin_] = 1;
}

void StoredBlock::read(std::size_t j, const Sampler& sampler, int depth, StoredVertex& vertex) {
    const PathGraph& g = paths_->graph();
    const std::size_t material = g.vertices.material[j];
    const BsdfModel& model = paths_->reader().model(material);
    const std::uint8_t textured = g.materials.textured[material];
    vertex = {};
    vertex.end = paths_->end(j);
    vertex.q = paths_->survival(j);
    vertex.diffuse = model.kind == BsdfKind::diffuse && model.opacity == 1 &&
                     !(textured & textured_parameter::opacity) && g.vertices.n_side.empty();
    const Point2f u = sampler.pair(dimension(depth, Dimension::direction));
    if (!vertex.diffuse) {
        Whole& whole = read_whole(vertex, j);
        whole.sample = draw(whole.point, sampler, depth, u);
        vertex.weight = whole.sample.weight, vertex.lobe = whole.sample.lobe;
        return;
    }
    vertex.reflectance = textured & textured_parameter::diffuse ? paths_->reader().bsdf(j).diffuse : model.diffuse;
    vertex.n = shading_normal(g, j);
    vertex.cos_o = dot(-paths_->arrival(j), vertex.n);
    if (model.two_sided && vertex.cos_o < 0) vertex.n = -vertex.n, vertex.cos_o = -vertex.cos_o;
    const BsdfValue<float> value =
        DiffuseFamily::f_cos_pdf(vertex.reflectance, vertex.cos_o, sample_cosine_hemisphere(u).z);
    if (value.pdf_w > 0) vertex.weight = value.f_cos / value.pdf_w, vertex.lobe = Lobe::diffuse;
}

}  // namespace loom::residual
