#pragma once
#include <cstddef>
#include <mutex>
#include <span>
#include <vector>

namespace loom {

/// Allocates many blocks that are freed together, in huge pages where the kernel provides them. The kernel assigns a
/// page at first touch; reserved but untouched memory is free.
class Arena {
  public:
    Arena() = default;
    ~Arena();
    Arena(const Arena&) = delete;
    Arena& operator=(const Arena&) = delete;

    /// Returns an uninitialised block, aligned for any arithmetic type. Thread-safe.
    /// throws:  std::bad_alloc
    std::span<std::byte> allocate(std::size_t n_bytes);

    /// Frees all blocks but keeps their pages: reused pages avoid the cost of a first touch.
    void reset();

  private:
    void map(std::size_t n_bytes);

    std::mutex mutex_;
    std::vector<std::span<std::byte>> mapped_;
    std::size_t n_used_ = 0;     // mappings in use; the last one partly
    std::span<std::byte> free_;  // rest of the last mapping in use
};

}  // namespace loom
