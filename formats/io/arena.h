#pragma once
#include <cstddef>
#include <mutex>
#include <span>
#include <vector>

namespace loom {

/// Memory for many blocks that live and die together, in huge pages where the kernel gives them. A page is
/// taken when a block first uses it, so what is reserved ahead costs nothing.
class Arena {
  public:
    Arena() = default;
    ~Arena();
    Arena(const Arena&) = delete;
    Arena& operator=(const Arena&) = delete;

    /// A block, aligned for any number, of unknown content; from any thread.
    /// throws:  std::bad_alloc
    std::span<std::byte> allocate(std::size_t n_bytes);

    /// Ends all blocks and keeps their pages: memory that has been touched costs nothing to touch again.
    void reset();

  private:
    void map(std::size_t n_bytes);

    std::mutex mutex_;
    std::vector<std::span<std::byte>> mapped_;
    std::size_t n_used_ = 0;     // mappings, the last of them in part
    std::span<std::byte> free_;  // of the last mapping in use
};

}  // namespace loom
