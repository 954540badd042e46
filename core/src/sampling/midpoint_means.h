#pragma once

#include <array>

#include "math/wide.h"

namespace raykiln {

/// Means of two functions over the unit square, by the midpoint rule on n x n cells:
/// `both(u, v)` gives an array of the two. n is a power of two, and at least 4.
template <std::uint32_t n, class Both>
std::array<double, 2> midpoint_means(const Both& both) {
    constexpr auto side = static_cast<float>(n);
    constexpr auto lanes = static_cast<std::uint32_t>(NumberTraits<Wide>::width);
    static_assert(n % lanes == 0);
    std::array<double, 2> sums{};
    for (std::uint32_t row = 0; row < n; ++row) {
        const Wide u((static_cast<float>(row) + 0.5f) / side);
        std::array<Wide, 2> of_row{Wide(0.0f), Wide(0.0f)};
        for (std::uint32_t column = 0; column < n; column += lanes) {
            const WideUint at = iota<WideUint>() + WideUint(column);
            const std::array<Wide, 2> here =
                both(u, (to_float(at) + Wide(0.5f)) * Wide(1.0f / side));
            of_row = {of_row[0] + here[0], of_row[1] + here[1]};
        }
        for (int i = 0; i < static_cast<int>(lanes); ++i) {
            sums[0] += of_row[0].lane(i);
            sums[1] += of_row[1].lane(i);
        }
    }
    const double cells = double{side} * side;
    return {sums[0] / cells, sums[1] / cells};
}

}  // namespace raykiln
