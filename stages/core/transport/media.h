#pragma once
#include <array>
#include <cstdint>

namespace loom {

/// The dielectric objects that a path is inside of, innermost last; gives the absolute index of refraction
/// of the segment that comes next, right for nested and immersed objects. Leaving an object removes its own
/// entry, wherever it lies, so that overlapping surfaces do no harm.
class MediumStack {
  public:
    /// Index of the medium around; outside of everything that of the last surface's outside.
    float index() const { return size_ > 0 ? entries_[size_ - 1].ior : outside_; }

    void cross(std::uint32_t shape, bool entering, float int_ior, float ext_ior) {
        if (entering) {
            if (size_ == 0) outside_ = ext_ior;
            if (size_ < max_nesting) entries_[size_++] = {shape, int_ior};
            return;
        }
        for (int i = size_ - 1; i >= 0; --i) {
            if (entries_[i].shape != shape) continue;
            for (int k = i; k + 1 < size_; ++k) entries_[k] = entries_[k + 1];
            --size_;
            return;
        }
        outside_ = ext_ior;  // the path began inside
    }

  private:
    static constexpr int max_nesting = 16;
    struct Entry {
        std::uint32_t shape;
        float ior;
    };
    int size_ = 0;
    float outside_ = 1.0f;
    std::array<Entry, max_nesting> entries_;
};

}  // namespace loom
