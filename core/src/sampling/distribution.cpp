#include "sampling/distribution.h"

#include <numeric>

namespace raykiln {

AliasTable::AliasTable(const std::vector<float>& weights) : cells_(weights.size()) {
    const std::size_t n = weights.size();
    const double sum = std::accumulate(weights.begin(), weights.end(), 0.0);
    std::vector<double> scaled(n);
    for (std::size_t i = 0; i < n; ++i) {
        const double p = sum > 0 ? weights[i] / sum : 1.0 / static_cast<double>(n);
        cells_[i] = {1.0f, static_cast<float>(p), static_cast<std::uint32_t>(i)};
        scaled[i] = p * static_cast<double>(n);
    }
    std::vector<std::uint32_t> small, large;
    for (std::uint32_t i = 0; i < n; ++i) {
        (scaled[i] < 1.0 ? small : large).push_back(i);
    }
    while (!small.empty() && !large.empty()) {
        const std::uint32_t s = small.back(), l = large.back();
        small.pop_back();
        cells_[s].threshold = static_cast<float>(scaled[s]);
        cells_[s].alias = l;
        scaled[l] -= 1.0 - scaled[s];
        if (scaled[l] < 1.0) {
            large.pop_back();
            small.push_back(l);
        }
    }
}

namespace {

/// Running sums of n weights scaled to end at 1; returns their total.
double fill_cdf(const float* weights, int n, float* cdf) {
    double total = 0;
    for (int i = 0; i < n; ++i) {
        total += weights[i];
    }
    double running = 0;
    cdf[0] = 0.0f;
    for (int i = 0; i < n; ++i) {
        running += total > 0 ? weights[i] / total : 1.0 / n;
        cdf[i + 1] = static_cast<float>(running);
    }
    cdf[n] = 1.0f;
    return total;
}

/// Appends the cells of a cdf that hold 0, 1 / parts, ... 1.
void add_guide(const float* cdf, int n, std::uint32_t parts,
               std::vector<std::uint32_t>& guide) {
    int cell = 0;
    for (std::uint32_t i = 0; i <= parts; ++i) {
        const float u = static_cast<float>(i) / static_cast<float>(parts);
        while (cell + 1 < n && cdf[cell + 1] <= u) {
            ++cell;
        }
        guide.push_back(static_cast<std::uint32_t>(cell));
    }
}

}  // namespace

Distribution2D::Distribution2D(const std::vector<float>& weights, int width, int height) :
    width_(width),
    height_(height),
    density_(weights.size()),
    row_cdf_(static_cast<std::size_t>(height) + 1),
    column_cdf_((static_cast<std::size_t>(width) + 1) *
                static_cast<std::size_t>(height)) {
    std::vector<float> row_sums(static_cast<std::size_t>(height));
    for (int y = 0; y < height; ++y) {
        const auto row = static_cast<std::size_t>(y);
        row_sums[row] = static_cast<float>(
            fill_cdf(&weights[row * static_cast<std::size_t>(width)], width,
                     &column_cdf_[row * (static_cast<std::size_t>(width) + 1)]));
    }
    fill_cdf(row_sums.data(), height, row_cdf_.data());
    add_guide(row_cdf_.data(), height, guides, row_guide_);
    for (std::size_t row = 0; row < static_cast<std::size_t>(height); ++row) {
        add_guide(&column_cdf_[row * (static_cast<std::size_t>(width) + 1)], width,
                  guides, column_guide_);
    }
    // The density that `sample` really has, from the rounded tables.
    const float cells = static_cast<float>(width) * static_cast<float>(height);
    for (int y = 0; y < height; ++y) {
        const auto row = static_cast<std::size_t>(y);
        const float p_row = row_cdf_[row + 1] - row_cdf_[row];
        const float* cdf = &column_cdf_[row * (static_cast<std::size_t>(width) + 1)];
        for (int x = 0; x < width; ++x) {
            density_[row * static_cast<std::size_t>(width) +
                     static_cast<std::size_t>(x)] = p_row * (cdf[x + 1] - cdf[x]) * cells;
        }
    }
}

}  // namespace raykiln
