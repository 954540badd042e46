#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

namespace raykiln {

/// Memory for `bytes`, aligned to 64. Much of it lies in pages of 2 MiB where the kernel
/// has them: what is read here and there then costs no look-ups of where pages are.
/// Throws std::bad_alloc.
void* allocate_pages(std::size_t bytes);
void free_pages(void* memory) noexcept;

/// For containers whose elements are read here and there.
template <class T>
struct PageAllocator {
    using value_type = T;

    PageAllocator() = default;
    template <class U>
    PageAllocator(const PageAllocator<U>&) {}

    T* allocate(std::size_t count) {
        return static_cast<T*>(allocate_pages(count * sizeof(T)));
    }
    void deallocate(T* memory, std::size_t) noexcept { free_pages(memory); }

    friend bool operator==(const PageAllocator&, const PageAllocator&) { return true; }
};

/// Moves memory into pages of 2 MiB, with what lies beside it in the first and the last
/// one, but for pages that would be mostly empty. Needs Linux 6.1; elsewhere, and where
/// the kernel refuses, it stays where it is.
void move_to_huge_pages(const void* memory, std::size_t bytes);

/// What this process allocates from now on; for libraries that allocate by themselves.
class NewMemory {
  public:
    NewMemory();
    void move_to_huge_pages() const;

  private:
    struct Range {
        std::uintptr_t begin, end;
    };
    static std::vector<Range> ranges_now();

    std::vector<Range> before_;  // ascending
};

}  // namespace raykiln
