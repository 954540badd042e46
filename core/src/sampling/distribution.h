#pragma once

#include <algorithm>
#include <cstdint>
#include <vector>

#include "math/vec.h"

namespace raykiln {

/// Discrete distribution with O(1) sampling (alias method, Vose 1991).
class AliasTable {
  public:
    AliasTable() = default;
    /// Probabilities proportional to `weights`; uniform if they are all 0.
    explicit AliasTable(const std::vector<float>& weights);

    /// An index drawn with a number in [0, 1); `remapped` is a fresh uniform number from
    /// the rest.
    std::uint32_t sample(float u, float& remapped) const {
        const float scaled = u * static_cast<float>(cells_.size());
        const auto cell = std::min(static_cast<std::uint32_t>(scaled),
                                   static_cast<std::uint32_t>(cells_.size() - 1));
        const float rest = std::min(scaled - static_cast<float>(cell), one_minus_epsilon);
        const Cell& c = cells_[cell];
        const bool keep = rest < c.threshold;
        remapped =
            keep ? rest / c.threshold : (rest - c.threshold) / (1.0f - c.threshold);
        remapped = std::min(remapped, one_minus_epsilon);
        return keep ? cell : c.alias;
    }
    float pmf(std::uint32_t index) const { return cells_[index].pmf; }
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
    Vec2f sample(float u, float v, float& pdf) const;
    /// Density at a point of the unit square (integrates to 1).
    float pdf(Vec2f point) const;
    bool empty() const { return width_ == 0; }

  private:
    int width_ = 0, height_ = 0;
    std::vector<float> density_;
    std::vector<float> row_cdf_;     // height + 1
    std::vector<float> column_cdf_;  // (width + 1) a row
};

}  // namespace raykiln
