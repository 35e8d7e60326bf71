#pragma once
// Edits after edits: each adds its difference to the picture that the one before has left, and its variance too.

#include <cstdint>

#include "formats/image.h"
#include "stages/residual/residual.h"

namespace loom::residual {

/// The links of a picture, also of one that nothing was added to: it is its only link.
Ledger ledger_of(const Image& picture);

/// The link of a residual, which says it itself; else what its provenance says.
LedgerLink link_of_residual(const Image& residual);

/// throws:  InputError when a residual by `method` with `seed` has the random numbers of a link before it
void check_numbers(const Ledger& before, const std::string& method, std::uint64_t seed);

/// How a chain compares with its last scene path-traced afresh. Its first picture counts with what its VarMean says.
struct Standing {
    double var_mean = 0, var_mean_of_edits = 0;  // of all links, and of all but the first
    double worth = 0;                            // samples per pixel of a fresh picture that is as noisy; 0: not known
    std::uint64_t base_samples = 0;              // per pixel, of the first picture
    std::uint64_t edit_paths = 0;                // per pixel, that the last edit traced: two a pair
    std::uint64_t all_edit_paths = 0;            // and all edits
    /// A fresh picture of half of the first picture's samples would do as well, or one of the last edit's paths.
    ///   Never of all its samples: every edit adds variance, so that the first would call for a re-base already. With
    ///   edits that each cost c of the first picture and add d of its variance, K edits a re-base cost (1 + c K) / (K +
    ///   1) a picture, of a mean variance of 1 + d K / 2. Their product is smallest where d K is about sqrt(2 d / c),
    ///   which is 1 to 2 for a residual as good as half to two fresh pictures of its cost (d / c from 1/2 to 2).
    bool rebase() const { return worth > 0 && (2 * worth < double(base_samples) || worth < double(edit_paths)); }
};
/// needs:   a ledger of two links or more
Standing standing_of(const Ledger& ledger);

/// Says it, and how to begin another chain when it is time.
void say_standing(const Ledger& ledger, const Options& options, app::Report& report);

}  // namespace loom::residual
