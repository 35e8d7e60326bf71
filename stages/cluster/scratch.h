#pragma once
#include "stages/core/compute/huge_array.h"

namespace loom::cluster {

/// Memory for plain values that is reused between calls and never cleared.
template <class T>
class Scratch {
  public:
    /// Returns n uninitialised values, valid until the next call.
    std::span<T> get(std::size_t n) {
        if (n > memory_.size()) {
            memory_ = {};
            memory_ = HugeArray<T>(n);
        }
        return {memory_.data(), n};
    }

  private:
    HugeArray<T> memory_;
};

}  // namespace loom::cluster
