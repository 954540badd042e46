#include "sampling/block_distribution.h"

#include <algorithm>
#include <bit>

namespace raykiln {

namespace {

/// Running sums of n weights scaled to end at 1; returns their total.
template <class Weight>
double fill_cdf(const Weight* weights, std::uint32_t n, float* cdf) {
    double total = 0;
    for (std::uint32_t i = 0; i < n; ++i) {
        total += weights[i];
    }
    double running = 0;
    cdf[0] = 0.0f;
    for (std::uint32_t i = 0; i < n; ++i) {
        running += total > 0 ? weights[i] / total : 1.0 / n;
        cdf[i + 1] = static_cast<float>(running);
    }
    cdf[n] = 1.0f;
    return total;
}

/// The cells of a cdf that hold i / parts and (i + 1) / parts, in the halves of a word.
void fill_guide(const float* cdf, std::uint32_t n, std::uint32_t parts,
                std::uint32_t* guide) {
    std::uint32_t cell = 0;
    for (std::uint32_t i = 0; i <= parts; ++i) {
        const float u = static_cast<float>(i) / static_cast<float>(parts);
        while (cell + 1 < n && cdf[cell + 1] <= u) {
            ++cell;
        }
        if (i > 0) {
            guide[i - 1] |= cell << 16;
        }
        if (i < parts) {
            guide[i] = cell;
        }
    }
}

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
    row_cdfs_.resize((h + rows_) * columns);
    column_cdfs_.resize((w + columns) * h);
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
                row_sums.push_back(
                    fill_cdf(&weights[y * w + left], n,
                             &column_cdfs_[y * (w + columns) + left + column]));
            }
            float* row_cdf =
                &row_cdfs_[(top + row) * columns + column * (bottom - top + 1)];
            masses_.push_back(fill_cdf(
                row_sums.data(), static_cast<std::uint32_t>(bottom - top), row_cdf));
            // The density that `sample` really has, from the rounded tables.
            for (std::size_t y = top; y < bottom; ++y) {
                const float p_row = row_cdf[y - top + 1] - row_cdf[y - top];
                const float* cdf = &column_cdfs_[y * (w + columns) + left + column];
                for (std::size_t x = 0; x < n; ++x) {
                    density_[y * w + left + x] = p_row * (cdf[x + 1] - cdf[x]) * cells;
                }
            }
        }
    }
}

void BlockDistribution::add_view(const std::vector<double>& block_weights) {
    std::vector<double> row_sums(rows_);
    const std::size_t cdfs = view_cdfs_.size(), words = view_guides_.size();
    view_cdfs_.resize(cdfs + cdf_of(1u, 0u));
    view_guides_.resize(words + guide_of(1u, 0u));
    const auto fill = [&](const double* weights, std::uint32_t n, std::uint32_t line) {
        float* cdf = &view_cdfs_[cdfs + cdf_of(0u, line)];
        const double total = fill_cdf(weights, n, cdf);
        fill_guide(cdf, n, guides, &view_guides_[words + guide_of(0u, line)]);
        return total;
    };
    for (std::uint32_t row = 0; row < rows_; ++row) {
        row_sums[row] = fill(&block_weights[static_cast<std::size_t>(row) * columns_],
                             columns_, row + 1);
    }
    fill(row_sums.data(), rows_, 0);
    const float* row_cdf = &view_cdfs_[cdfs];
    for (std::uint32_t row = 0; row < rows_; ++row) {
        const float* cdf = &view_cdfs_[cdfs + cdf_of(0u, row + 1)];
        for (std::uint32_t column = 0; column < columns_; ++column) {
            probability_.push_back((row_cdf[row + 1] - row_cdf[row]) *
                                   (cdf[column + 1] - cdf[column]));
        }
    }
}

}  // namespace raykiln
