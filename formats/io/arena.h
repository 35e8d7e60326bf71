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

    /// A block of zeros, aligned for any number; from any thread.
    /// throws:  std::bad_alloc
    std::span<std::byte> allocate(std::size_t n_bytes);

  private:
    std::mutex mutex_;
    std::vector<std::span<std::byte>> mapped_;
    std::span<std::byte> free_;  // of the last mapping
};

}  // namespace loom
