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

}  // namespace raykiln
