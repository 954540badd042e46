#pragma once

#include <cstdint>
#include <vector>

#include "sampling/distribution.h"

namespace raykiln {

/// Views of a `BlockDistribution`, and how much each counts (together 1).
template <class F>
struct ViewMix {
    Uint<F> view[3];
    F share[3];
};

/// Piecewise-constant densities over the unit square on a grid of cells, which are
/// grouped into blocks. The densities, called views, agree within a block and differ in
/// how likely each block is.
class BlockDistribution {
  public:
    /// There are at most so many blocks side by side and above each other.
    static constexpr std::uint32_t most_columns = 32, most_rows = 16;

    BlockDistribution() = default;
    /// `weights` row by row, non-negative, one a cell. There is no view yet.
    BlockDistribution(const std::vector<float>& weights, int width, int height);

    std::uint32_t block_columns() const { return columns_; }
    std::uint32_t block_rows() const { return rows_; }
    /// The cells of block column (row) i: from entry i to before entry i + 1.
    const std::vector<std::uint32_t>& column_starts() const { return column_starts_; }
    const std::vector<std::uint32_t>& row_starts() const { return row_starts_; }
    /// The sum of the weights of each block, row by row.
    const std::vector<double>& masses() const { return masses_; }

    /// Adds a view: blocks are as likely as their weights say, all alike if they are all
    /// 0. Views are numbered from 0.
    void add_view(const std::vector<double>& block_weights);

    /// A point of the unit square and its density there; `w` chooses one of the views.
    /// Blocks are rectangles in (u, v) too, and within a row a point moves with u: strata
    /// of (u, v) stay together.
    template <class F>
    Vec2<F> sample(const ViewMix<F>& views, F u, F v, F w, F& pdf) const;
    /// Density at a point of the unit square (integrates to 1).
    template <class F>
    F pdf(const ViewMix<F>& views, Vec2<F> point) const;

  private:
    /// Where a view has the running sums and guides of its block rows (`line` 0) and of
    /// the blocks in row `line` - 1.
    template <class U>
    U cdf_of(U view, U line) const {
        return (view * U(rows_ + 1) + line) * U(most_columns + 1);
    }
    template <class U>
    U guide_of(U view, U line) const {
        return (view * U(rows_ + 1) + line) * U(guides);
    }

    /// Probability of a block, by the views together.
    template <class F>
    F probability_of(const ViewMix<F>& views, Uint<F> row, Uint<F> column) const {
        using U = Uint<F>;
        F sum(0.0f);
        for (int i = 0; i < 3; ++i) {
            const U block = (views.view[i] * U(rows_) + row) * U(columns_) + column;
            sum += views.share[i] * gather(probability_.data(), block);
        }
        return sum;
    }

    std::uint32_t width_ = 0, height_ = 0;
    std::uint32_t columns_ = 0, rows_ = 0;
    std::vector<std::uint32_t> column_of_cell_, row_of_cell_;
    std::vector<std::uint32_t> column_starts_, row_starts_;  // one more than blocks
    std::vector<double> masses_;
    // Within blocks: running sums over the rows of a block, over the cells of a row of a
    // block, and the density of a cell.
    std::vector<float> row_cdfs_, column_cdfs_, density_;
    // Of each view: running sums over blocks, the cells that hold i / guides and
    // (i + 1) / guides (the upper half of the word), and the probability of each block.
    static constexpr std::uint32_t guides = 16;
    std::vector<float> view_cdfs_, probability_;
    std::vector<std::uint32_t> view_guides_;
};

template <class F>
inline Vec2<F> BlockDistribution::sample(const ViewMix<F>& views, F u, F v, F w,
                                         F& pdf) const {
    using U = Uint<F>;
    const F first = views.share[0], two = first + views.share[1];
    const U view =
        select(w < first, views.view[0], select(w < two, views.view[1], views.view[2]));
    const auto find_block = [&](U line, F x, F& rest) {
        const U part = min(to_uint(x * F(static_cast<float>(guides))), U(guides - 1));
        const U ends = gather(view_guides_.data(), guide_of(view, line) + part);
        return detail::find_cell(view_cdfs_.data(), cdf_of(view, line), ends & U(0xffffu),
                                 ends >> 16, x, rest);
    };
    const U row = find_block(U(0u), v, v);
    const U column = find_block(row + U(1u), u, u);

    const U top = gather(row_starts_.data(), row);
    const U height = gather(row_starts_.data() + 1, row) - top;
    const U left = gather(column_starts_.data(), column);
    const U width = gather(column_starts_.data() + 1, column) - left;
    const U row_cdf = (top + row) * U(columns_) + column * (height + U(1u));
    const U y =
        top + detail::find_cell(row_cdfs_.data(), row_cdf, U(0u), height - U(1u), v, v);
    const U column_cdf = y * U(width_ + columns_) + left + column;
    const U x = left + detail::find_cell(column_cdfs_.data(), column_cdf, U(0u),
                                         width - U(1u), u, u);

    pdf = probability_of(views, row, column) * gather(density_.data(), y * U(width_) + x);
    return {(to_float(x) + u) / F(static_cast<float>(width_)),
            (to_float(y) + v) / F(static_cast<float>(height_))};
}

template <class F>
inline F BlockDistribution::pdf(const ViewMix<F>& views, Vec2<F> p) const {
    using U = Uint<F>;
    const auto cell = [](F at, std::uint32_t n) {
        const auto size = static_cast<float>(n);
        return to_uint(clamp(at * F(size), F(0.0f), F(size - 1.0f)));
    };
    const U x = cell(p.x, width_), y = cell(p.y, height_);
    const U column = gather(column_of_cell_.data(), x);
    const U row = gather(row_of_cell_.data(), y);
    return probability_of(views, row, column) *
           gather(density_.data(), y * U(width_) + x);
}

}  // namespace raykiln
