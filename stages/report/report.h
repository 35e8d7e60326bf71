#pragma once
// loom-report: one self-contained HTML page with the images of several methods beside their reference.

#include <string>
#include <vector>

#include "formats/io/cost.h"

namespace loom::app {
class Command;
class Report;
}  // namespace loom::app

namespace loom::report {

struct Options {
    std::vector<std::string> pictures;    // LABEL=FILE; the others are compared with the first
    std::string reference;                // reference image
    std::string errors;                   // TSV of loom-compare --reference --cost
    std::string equal_cost, equal_error;  // TSVs of loom-chart
    std::vector<std::string> charts;      // SVG of loom-chart; their names identify their content
    std::string peers;                    // TSV of make peers
    std::string title;                    // the scene
    std::string made_by;                  // command that makes the page again
    int longest_side = 512;               // px; larger images are reduced by an integer factor
    std::vector<std::string> animation;   // frames; if any, the page is animation_page()
    std::string by_frame;                 // TSV of loom-compare --by-frame
    std::string movie;                    // linked to, not read
    double fps = 24;                      // of the page's player
    std::string tour;                     // TSV of figures; if set, the page is tour_page()
    std::string output;                   // .html
};

/// A row of a lineage: the files that one stage made from similar parents, for example `pass-0.exr` to `pass-3.exr`.
struct Made {
    std::string name;                // "pt/pass-*.exr"; relative to the folder of the image
    std::vector<std::string> names;  // [file]
    std::vector<std::string> from;   // names of the parent rows (or scenes)
    Cost cost;                       // sums; the largest peak memory; command and plan of the first file
};

/// Returns the lineage of an image, ancestors first.
/// throws:  InputError as read_chain
std::vector<Made> lineage_of(const std::string& picture);

double cpu_s_of(const std::vector<Made>& lineage);

/// Returns the lineage of an image as an element that opens.
/// in:      name  HTML
///          lineage  empty: made by another program
std::string lineage_details(const std::string& name, const std::vector<Made>& lineage, bool open);

/// Returns the page. It depends on inputs and options only: no clock, no folder, no network.
/// throws:  InputError when inputs are inconsistent
std::string page_of(const Options& options);

/// Binds the options to the command line; `options` must outlive `command`.
void declare(app::Command& command, Options& options);
void run(const Options& options, app::Report& report);

}  // namespace loom::report
