#pragma once

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

}  // namespace raykiln
