#pragma once

#include <cstdint>
#include <vector>

#include "memory/pages.h"
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
    /// Cells along the longer side of a block.
    std::uint32_t widest() const { return (width_ + columns_ - 1) / columns_; }
    std::uint32_t tallest() const { return (height_ + rows_ - 1) / rows_; }
    /// Where a view has the running sums of its block rows (`line` 0) and of the blocks
    /// in row `line` - 1.
    template <class U>
    U view_cdf(U view, U line) const {
        return (view * U(rows_ + 1) + line) * U(Cdf::floats_for(most_columns));
    }
    /// Where a block has those of its rows.
    template <class U>
    U row_cdf(U row, U column) const {
        return (row * U(columns_) + column) * U(Cdf::floats_for(tallest()));
    }
    /// Where row y of a block has those of its cells.
    template <class U>
    U column_cdf(U y, U column) const {
        return (y * U(columns_) + column) * U(Cdf::floats_for(widest()));
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

    using Floats = std::vector<float, PageAllocator<float>>;

    std::uint32_t width_ = 0, height_ = 0;
    std::uint32_t columns_ = 0, rows_ = 0;
    std::vector<std::uint32_t> column_of_cell_, row_of_cell_;
    std::vector<std::uint32_t> column_starts_, row_starts_;  // one more than blocks
    std::vector<double> masses_;
    // Within blocks: running sums over the rows of a block, over the cells of a row of a
    // block, and the density of a cell.
    Floats row_cdfs_, column_cdfs_, density_;
    // Of each view: running sums over blocks, and the probability of each block.
    Floats view_cdfs_, probability_;
};

template <class F>
inline Vec2<F> BlockDistribution::sample(const ViewMix<F>& views, F u, F v, F w,
                                         F& pdf) const {
    using U = Uint<F>;
    const F first = views.share[0], two = first + views.share[1];
    const U view =
        select(w < first, views.view[0], select(w < two, views.view[1], views.view[2]));
    const U row = Cdf::find(view_cdfs_.data(), view_cdf(view, U(0u)), rows_, v, v);
    const U column =
        Cdf::find(view_cdfs_.data(), view_cdf(view, row + U(1u)), columns_, u, u);
    const U y = gather(row_starts_.data(), row) +
                Cdf::find(row_cdfs_.data(), row_cdf(row, column), tallest(), v, v);
    const U x = gather(column_starts_.data(), column) +
                Cdf::find(column_cdfs_.data(), column_cdf(y, column), widest(), u, u);

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
