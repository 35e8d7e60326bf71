#pragma once

namespace loom {

/// What is looked at before a file is handed out.
enum class Check {
    everything,
    structure  // what memory safety asks for: lengths, offsets, numbers of rows; of floats nothing
};

}  // namespace loom
