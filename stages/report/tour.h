#pragma once
#include <string>

namespace loom::report {

/// Makes a page of figures in sections, each figure with its command and its cost.
/// in:      file   tab-separated table, one row per figure, with the columns
///                   section  heading; rows of one section are consecutive
///                   text     paragraph under the heading, from the section's first row
///                   figure   image to show (PNG or SVG)
///                   caption  below the figure
///                   output   files, separated by blanks, whose costs are summed with those of their ancestors
///                            (.cost.json); may be empty
///                   command  command that makes the figure again
///          title  of the page
/// The page depends on these files only: it needs no network and opens from disk.
/// throws:  InputError when a column is missing, a figure is no image or a cost is missing
std::string tour_page(const std::string& file, const std::string& title);

}  // namespace loom::report
