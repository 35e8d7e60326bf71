#include "stages/derive/wanted_parts.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <map>
#include <string_view>

#include "formats/io/error.h"
#include "stages/core/scene/nlos.h"

namespace loom::derive {
namespace {

constexpr std::string_view vertices_part = "/vertices", texels_part = "/reflectance/texels";

bool names_part(const std::string& name) {
    return (name.starts_with("shape:") && name.ends_with(vertices_part)) ||
           (name.starts_with("bsdf:") && name.ends_with(texels_part));
}

}  // namespace

std::vector<std::string> without_parts(const std::vector<std::string>& names) {
    std::vector<std::string> rest;
    std::copy_if(names.begin(), names.end(), std::back_inserter(rest),
                 [](const std::string& name) { return !names_part(name); });
    return rest;
}

WantedParts find_parts(const Scene& scene, const std::vector<std::string>& names, SceneTangents& tangents) {
    WantedParts wanted;
    wanted.mesh_of.assign(scene.shapes.size(), -1);
    wanted.image_of.assign(scene.materials.size(), -1);
    for (const std::string& name : names) {
        if (!names_part(name)) continue;
        const auto refuse = [&](const std::string& why) { throw InputError(fmt::format("--wrt {}: {}", name, why)); };
        const auto id_of = [&](std::string_view part) {
            const std::size_t begin = name.find(':') + 1;
            return name.substr(begin, name.size() - part.size() - begin);
        };
        const auto index = [&](const auto& things, const std::string& id, const char* what) {
            for (std::size_t i = 0; i < things.size(); ++i)
                if (things[i].id == id) return i;
            refuse(fmt::format("the scene has no {} '{}'", what, id));
            return std::size_t(0);
        };
        if (name.starts_with("shape:")) {
            const std::size_t s = index(scene.shapes, id_of(vertices_part), "shape");
            const Shape& shape = scene.shapes[s];
            if (shape.kind != ShapeKind::mesh) refuse("a sphere or disk has no vertices");
            if (shape.emitter_idx >= 0) refuse("vertices of an emitter cannot move alone");
            if (scene.nlos && scene.nlos->relay_wall == s) refuse("the relay wall of an NLOS capture cannot move");
            if (wanted.mesh_of[s] >= 0) continue;
            WantedParts::Mesh mesh{name, std::uint32_t(s), wanted.n_vertices, {}};
            std::map<std::array<float, 3>, std::uint32_t> first;
            for (std::uint32_t i = 0; i < shape.mesh.positions.size(); ++i) {
                const Point3f& p = shape.mesh.positions[i];
                mesh.same.push_back(first.try_emplace({p.x, p.y, p.z}, i).first->second);
            }
            wanted.mesh_of[s] = int(wanted.meshes.size());
            wanted.n_vertices += mesh.same.size();
            wanted.meshes.push_back(std::move(mesh));
            tangents.vertices[s].resize(shape.mesh.positions.size());
        } else {
            const std::size_t m = index(scene.materials, id_of(texels_part), "BSDF");
            const Material& material = scene.materials[m];
            const Texture* texture =
                material.diffuse_idx < 0 ? nullptr : &scene.textures[std::size_t(material.diffuse_idx)];
            if (!texture || texture->kind != TextureKind::bitmap) refuse("its reflectance is no image");
            if (wanted.image_of[m] >= 0) continue;
            const TextureImage& image = *texture->image;
            wanted.image_of[m] = int(wanted.images.size());
            wanted.images.push_back(
                {name, std::uint32_t(m), wanted.n_texels, std::uint32_t(image.width), std::uint32_t(image.height)});
            if (const int back = material.back_idx;
                back >= 0 && scene.materials[std::size_t(back)].diffuse_idx == material.diffuse_idx)
                wanted.image_of[std::size_t(back)] = wanted.image_of[m];
            wanted.n_texels += std::uint64_t(image.width) * std::uint64_t(image.height);
        }
    }
    return wanted;
}

}  // namespace loom::derive
