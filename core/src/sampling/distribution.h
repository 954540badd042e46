#pragma once

#include <algorithm>
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

/// Running sums of probabilities, searched sixteen cells at a time.
struct Cdf {
    static constexpr std::uint32_t row = 16;
    /// How many floats hold the sums of n cells.
    static constexpr std::uint32_t floats_for(std::uint32_t n) {
        return (n + row - 1) / row * row;
    }
    /// The sums up to the ends of n cells whose probabilities are in proportion to
    /// `weights`, all alike if they are all 0; what follows is above 1. Returns the
    /// total.
    template <class Weight>
    static double fill(const Weight* weights, std::uint32_t n, float* sums) {
        double total = 0;
        for (std::uint32_t i = 0; i < n; ++i) {
            total += weights[i];
        }
        double running = 0;
        for (std::uint32_t i = 0; i < n; ++i) {
            running += total > 0 ? weights[i] / total : 1.0 / n;
            sums[i] = static_cast<float>(running);
        }
        sums[n - 1] = 1.0f;
        std::fill(sums + n, sums + floats_for(n), 2.0f);
        return total;
    }
    /// The probability of a cell.
    static float probability(const float* sums, std::size_t cell) {
        return sums[cell] - (cell == 0 ? 0.0f : sums[cell - 1]);
    }
    /// The cell that holds u, in [0, 1), and where in it, also in [0, 1). Its cells, from
    /// `sums[begin]` on, are `most` or one less; one with a probability of 0 is not
    /// found.
    template <class F>
    static Uint<F> find(const float* sums, Uint<F> begin, std::uint32_t most, F u,
                        F& within) {
        using U = Uint<F>;
        U first = begin;  // the row to count in
        for (std::uint32_t rows = floats_for(most) / row; rows > 1;) {
            const std::uint32_t half = rows / 2;
            const U middle = first + U(half * row);
            first = select(gather(sums, middle - U(1u)) <= u, middle, first);
            rows -= half;
        }
        const U at = first + count_not_above(sums, first, u);
        const auto later = at != begin;
        const F before = gather(sums, select(later, at - U(1u), at));
        const F start = select(later, before, F(0.0f));
        const F size = gather(sums, at) - start;
        const auto wide = size > F(0.0f);
        within = select(
            wide, min((u - start) / select(wide, size, F(1.0f)), F(one_minus_epsilon)),
            F(0.5f));
        return at - begin;
    }
};

}  // namespace raykiln
