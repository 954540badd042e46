#include "sampling/block_distribution.h"

#include <algorithm>
#include <bit>

namespace raykiln {

namespace {

/// Where each of `parts` even parts of n cells begins, and the part of each cell.
std::vector<std::uint32_t> starts_of_parts(std::uint32_t n, std::uint32_t parts,
                                           std::vector<std::uint32_t>& part_of_cell) {
    std::vector<std::uint32_t> starts;
    for (std::uint64_t i = 0; i <= parts; ++i) {
        starts.push_back(static_cast<std::uint32_t>(i * n / parts));
    }
    for (std::uint32_t i = 0; i < parts; ++i) {
        part_of_cell.insert(part_of_cell.end(), starts[i + 1] - starts[i], i);
    }
    return starts;
}

}  // namespace

BlockDistribution::BlockDistribution(const std::vector<float>& weights, int width,
                                     int height) :
    width_(static_cast<std::uint32_t>(width)),
    height_(static_cast<std::uint32_t>(height)),
    columns_(std::min<std::uint32_t>(width_, most_columns)),
    rows_(std::min<std::uint32_t>(height_, most_rows)),
    column_starts_(starts_of_parts(width_, columns_, column_of_cell_)),
    row_starts_(starts_of_parts(height_, rows_, row_of_cell_)) {
    const std::size_t w = width_, h = height_, columns = columns_;
    row_cdfs_.resize(rows_ * columns * Cdf::floats_for(tallest()));
    column_cdfs_.resize(h * columns * Cdf::floats_for(widest()));
    density_.resize(w * h);
    std::vector<double> row_sums;
    const float cells = static_cast<float>(width) * static_cast<float>(height);
    for (std::size_t row = 0; row < rows_; ++row) {
        const std::size_t top = row_starts_[row], bottom = row_starts_[row + 1];
        for (std::size_t column = 0; column < columns; ++column) {
            const std::size_t left = column_starts_[column];
            const std::uint32_t n = column_starts_[column + 1] - column_starts_[column];
            row_sums.clear();
            for (std::size_t y = top; y < bottom; ++y) {
                row_sums.push_back(Cdf::fill(&weights[y * w + left], n,
                                             &column_cdfs_[column_cdf(y, column)]));
            }
            float* rows = &row_cdfs_[row_cdf(row, column)];
            masses_.push_back(Cdf::fill(row_sums.data(),
                                        static_cast<std::uint32_t>(bottom - top), rows));
            // The density that `sample` really has, from the rounded tables.
            for (std::size_t y = top; y < bottom; ++y) {
                const float p_row = Cdf::probability(rows, y - top);
                const float* cdf = &column_cdfs_[column_cdf(y, column)];
                for (std::size_t x = 0; x < n; ++x) {
                    density_[y * w + left + x] = p_row * Cdf::probability(cdf, x) * cells;
                }
            }
        }
    }
}

void BlockDistribution::add_view(const std::vector<double>& block_weights) {
    std::vector<double> row_sums(rows_);
    const std::size_t begin = view_cdfs_.size();
    view_cdfs_.resize(begin + view_cdf(1u, 0u));
    for (std::uint32_t row = 0; row < rows_; ++row) {
        row_sums[row] =
            Cdf::fill(&block_weights[static_cast<std::size_t>(row) * columns_], columns_,
                      &view_cdfs_[begin + view_cdf(0u, row + 1)]);
    }
    const float* rows = &view_cdfs_[begin];
    Cdf::fill(row_sums.data(), rows_, &view_cdfs_[begin]);
    for (std::uint32_t row = 0; row < rows_; ++row) {
        const float* cdf = &view_cdfs_[begin + view_cdf(0u, row + 1)];
        for (std::uint32_t column = 0; column < columns_; ++column) {
            probability_.push_back(Cdf::probability(rows, row) *
                                   Cdf::probability(cdf, column));
        }
    }
}

}  // namespace raykiln
