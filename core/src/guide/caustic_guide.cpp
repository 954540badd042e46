#include "guide/caustic_guide.h"

#include <algorithm>

namespace raykiln {

namespace {

constexpr std::size_t photons_a_cell = 12;
/// A cell also knows some of the photons of the wider cell about it, for what its own few
/// missed.
constexpr std::size_t photons_around = 192;
constexpr std::size_t lobes_around = 8;
/// The share of the samples that goes to the guide where it knows of strong light.
constexpr float greatest_share = 0.4f;
/// The variance that focused light would have without a guide, against the square of the
/// lights' own irradiance, for which the share is half of that.
constexpr float half_share_variance = 0.05f;
/// A smaller share is not worth its time.
constexpr float least_share = 0.03f;
/// Lobes are twice as wide as it is far to this neighbour, and no narrower than a quarter
/// of a degree.
constexpr std::size_t neighbour = 3;
constexpr float least_width = 1e-5f;
/// Space is divided beside photons that this share of their extent cannot tell apart.
constexpr float least_gap = 1e-3f;

struct Cut {
    std::size_t middle;  ///< first of the upper half
    float split;
};

/// Moves the cut in halves that are in order about `middle` to beside what lies there: in
/// a flat surface, rounding would choose the side of its points.
Cut cut_beside(std::vector<Photon>& photons, std::size_t begin, std::size_t middle,
               std::size_t end, int axis, float gap) {
    const float x = component(photons[middle].p, axis);
    const auto first_from = [&](float least, std::size_t from, std::size_t to) {
        const auto at = photons.begin();
        const auto found = std::partition(
            at + static_cast<std::ptrdiff_t>(from), at + static_cast<std::ptrdiff_t>(to),
            [&](const Photon& p) { return component(p.p, axis) < least; });
        return static_cast<std::size_t>(found - at);
    };
    const std::size_t before = first_from(x - gap, begin, middle);
    const std::size_t behind = first_from(x + gap, middle, end);
    if (before > begin && (behind == end || middle - before <= behind - middle)) {
        return {before, x - gap};
    }
    return behind < end ? Cut{behind, x + gap} : Cut{middle, x};
}

}  // namespace

CausticGuide::CausticGuide(std::vector<Photon> photons, float irradiance,
                           float concentration) :
    photons_(std::move(photons)),
    irradiance_(irradiance),
    concentration_(concentration) {
    if (photons_.size() < photons_a_cell) {
        return;
    }
    for (const Photon& photon : photons_) {
        bounds_.add(photon.p);
    }
    const Vec3f margin(0.01f * max_component(bounds_.extent()));
    bounds_.add(bounds_.low - margin);
    bounds_.add(bounds_.high + margin);
    // Some more than there will be: moving them would take longer than building them.
    lobes_.reserve(photons_.size() * 5 / 2);
    nodes_.reserve(photons_.size() / 3);
    nodes_.emplace_back();
    divide(0, 0, photons_.size(), bounds_);
    photons_ = {};
    around_ = {};
    if (lobes_.empty()) {
        nodes_.clear();
    }
}

/// Halves the photons along the longest side of their bounds until few are left.
void CausticGuide::divide(std::uint32_t node, std::size_t begin, std::size_t end,
                          const Bounds& region) {
    const std::size_t count = end - begin;
    if (count <= photons_a_cell) {
        add_cell(node, begin, end, region);
        return;
    }
    Bounds bounds;
    for (std::size_t i = begin; i < end; ++i) {
        bounds.add(photons_[i].p);
    }
    const Vec3f extent = bounds.extent();
    const int axis = extent.x >= max(extent.y, extent.z) ? 0
                     : extent.y >= extent.z              ? 1
                                                         : 2;
    const std::size_t middle = begin + count / 2;
    const auto at = [&](std::size_t i) {
        return photons_.begin() + static_cast<std::ptrdiff_t>(i);
    };
    // Photons come in one order, whatever the threads: so equal ones fall alike, too.
    std::nth_element(at(begin), at(middle), at(end),
                     [axis](const Photon& a, const Photon& b) {
                         return component(a.p, axis) < component(b.p, axis);
                     });
    if (count <= photons_around && around_.empty()) {
        add_lobes(begin, end, (count + lobes_around - 1) / lobes_around, around_);
    }
    const auto [cut, split] = cut_beside(photons_, begin, middle, end, axis,
                                         least_gap * component(extent, axis));
    const auto child = static_cast<std::uint32_t>(nodes_.size());
    nodes_[node] = {split, static_cast<std::uint32_t>(axis), child};
    nodes_.resize(nodes_.size() + 2);
    Bounds lower = region, upper = region;
    component(lower.high, axis) = component(upper.low, axis) = split;
    divide(child, begin, cut, lower);
    if (count > photons_around) {
        around_.clear();  // of the lower half
    }
    divide(child + 1, cut, end, upper);
}

void CausticGuide::add_cell(std::uint32_t node, std::size_t begin, std::size_t end,
                            const Bounds& region) {
    const Vec3f extent = region.extent();
    const float longest = max_component(extent);
    const float least = min(extent.x, min(extent.y, extent.z));
    const float area = longest * (extent.x + extent.y + extent.z - longest - least);
    // Light seen in a mirror or a lens keeps its radiance: found by luck, its variance is
    // its irradiance times that.
    const float irradiance = static_cast<float>(end - begin) / max(area, 1e-12f);
    const float variance = irradiance / irradiance_ * concentration_;
    const float share = greatest_share * variance / (variance + half_share_variance);
    if (share < least_share) {
        nodes_[node] = {0.0f, cell_axis, 0};
        return;
    }
    const auto first = static_cast<std::uint32_t>(lobes_.size());
    add_lobes(begin, end, 1, lobes_);
    lobes_.insert(lobes_.end(), around_.begin(), around_.end());
    const auto lobes = static_cast<std::uint32_t>(lobes_.size()) - first;
    nodes_[node] = {share, cell_axis, (first << count_bits) | lobes};
}

/// Lobes about every `step`-th photon.
void CausticGuide::add_lobes(std::size_t begin, std::size_t end, std::size_t step,
                             Lobes& to) const {
    std::vector<float> t;
    for (std::size_t i = begin; i < end; i += step) {
        t.clear();
        for (std::size_t k = begin; k < end; k += step) {
            t.push_back(0.5f *
                        length_squared(photons_[i].direction - photons_[k].direction));
        }
        const auto third =
            t.begin() + static_cast<std::ptrdiff_t>(std::min(t.size() - 1, neighbour));
        std::nth_element(t.begin(), third, t.end());
        to.push_back({photons_[i].direction, max(2.0f * *third, least_width)});
    }
}

}  // namespace raykiln
