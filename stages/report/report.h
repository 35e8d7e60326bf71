#pragma once
// loom-report: one self-contained HTML page on the pictures of several methods beside their reference.

#include <string>
#include <vector>

#include "formats/io/cost.h"

namespace loom::app {
class Command;
class Report;
}  // namespace loom::app

namespace loom::report {

struct Options {
    std::vector<std::string> pictures;    // LABEL=FILE, the first is what others are compared with
    std::string reference;                // image that they should be
    std::string errors;                   // TSV of loom-compare --reference --cost
    std::string equal_cost, equal_error;  // TSVs of loom-chart
    std::vector<std::string> charts;      // SVG of loom-chart; what they show is known by their names
    std::string peers;                    // TSV of make peers
    std::string title;                    // the scene
    std::string made_by;                  // what makes the page again
    int longest_side = 512;               // px; larger pictures are shown reduced by a whole number
    std::string tour;                     // TSV of figures to show instead, see tour_page()
    std::string output;                   // .html
};

/// A row of a lineage: the files that one stage made of like parents, `pass-0.exr` to `pass-3.exr` say.
struct Made {
    std::string name;                // "pt/pass-*.exr"; relative to the folder of the picture
    std::vector<std::string> names;  // of each file
    std::vector<std::string> from;   // names of the rows (or of scenes) that they were made from
    Cost cost;                       // sums; the largest peak memory; command and plan of the first file
};

/// Where a picture comes from, ancestors first.
/// throws:  InputError as read_chain
std::vector<Made> lineage_of(const std::string& picture);

/// The page. It depends on the inputs and options only: no clock, no folder, no network.
/// throws:  InputError when inputs do not fit together
std::string page_of(const Options& options);

/// Binds the options to the command line; `options` must outlive `command`.
void declare(app::Command& command, Options& options);
void run(const Options& options, app::Report& report);

}  // namespace loom::report
