#pragma once
// Chains of edits: each edit adds its residual and the residual's variance to the image after the previous edit.

#include <cstdint>

#include "formats/image.h"
#include "stages/residual/residual.h"

namespace loom::residual {

/// Returns the links of an image; an image without a ledger is its own only link.
Ledger ledger_of(const Image& picture);

/// Returns the link of a residual from its ledger, else from its provenance.
LedgerLink link_of_residual(const Image& residual);

/// throws:  InputError when a residual by `method` with `seed` has the random stream of an earlier link
void check_numbers(const Ledger& before, const std::string& method, std::uint64_t seed);

/// Compares a chain with a new path-traced image of its last scene. The variance of its first image is its VarMean.
struct Standing {
    double var_mean = 0, var_mean_of_edits = 0;  // of all links, and of all except the first
    double worth = 0;                            // samples per pixel of a new image with equal noise; 0: unknown
    std::uint64_t base_samples = 0;              // per pixel, of the first image
    std::uint64_t edit_paths = 0;                // per pixel, traced by the last edit: two per pair
    std::uint64_t all_edit_paths = 0;            // per pixel, traced by all edits
    /// Whether a new base image is due: one with half of the first image's samples, or with the last edit's paths,
    /// would have no more noise.
    ///   Half the samples, not all: every edit adds variance, so with all samples the first edit would already require
    ///   a new base. Let each edit cost c of the first image and add d of its variance. With K edits per base the cost
    ///   per image is (1 + c K) / (K + 1), the mean variance 1 + d K / 2. Their product is smallest where d K is about
    ///   sqrt(2 d / c). That is 1 to 2 for a residual as good as half to two new images of its cost (d / c from 1/2 to
    ///   2).
    bool rebase() const { return worth > 0 && (2 * worth < double(base_samples) || worth < double(edit_paths)); }
};
/// needs:   a ledger of two links or more
Standing standing_of(const Ledger& ledger);

/// Reports the standing, and how to start a new chain when it is due.
void say_standing(const Ledger& ledger, const Options& options, app::Report& report);

}  // namespace loom::residual
