#pragma once
#include "formats/path_graph.h"
#include "formats/tal_capture.h"
#include "formats/transient_cube.h"

namespace loom::transient {

/// Makes a capture with the metadata that TAL requires, lengths in metres; H is zero.
/// in:      header  of the cube whose rows add_rows() takes
/// needs:   graph.nlos
TalCapture start_capture(const PathGraph& graph, const TransientCubeHeader& header);

/// Adds rows of the cube to H; channels are summed, as TAL does.
void add_rows(const PathGraph& graph, std::uint32_t first_row, const TransientRows& rows, TalCapture& capture);

}  // namespace loom::transient
