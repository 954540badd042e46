#include "memory/pages.h"

#include <sys/mman.h>
#include <unistd.h>

#include <algorithm>
#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <new>
#include <string>

namespace raykiln {

namespace {

constexpr std::size_t line = 64, huge_page = std::size_t{2} << 20;
// Less than this is not worth the rest of a page.
constexpr std::size_t least_huge = huge_page / 4;

constexpr std::size_t rounded_up(std::size_t bytes, std::size_t to) {
    return (bytes + to - 1) / to * to;
}

// Debian 12's headers do not have it yet.
constexpr int madvise_collapse = 25;

/// Whether the huge page from `begin` on would hold little that is not there already.
bool is_almost_full(std::uintptr_t begin) {
    static const auto page = static_cast<std::size_t>(sysconf(_SC_PAGESIZE));
    std::vector<unsigned char> there(huge_page / page);
    if (mincore(reinterpret_cast<void*>(begin), huge_page, there.data()) != 0) {
        return false;
    }
    const auto full = std::count_if(there.begin(), there.end(),
                                    [](unsigned char state) { return (state & 1) != 0; });
    return static_cast<std::size_t>(full) >= there.size() - there.size() / 8;
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

void move_to_huge_pages(const void* memory, std::size_t bytes) {
    const auto begin = reinterpret_cast<std::uintptr_t>(memory);
    const std::uintptr_t end = begin + bytes;
    for (auto at = begin / huge_page * huge_page; at < end; at += huge_page) {
        if (is_almost_full(at)) {
            (void)madvise(reinterpret_cast<void*>(at), huge_page, madvise_collapse);
        }
    }
}

NewMemory::NewMemory() : before_(ranges_now()) {}

std::vector<NewMemory::Range> NewMemory::ranges_now() {
    std::vector<Range> ranges;
    std::ifstream maps("/proc/self/maps");
    for (std::string line; std::getline(maps, line);) {
        unsigned long long begin, end, file;
        char rights[5] = {}, name[8] = {};
        const int fields = std::sscanf(line.c_str(), "%llx-%llx %4s %*s %*s %llu %7s",
                                       &begin, &end, rights, &file, name);
        const bool is_plain =
            fields == 4 || (fields == 5 && name == std::string("[heap]"));
        if (is_plain && file == 0 && rights == std::string("rw-p")) {
            ranges.push_back({begin, end});
        }
    }
    return ranges;
}

void NewMemory::move_to_huge_pages() const {
    const auto move = [](std::uintptr_t begin, std::uintptr_t end) {
        if (begin < end) {
            raykiln::move_to_huge_pages(reinterpret_cast<void*>(begin), end - begin);
        }
    };
    auto old = before_.begin();
    for (Range range : ranges_now()) {
        for (; old != before_.end() && old->begin < range.end; ++old) {
            move(range.begin, old->begin);
            range.begin = std::max(range.begin, old->end);
            if (old->end > range.end) {
                break;
            }
        }
        move(range.begin, range.end);
    }
}

}  // namespace raykiln
