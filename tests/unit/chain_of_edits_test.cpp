// The rules of a chain of edits that need no rendering: seeds, links, and when a new base is due.

#include "stages/residual/chain_of_edits.h"

#include <gtest/gtest.h>

#include <set>

#include "formats/io/error.h"
#include "stages/core/sampling/streams.h"

namespace loom::residual {
namespace {

LedgerLink link(const char* method, std::uint64_t samples, std::uint64_t seed, double var_mean, double var_sample) {
    LedgerLink one;
    one.method = method;
    one.samples = samples;
    one.seed = seed;
    one.var_mean = var_mean;
    one.var_sample = var_sample;
    return one;
}

TEST(ChainOfEdits, EveryEditHasItsOwnSeed) {
    EXPECT_EQ(streams::edit(7, 1), 7u);
    std::set<std::uint64_t> seeds;
    for (const std::uint64_t seed : {0, 1, 2, 7})
        for (std::size_t k = 1; k <= 1000; ++k) seeds.insert(streams::edit(seed, k));
    EXPECT_EQ(seeds.size(), 4000u);
}

TEST(ChainOfEdits, TheSameRandomNumbersTwiceAreRefused) {
    const Ledger ledger = {link("", 64, 3, 1, 64), link("correlated", 8, 4, 0.1, 64),
                           link(differences_method, 8, 5, 0.1, 0)};
    EXPECT_NO_THROW(check_numbers({}, "correlated", 3));
    EXPECT_NO_THROW(check_numbers(ledger, "correlated", 3));  // loom-trace has other random streams
    EXPECT_NO_THROW(check_numbers(ledger, "correlated", 5));
    EXPECT_NO_THROW(check_numbers(ledger, differences_method, 4));
    EXPECT_THROW(check_numbers(ledger, "correlated", 4), InputError);
    EXPECT_THROW(check_numbers(ledger, "dynamic", 4), InputError);
    EXPECT_THROW(check_numbers(ledger, differences_method, 3), InputError);
    EXPECT_THROW(check_numbers(ledger, differences_method, 5), InputError);
}

TEST(ChainOfEdits, PicturesAndResidualsThatSayNothingOfThemselvesAreLinksToo) {
    Image picture;
    picture.width = picture.height = 1;
    picture.samples = 4;
    picture.provenance.stage = "loom-merge";
    picture.provenance.seed = 9;
    for (const char* c : {"VarMean.R", "VarMean.G", "VarMean.B"}) picture.add(c)[0] = 0.5f;
    LedgerLink expected = link("", 4, 9, 0.5, 2);
    expected.what = "loom-merge";
    EXPECT_EQ(ledger_of(picture), Ledger{expected});
    EXPECT_EQ(link_of_residual(picture), link("loom-merge", 4, 9, 0.5, 0));
    picture.ledger = {link("dynamic", 2, 1, 3, 0)};
    EXPECT_EQ(link_of_residual(picture), picture.ledger[0]);
    EXPECT_EQ(ledger_of(picture), picture.ledger);
}

// A base of 64 samples with a variance of 1 a sample; edits of 8 pairs that add a fifth of its variance each.
TEST(ChainOfEdits, ANewBaseIsDueWhenHalfOfTheFirstDoesAsWell) {
    Ledger ledger = {link("", 64, 0, 1.0 / 64, 1)};
    for (int k = 1; k <= 5; ++k) {
        ledger.push_back(link("correlated", 8, 0, 0.2 / 64, 1));
        const Standing s = standing_of(ledger);
        EXPECT_NEAR(s.var_mean, (1 + 0.2 * k) / 64, 1e-12);
        EXPECT_NEAR(s.var_mean_of_edits, 0.2 * k / 64, 1e-12);
        EXPECT_NEAR(s.worth, 64 / (1 + 0.2 * k), 1e-9);
        EXPECT_EQ(s.base_samples, 64u);
        EXPECT_EQ(s.edit_paths, 16u);
        EXPECT_EQ(s.all_edit_paths, std::uint64_t(16 * k));
        EXPECT_FALSE(s.rebase() && k < 5) << k;
    }
    ledger.push_back(link("correlated", 8, 0, 0.02 / 64, 1));
    EXPECT_TRUE(standing_of(ledger).rebase());
    // The emitter is turned off; the noise of its light stays.
    EXPECT_TRUE(standing_of({ledger[0], link("correlated", 8, 0, 1e-6, 0.1)}).rebase());
    // A new image of the edit's 64 paths would be better than the sum, which still equals 50 of the base's 64 samples.
    EXPECT_TRUE(standing_of({ledger[0], link("correlated", 32, 0, 0.28 / 64, 1)}).rebase());
    EXPECT_FALSE(standing_of({ledger[0], link("correlated", 8, 0, 0.28 / 64, 1)}).rebase());
    // Zero variance, and unknown variance.
    EXPECT_FALSE(standing_of({link("", 64, 0, 0, 0), link("dynamic", 8, 0, 0, 0)}).rebase());
    EXPECT_FALSE(standing_of({link("", 64, 0, 0, 1), link("dynamic", 8, 0, 0, 0)}).rebase());
}

}  // namespace
}  // namespace loom::residual
