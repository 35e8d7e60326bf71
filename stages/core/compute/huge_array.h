#pragma once
#include <sys/mman.h>

#include <cstddef>
#include <new>
#include <span>
#include <utility>

namespace loom {

/// Uninitialised array (zero when newly mapped) of plain values for the large tables of a stage, on huge pages where
/// the system provides them. The first touch of small pages costs several times the work done on them.
template <class T>
class HugeArray {
  public:
    HugeArray() = default;
    explicit HugeArray(std::size_t n) : size_(n) {
        if (n == 0) return;
        bytes_ = (n * sizeof(T) + page - 1) / page * page;
        void* memory =
            mmap(nullptr, bytes_, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS | MAP_NORESERVE, -1, 0);
        if (memory == MAP_FAILED) throw std::bad_alloc();
        madvise(memory, bytes_, MADV_HUGEPAGE);
        data_ = static_cast<T*>(memory);
    }
    HugeArray(HugeArray&& other) noexcept
        : data_(std::exchange(other.data_, nullptr)),
          size_(std::exchange(other.size_, 0)),
          bytes_(std::exchange(other.bytes_, 0)) {}
    HugeArray& operator=(HugeArray&& other) noexcept {
        std::swap(data_, other.data_);
        std::swap(size_, other.size_);
        std::swap(bytes_, other.bytes_);
        return *this;
    }
    ~HugeArray() {
        if (data_) munmap(data_, bytes_);
    }

    T* data() { return data_; }
    const T* data() const { return data_; }
    std::size_t size() const { return size_; }
    bool empty() const { return size_ == 0; }
    T& operator[](std::size_t i) { return data_[i]; }
    const T& operator[](std::size_t i) const { return data_[i]; }
    operator std::span<const T>() const { return {data_, size_}; }

    /// Reuses the memory for values of another type, because first-touched pages cost more than the writes. An old
    /// value is readable until a new value replaces it.
    template <class U>
    HugeArray<U> reused() && {
        static_assert(sizeof(U) == sizeof(T));
        return HugeArray<U>(reinterpret_cast<U*>(std::exchange(data_, nullptr)), std::exchange(size_, 0),
                            std::exchange(bytes_, 0));
    }

  private:
    template <class>
    friend class HugeArray;
    HugeArray(T* data, std::size_t size, std::size_t bytes) : data_(data), size_(size), bytes_(bytes) {}

    static constexpr std::size_t page = std::size_t{2} << 20;

    T* data_ = nullptr;
    std::size_t size_ = 0, bytes_ = 0;
};

}  // namespace loom
