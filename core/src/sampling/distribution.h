#pragma once

#include <bit>
#include <cstdint>
#include <vector>

#include "math/gather.h"

namespace raykiln {

/// Discrete distribution with O(1) sampling (alias method, Vose 1991).
class AliasTable {
  public:
    AliasTable() = default;
    /// Probabilities proportional to `weights`; uniform if they are all 0.
    explicit AliasTable(const std::vector<float>& weights);

    /// An index drawn with a number in [0, 1); `remapped` is a fresh uniform number from
    /// the rest.
    template <class F>
    Uint<F> sample(F u, F& remapped) const {
        const F scaled = u * F(static_cast<float>(cells_.size()));
        const Uint<F> last(static_cast<std::uint32_t>(cells_.size() - 1));
        const Uint<F> cell = min(to_uint(scaled), last);
        const F rest = min(scaled - to_float(cell), F(one_minus_epsilon));
        const F threshold = gather_member<F>(cells_.data(), &Cell::threshold, cell);
        const auto keep = rest < threshold;
        remapped = select(keep, rest, rest - threshold) /
                   select(keep, threshold, F(1.0f) - threshold);
        remapped = min(remapped, F(one_minus_epsilon));
        return select(keep, cell, gather_member<F>(cells_.data(), &Cell::alias, cell));
    }
    float pmf(std::uint32_t index) const { return cells_[index].pmf; }
    template <class F>
    F pmf_at(Uint<F> index) const {
        return gather_member<F>(cells_.data(), &Cell::pmf, index);
    }
    std::size_t size() const { return cells_.size(); }

  private:
    struct Cell {
        float threshold;
        float pmf;
        std::uint32_t alias;
    };
    std::vector<Cell> cells_;
};

/// Piecewise-constant density over the unit square on a grid of width x height cells.
class Distribution2D {
  public:
    Distribution2D() = default;
    /// `weights` row by row, non-negative, one a cell.
    Distribution2D(const std::vector<float>& weights, int width, int height);

    /// A point of the unit square and its density there.
    template <class F>
    Vec2<F> sample(F u, F v, F& pdf) const;
    /// Density at a point of the unit square (integrates to 1).
    template <class F>
    F pdf(Vec2<F> point) const;
    bool empty() const { return width_ == 0; }

  private:
    int width_ = 0, height_ = 0;
    std::vector<float> density_;
    std::vector<float> row_cdf_;     // height + 1
    std::vector<float> column_cdf_;  // (width + 1) a row
    // The cell that holds u = i / guides, i from 0 to guides; a row after the other.
    static constexpr std::uint32_t guides = 256;
    std::vector<std::uint32_t> row_guide_, column_guide_;
};

namespace detail {

/// The cell of a cdf (n + 1 entries from `offset`) that holds u, and where in it, in
/// [0, 1). `low` and `high` are cells that it lies between, ends included.
template <class F>
inline Uint<F> find_cell(const float* cdf, Uint<F> offset, Uint<F> low, Uint<F> high, F u,
                         F& within) {
    using U = Uint<F>;
    // The last entry that is not above u.
    auto open = low < high;
    while (any(open)) {
        const U middle = (low + high + U(1u)) >> 1;
        const auto below = gather(cdf, offset + middle) <= u;
        low = select(open & below, middle, low);
        high = select(open & !below, middle - U(1u), high);
        open = low < high;
    }
    const F start = gather(cdf, offset + low);
    const F size = gather(cdf, offset + low + U(1u)) - start;
    const auto wide = size > F(0.0f);
    within =
        select(wide, min((u - start) / select(wide, size, F(1.0f)), F(one_minus_epsilon)),
               F(0.5f));
    return low;
}
template <class F>
inline Uint<F> find_cell(const float* cdf, Uint<F> offset, int n, F u, F& within) {
    return find_cell(cdf, offset, Uint<F>(0u), Uint<F>(static_cast<std::uint32_t>(n - 1)),
                     u, within);
}

}  // namespace detail

template <class F>
inline Vec2<F> Distribution2D::sample(F u, F v, F& pdf) const {
    using U = Uint<F>;
    F fx, fy;
    // The guides tell between which cells to look.
    const auto part_of = [](F x) {
        return min(to_uint(x * F(static_cast<float>(guides))), U(guides - 1));
    };
    const U row_part = part_of(v);
    const U y =
        detail::find_cell(row_cdf_.data(), U(0u), gather(row_guide_.data(), row_part),
                          gather(row_guide_.data() + 1, row_part), v, fy);
    const auto width = static_cast<std::uint32_t>(width_);
    const U column_part = y * U(guides + 1) + part_of(u);
    const U x = detail::find_cell(column_cdf_.data(), y * U(width + 1),
                                  gather(column_guide_.data(), column_part),
                                  gather(column_guide_.data() + 1, column_part), u, fx);
    pdf = gather(density_.data(), y * U(width) + x);
    return {(to_float(x) + fx) / F(static_cast<float>(width_)),
            (to_float(y) + fy) / F(static_cast<float>(height_))};
}

template <class F>
inline F Distribution2D::pdf(Vec2<F> p) const {
    using U = Uint<F>;
    const auto cell = [](F at, int n) {
        const auto size = static_cast<float>(n);
        return to_uint(clamp(at * F(size), F(0.0f), F(size - 1.0f)));
    };
    return gather(
        density_.data(),
        cell(p.y, height_) * U(static_cast<std::uint32_t>(width_)) + cell(p.x, width_));
}

}  // namespace raykiln
