#pragma once

namespace loom {

/// What a reader checks before it returns a file.
enum class Check {
    everything,
    structure  // what memory safety requires: lengths, offsets, row indices; floats are not checked
};

}  // namespace loom
