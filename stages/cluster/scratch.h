#pragma once
#include <sys/mman.h>

#include <cstddef>
#include <cstdlib>
#include <new>
#include <span>
#include <utility>

namespace loom::cluster {

/// Memory for plain values that is kept from call to call and never cleared; on huge pages where there are any, since
/// the first touch of small pages would cost more than the work done in them.
template <class T>
class Scratch {
  public:
    Scratch() = default;
    Scratch(const Scratch&) = delete;
    Scratch& operator=(const Scratch&) = delete;
    ~Scratch() { std::free(data_); }

    /// n values of unknown content, valid until the next call.
    std::span<T> get(std::size_t n) {
        if (n > capacity_) {
            std::free(std::exchange(data_, nullptr));
            capacity_ = 0;
            const std::size_t bytes = (n * sizeof(T) + page - 1) / page * page;
            data_ = static_cast<T*>(std::aligned_alloc(page, bytes));
            if (data_ == nullptr) throw std::bad_alloc();
            madvise(data_, bytes, MADV_HUGEPAGE);
            capacity_ = n;
        }
        return {data_, n};
    }

  private:
    static constexpr std::size_t page = std::size_t{2} << 20;
    T* data_ = nullptr;
    std::size_t capacity_ = 0;
};

}  // namespace loom::cluster
