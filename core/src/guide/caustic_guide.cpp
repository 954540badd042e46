#include "guide/caustic_guide.h"

#include <algorithm>

namespace raykiln {

namespace {

constexpr std::size_t photons_a_cell = 16;
/// Half the share that goes to the guide at a point where it knows of strong light.
constexpr float greatest_share = 0.5f;
/// Of the lights' own irradiance: where light focused is as faint as this, the share is
/// half of the greatest.
constexpr float faint = 0.01f;
constexpr float least_share = 0.01f;
/// Lobes are no narrower than this: a quarter of a degree.
constexpr float least_width = 1e-5f;

float component(const Vec3f& v, std::uint32_t axis) {
    return axis == 0 ? v.x : axis == 1 ? v.y : v.z;
}

}  // namespace

CausticGuide::CausticGuide(std::vector<Photon> photons, float irradiance) :
    photons_(std::move(photons)),
    irradiance_(irradiance) {
    if (photons_.size() < photons_a_cell) {
        return;
    }
    nodes_.emplace_back();
    divide(0, 0, photons_.size());
    for (const Cell& cell : cells_) {
        bounds_.add(cell.low);
        bounds_.add(cell.high);
    }
    photons_ = {};
}

/// Halves the photons along the longest side of their bounds until few are left.
void CausticGuide::divide(std::uint32_t node, std::size_t begin, std::size_t end) {
    if (end - begin <= photons_a_cell) {
        add_cell(node, begin, end);
        return;
    }
    Bounds bounds;
    for (std::size_t i = begin; i < end; ++i) {
        bounds.add(photons_[i].p);
    }
    const Vec3f extent = bounds.extent();
    const std::uint32_t axis = extent.x >= max(extent.y, extent.z) ? 0
                               : extent.y >= extent.z              ? 1
                                                                   : 2;
    const std::size_t middle = begin + (end - begin) / 2;
    const auto first = photons_.begin();
    const auto at = [&](std::size_t i) { return first + static_cast<std::ptrdiff_t>(i); };
    // Stable, so that photons at one coordinate have one order on every machine.
    std::stable_sort(at(begin), at(end), [&](const Photon& a, const Photon& b) {
        return component(a.p, axis) < component(b.p, axis);
    });
    const float split = 0.5f * (component(photons_[middle - 1].p, axis) +
                                component(photons_[middle].p, axis));
    const auto child = static_cast<std::uint32_t>(nodes_.size());
    nodes_[node] = {split, axis, child};
    nodes_.resize(nodes_.size() + 2);
    divide(child, begin, middle);
    divide(child + 1, middle, end);
}

void CausticGuide::add_cell(std::uint32_t node, std::size_t begin, std::size_t end) {
    const std::size_t count = end - begin;
    Bounds bounds;
    for (std::size_t i = begin; i < end; ++i) {
        bounds.add(photons_[i].p);
    }
    // Half a photon's distance more on each side; the flat side gets some thickness.
    const Vec3f extent = bounds.extent();
    const float longest = max_component(extent);
    const float middle = extent.x + extent.y + extent.z - longest -
                         min(extent.x, min(extent.y, extent.z));
    const float margin = 0.25f * longest;
    bounds.add(bounds.low - Vec3f(margin));
    bounds.add(bounds.high + Vec3f(margin));

    const float area = max(longest * middle, 1e-12f);
    const float relative = static_cast<float>(count) / (area * irradiance_);
    const float share = greatest_share * relative / (relative + faint);
    nodes_[node] = {0.0f, leaf_axis, static_cast<std::uint32_t>(cells_.size())};
    cells_.push_back({bounds.low, share < least_share ? 0.0f : share, bounds.high,
                      (static_cast<std::uint32_t>(lobes_.size()) << count_bits) |
                          static_cast<std::uint32_t>(count)});
    for (std::size_t i = begin; i < end; ++i) {
        // As wide as it is far to the third neighbour.
        std::vector<float> t;
        for (std::size_t k = begin; k < end; ++k) {
            t.push_back(0.5f *
                        length_squared(photons_[i].direction - photons_[k].direction));
        }
        const auto third = t.begin() + static_cast<std::ptrdiff_t>(std::min(count - 1, std::size_t{3}));
        std::nth_element(t.begin(), third, t.end());
        lobes_.push_back({photons_[i].direction, max(*third, least_width)});
    }
}

}  // namespace raykiln
