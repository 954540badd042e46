#include "memory/pages.h"

#include <gtest/gtest.h>

#include <cstdint>
#include <cstring>
#include <limits>
#include <new>
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

}  // namespace
}  // namespace raykiln
