#pragma once
// What a picture is the sum of: the one that it began with, and the difference that each edit since has made.

#include <filesystem>
#include <string>
#include <vector>

#include "formats/io/provenance.h"

namespace loom {

/// A term of the sum: first the picture of the scene before all edits, then the residual of each edit.
struct LedgerLink {
    InputId scene;              // that the sum shows from this link on; no hash: not known
    std::string what;           // the edit in words; of the first, the stage that made it
    std::string method;         // of the residual; empty for the first
    std::uint64_t samples = 0;  // per pixel; pairs of paths for an edit
    std::uint64_t seed = 0;     // of its random numbers; of several passes, that of the first
    double var_mean = 0;        // that it adds, mean over pixels and R, G, B             (W m^-2 sr^-1)^2
    double var_sample = 0;      // of one path-traced sample of `scene`, the same mean; 0: not known
    bool is_edit() const { return !method.empty(); }
    bool operator==(const LedgerLink&) const = default;
};

/// Of a sum: all its links. Of a residual: its own alone. Of other pictures: none.
using Ledger = std::vector<LedgerLink>;

/// `method` of differences of pictures, whose random numbers are those of loom-trace and not of loom-residual.
inline constexpr const char* differences_method = "differences";
/// The same of residuals of paths that loom-trace had traced in the old scene.
inline constexpr const char* old_graph_method = "old graph";

/// `method` of a picture of the paths of one technique: a part of the difference that an edit makes.
inline constexpr const char* part_method = "part";

/// Whether two links were made from the same random numbers: their noise is then one, and their variances do not add
/// up.
bool share_numbers(const LedgerLink& a, const LedgerLink& b);

/// Variance of the sum of the first `n` links, which have nothing random in common.
double accumulated_var_mean(const Ledger& ledger, std::size_t n);

/// Samples per pixel at which a path-traced picture of the last scene is as noisy as the sum of the first `n` links.
///   n_worth = var_sample / sum var_mean,  var_sample of the last of them that knows its own
/// out:     infinity where the sum has no variance; 0 where no link knows var_sample, and of a residual alone
double worth_samples(const Ledger& ledger, std::size_t n);

/// The form that it takes as a text attribute: JSON, a list of objects.
std::string ledger_text(const Ledger& ledger);
/// throws:  InputError naming the file and what of the ledger is wrong
Ledger ledger_from_text(const std::string& text, const std::filesystem::path& file);

}  // namespace loom
