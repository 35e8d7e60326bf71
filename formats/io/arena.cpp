#include "formats/io/arena.h"

#include <sys/mman.h>

#include <algorithm>
#include <cstdint>
#include <new>

namespace loom {
namespace {

constexpr std::size_t huge_page_bytes = std::size_t(2) << 20;
constexpr std::size_t mapping_bytes = std::size_t(256) << 20;
constexpr std::size_t block_alignment = 64;

constexpr std::size_t rounded_up(std::size_t n, std::size_t multiple) {
    return (n + multiple - 1) / multiple * multiple;
}

}  // namespace

Arena::~Arena() {
    for (const auto mapped : mapped_) ::munmap(mapped.data(), mapped.size());
}

std::span<std::byte> Arena::allocate(std::size_t n_bytes) {
    const std::size_t rounded = rounded_up(n_bytes, block_alignment);
    const std::lock_guard lock(mutex_);
    while (rounded > free_.size()) {
        if (n_used_ == mapped_.size()) map(rounded);
        const std::span<std::byte> mapping = mapped_[n_used_++];
        const auto address = reinterpret_cast<std::uintptr_t>(mapping.data());
        free_ = mapping.subspan(rounded_up(address, huge_page_bytes) - address);
    }
    const auto block = free_.first(n_bytes);
    free_ = free_.subspan(rounded);
    return block;
}

void Arena::reset() {
    const std::lock_guard lock(mutex_);
    n_used_ = 0;
    free_ = {};
}

void Arena::map(std::size_t n_bytes) {
    // One additional huge page, so that the blocks can start at its boundary.
    const std::size_t size = std::max(mapping_bytes, rounded_up(n_bytes, huge_page_bytes)) + huge_page_bytes;
    mapped_.reserve(mapped_.size() + 1);
    void* at = ::mmap(nullptr, size, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS | MAP_NORESERVE, -1, 0);
    if (at == MAP_FAILED) throw std::bad_alloc();
    ::madvise(at, size, MADV_HUGEPAGE);  // a hint: small pages work as well
    mapped_.emplace_back(static_cast<std::byte*>(at), size);
}

}  // namespace loom
