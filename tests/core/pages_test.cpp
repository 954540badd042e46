#include "memory/pages.h"

#include <gtest/gtest.h>
#include <sys/mman.h>
#include <unistd.h>

#include <algorithm>
#include <cstdint>
#include <cstring>
#include <fstream>
#include <limits>
#include <new>
#include <string>
#include <vector>

// Memory in large pages: all of it is there, and too much is refused.

namespace raykiln {
namespace {

TEST(Pages, SmallAndLargePiecesAreWhole) {
    for (const std::size_t bytes : {std::size_t{1}, std::size_t{1000},
                                    std::size_t{1} << 19, (std::size_t{3} << 20) + 5}) {
        void* memory = allocate_pages(bytes);
        EXPECT_EQ(reinterpret_cast<std::uintptr_t>(memory) % 64, 0u) << bytes;
        std::memset(memory, 0x5a, bytes);
        EXPECT_EQ(static_cast<unsigned char*>(memory)[bytes - 1], 0x5a) << bytes;
        free_pages(memory);
    }
}

TEST(Pages, TooMuchIsRefused) {
    for (const std::size_t bytes : {std::numeric_limits<std::size_t>::max(),
                                    std::numeric_limits<std::size_t>::max() / 2}) {
        EXPECT_THROW(free_pages(allocate_pages(bytes)), std::bad_alloc);
    }
}

TEST(Pages, ContainersGrow) {
    std::vector<std::uint32_t, PageAllocator<std::uint32_t>> numbers;
    for (std::uint32_t i = 0; i < 1000000; ++i) {
        numbers.push_back(i);
    }
    for (std::uint32_t i = 0; i < numbers.size(); ++i) {
        ASSERT_EQ(numbers[i], i);
    }
}

constexpr std::size_t huge = std::size_t{2} << 20, some = 4 * huge;

/// Pages of the usual size, to which nothing has been written.
unsigned char* fresh_pages() {
    void* memory =
        mmap(nullptr, some, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
    EXPECT_NE(memory, MAP_FAILED);
    return static_cast<unsigned char*>(memory);
}

std::size_t pages_there(unsigned char* memory) {
    std::vector<unsigned char> there(some / static_cast<std::size_t>(getpagesize()));
    EXPECT_EQ(mincore(memory, some, there.data()), 0);
    return static_cast<std::size_t>(std::count_if(
        there.begin(), there.end(), [](unsigned char page) { return (page & 1) != 0; }));
}

/// Kilobytes of this process in huge pages.
long huge_kilobytes() {
    long sum = 0;
    std::ifstream file("/proc/self/smaps");
    for (std::string line; std::getline(file, line);) {
        if (line.rfind("AnonHugePages:", 0) == 0) {
            sum += std::stol(line.substr(14));
        }
    }
    return sum;
}

bool kernel_moves_pages() {
    unsigned char* memory = fresh_pages();
    std::memset(memory, 1, some);
    auto* begin = reinterpret_cast<unsigned char*>(
        (reinterpret_cast<std::uintptr_t>(memory) + huge - 1) / huge * huge);
    constexpr int collapse = 25;
    const bool moved = madvise(begin, huge, collapse) == 0;
    munmap(memory, some);
    return moved;
}

TEST(NewMemory, WhatIsFullMovesAndKeepsItsBytes) {
    if (!kernel_moves_pages()) {
        GTEST_SKIP() << "this kernel moves nothing into huge pages";
    }
    const NewMemory since;
    unsigned char* memory = fresh_pages();
    for (std::size_t i = 0; i < some; ++i) {
        memory[i] = static_cast<unsigned char>(i % 251);
    }
    const long before = huge_kilobytes();
    since.move_to_huge_pages();
    // How many depends on the memory that the machine has left in one piece.
    EXPECT_GT(huge_kilobytes(), before);
    for (std::size_t i = 0; i < some; ++i) {
        ASSERT_EQ(memory[i], i % 251);
    }
    munmap(memory, some);
}

TEST(NewMemory, WhatIsEmptyStaysSo) {
    const NewMemory since;
    unsigned char* memory = fresh_pages();
    for (std::size_t i = 0; i < some; i += huge / 4) {
        memory[i] = 1;
    }
    const std::size_t before = pages_there(memory);
    since.move_to_huge_pages();
    move_to_huge_pages(memory, some);
    EXPECT_EQ(pages_there(memory), before);
    munmap(memory, some);
}

TEST(NewMemory, WhatWasThereIsLeftAlone) {
    unsigned char* memory = fresh_pages();
    std::memset(memory, 1, some);
    const NewMemory since;
    const long before = huge_kilobytes();
    since.move_to_huge_pages();
    EXPECT_LT(huge_kilobytes() - before, static_cast<long>((some - huge) >> 10));
    munmap(memory, some);
}

}  // namespace
}  // namespace raykiln
