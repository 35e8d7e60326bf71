#pragma once
// Step of many paths at diffuse surfaces, as a structure of arrays (SoA): the formulas of arrive() with identical
// results, in loops that the compiler vectorises. Values that need a look-up (triangle, texture, light) are gathered
// into columns before, path by path.

#include <cstddef>
#include <cstdint>

#include "stages/core/math/vector.h"
#include "stages/core/tracing/path_tracer.h"

namespace loom {

/// Columns of one block of paths; small enough for the L1 cache.
struct DiffuseColumns {
    static constexpr std::size_t capacity = 128;

    struct alignas(64) Numbers {
        float values[capacity];
        float& operator[](std::size_t i) { return values[i]; }
        float operator[](std::size_t i) const { return values[i]; }
    };
    /// Points, vectors, normals or colours.
    struct Triples {
        Numbers x, y, z;
        template <class K>
        void set(std::size_t i, const Triple<float, K>& v) {
            x[i] = v.x, y[i] = v.y, z[i] = v.z;
        }
        void set(std::size_t i, const Spectrum& v) { x[i] = v.r, y[i] = v.g, z[i] = v.b; }
        template <class V>
        V get(std::size_t i) const {
            return {x[i], y[i], z[i]};
        }
    };

    // in: the surface, the arriving path, samples
    Triples p, ng, n;  // n: interpolated, not of unit length
    Numbers hit_error;
    Numbers side;  // sign of n: 1 or -1; 0: shade with ng
    Triples reflectance;
    Numbers two_sided;  // 1 or 0
    Triples wo, beta;
    Numbers eta_scale;
    Numbers u_direction_x, u_direction_y, u_roulette;
    // in: the light point; zero: none
    Triples light_y, light_n, light_Li;
    Numbers light_hit_error;
    Numbers light_area, light_pdf_w, light_pmf, light_at_infinity;

    // out: the vertex
    Triples ns, albedo;
    Triples wo_local;  // mirrored to the front
    Numbers turn;      // -1 where the surface is mirrored to its front, else 1
    Numbers q;         // survival probability of roulette
    // out: the shadow ray and its contribution; no ray where its pdf or its BSDF value is 0
    Triples light_wi;
    Triples shadow_o, shadow_d, contribution;
    Numbers shadow_t_max, shadow_pdf_w, shadow_pdf_bsdf_w, shadow_f;
    // out: the next ray, with roulette in its density; none where the sum of its weight is 0 or NaN
    Triples next_o, next_d, next_beta;
    Numbers next_pdf_w, next_weight;

    bool needs_shadow_ray(std::size_t i) const { return shadow_pdf_w[i] > 0 && shadow_f[i] != 0; }
    bool roulette_ends(std::size_t i) const { return q[i] < 1 && u_roulette[i] >= q[i]; }
    bool has_next(std::size_t i) const { return next_weight[i] > 0; }
};

/// Fills the columns marked `out`, for the first n paths; bit-identical on every x86-64 level.
/// in:      roulette  how paths end at this depth; off before rr_depth
void shade_diffuse(DiffuseColumns& columns, std::size_t n, Roulette roulette);

}  // namespace loom
