#pragma once
// Terms of an image that is a sum: the base image and the residual of each edit since.

#include <filesystem>
#include <string>
#include <vector>

#include "formats/io/provenance.h"

namespace loom {

/// A term of the sum: first the image of the scene before all edits, then the residual of each edit.
struct LedgerLink {
    InputId scene;              // the scene after this link; empty hash: unknown
    std::string what;           // the edit as text; for the first link, the stage that made it
    std::string method;         // estimator of the residual; empty for the first link
    std::uint64_t samples = 0;  // per pixel; for an edit, pairs of paths
    std::uint64_t seed = 0;     // seed of the random stream; for several passes, that of the first
    double var_mean = 0;        // variance that the link adds, mean over pixels and R, G, B   (W m^-2 sr^-1)^2
    double var_sample = 0;      // variance of one path-traced sample of `scene`, same mean; 0: unknown
    bool is_edit() const { return !method.empty(); }
    bool operator==(const LedgerLink&) const = default;
};

/// A sum has all its links, a residual only its own link, other images none.
using Ledger = std::vector<LedgerLink>;

/// `method` of differences of images, whose random streams are those of loom-trace, not of loom-residual.
inline constexpr const char* differences_method = "differences";
/// `method` of residuals of paths that loom-trace had traced in the old scene (random streams of loom-trace).
inline constexpr const char* old_graph_method = "old graph";

/// `method` of an image of the paths of one technique: a component of the residual of an edit.
inline constexpr const char* part_method = "part";

/// Whether two links use the same random streams: their noise is then correlated, and their variances do not add up.
bool share_numbers(const LedgerLink& a, const LedgerLink& b);

/// Returns the variance of the sum of the first `n` links.
/// needs:   links with independent random streams
double accumulated_var_mean(const Ledger& ledger, std::size_t n);

/// Returns the samples per pixel at which a path-traced image of the last scene is as noisy as the sum of the first `n`
/// links.
///   n_worth = var_sample / sum var_mean,  var_sample of the last of these links that stores it
/// out:     infinity where the sum has no variance; 0 where no link stores var_sample, and for a residual alone
double worth_samples(const Ledger& ledger, std::size_t n);

/// Formats a ledger as a text attribute: JSON, a list of objects.
std::string ledger_text(const Ledger& ledger);
/// Parses a ledger attribute.
/// throws:  InputError naming the file and the invalid part of the ledger
Ledger ledger_from_text(const std::string& text, const std::filesystem::path& file);

}  // namespace loom
