#include "memory/pages.h"

#include <sys/mman.h>

#include <cstdlib>
#include <new>

namespace raykiln {

namespace {

constexpr std::size_t line = 64, huge_page = std::size_t{2} << 20;
// Less than this is not worth the rest of a page.
constexpr std::size_t least_huge = huge_page / 4;

constexpr std::size_t rounded_up(std::size_t bytes, std::size_t to) {
    return (bytes + to - 1) / to * to;
}

}  // namespace

void* allocate_pages(std::size_t bytes) {
    const std::size_t alignment = bytes >= least_huge ? huge_page : line;
    const std::size_t size = rounded_up(bytes, alignment);
    void* memory = size < bytes ? nullptr : std::aligned_alloc(alignment, size);
    if (memory == nullptr) {
        throw std::bad_alloc();
    }
    if (alignment == huge_page) {
        // Kernels without such pages refuse, and the small ones do.
        (void)madvise(memory, size, MADV_HUGEPAGE);
    }
    return memory;
}

void free_pages(void* memory) noexcept {
    std::free(memory);
}

}  // namespace raykiln
