#include "sampling/light_tree.h"

#include <algorithm>
#include <array>
#include <numeric>

#include "math/elementary.h"

namespace raykiln {

namespace {

float sin_of(float cosine) {
    return safe_sqrt(1.0f - cosine * cosine);
}

/// The narrowest cone of directions that holds two cones.
void join_cones(LightBounds& a, const LightBounds& b) {
    if (a.two_sided && dot(a.axis, b.axis) < 0.0f) {
        // Both sides count, so either axis does.
        LightBounds turned = b;
        turned.axis = -b.axis;
        join_cones(a, turned);
        return;
    }
    const float angle_a = acos(a.cos_theta_o), angle_b = acos(b.cos_theta_o);
    const float between = acos(dot(a.axis, b.axis));
    if (min(between + angle_b, pi) <= angle_a) {
        return;
    }
    if (min(between + angle_a, pi) <= angle_b) {
        a.axis = b.axis;
        a.cos_theta_o = b.cos_theta_o;
        return;
    }
    const float joined = 0.5f * (angle_a + between + angle_b);
    const Vec3f aside = b.axis - a.axis * dot(a.axis, b.axis);
    if (joined >= pi || length_squared(aside) < 1e-12f) {
        a.cos_theta_o = -1.0f;
        return;
    }
    float sine, cosine;
    sin_cos_turns((joined - angle_a) * inv_two_pi, sine, cosine);
    a.axis = normalize(a.axis * cosine + normalize(aside) * sine);
    sin_cos_turns(joined * inv_two_pi, sine, cosine);
    a.cos_theta_o = cosine;
}

LightBounds joined(const LightBounds& a, const LightBounds& b) {
    if (a.bounds.empty()) {
        return b;
    }
    LightBounds sum = a;
    sum.bounds.add(b.bounds);
    sum.power += b.power;
    sum.two_sided = a.two_sided || b.two_sided;
    join_cones(sum, b);
    sum.cos_theta_e = min(a.cos_theta_e, b.cos_theta_e);
    return sum;
}

/// Cost of a cluster: its power, times the solid angle it emits into, times its surface
/// area.
float cluster_cost(const LightBounds& b, float regularity) {
    if (b.bounds.empty()) {
        return 0.0f;
    }
    const float theta_o = acos(b.cos_theta_o), theta_e = acos(b.cos_theta_e);
    const float theta_w = min(theta_o + theta_e, pi);
    const float sin_o = sin_of(b.cos_theta_o);
    float sine, cosine;
    sin_cos_turns((theta_o - 2.0f * theta_w) * inv_two_pi, sine, cosine);
    const float solid =
        two_pi * (1.0f - b.cos_theta_o) +
        0.5f * pi *
            (2.0f * theta_w * sin_o - cosine - 2.0f * theta_o * sin_o + b.cos_theta_o);
    const Vec3f d = b.bounds.extent();
    return b.power * solid * regularity * (d.x * d.y + d.y * d.z + d.z * d.x);
}

struct Split {
    float cost = infinity;
    int axis = -1;
    float position = 0.0f;
};

float component(const Vec3f& v, int axis) {
    return axis == 0 ? v.x : axis == 1 ? v.y : v.z;
}

/// The cheapest of the binned planes across the lights' centres.
Split best_split(const std::vector<std::uint32_t>& order, std::size_t begin,
                 std::size_t end, const std::vector<LightBounds>& lights,
                 const LightBounds& total, const Bounds& centers) {
    constexpr std::size_t bins = 12;
    const Vec3f size = total.bounds.extent();
    Split best;
    for (int axis = 0; axis < 3; ++axis) {
        const float low = component(centers.low, axis),
                    width = component(centers.extent(), axis);
        if (!(width > 0.0f)) {
            continue;
        }
        std::array<LightBounds, bins> bin;
        for (std::size_t i = begin; i < end; ++i) {
            const LightBounds& light = lights[order[i]];
            const float at = (component(light.bounds.center(), axis) - low) / width;
            const auto b = std::min(static_cast<std::size_t>(at * bins), bins - 1);
            bin[b] = joined(bin[b], light);
        }
        std::array<float, bins> above{};
        LightBounds run;
        const float regularity = max_component(size) / max(component(size, axis), 1e-20f);
        for (std::size_t b = bins - 1; b > 0; --b) {
            run = bin[b].bounds.empty() ? run : joined(run, bin[b]);
            above[b] = cluster_cost(run, regularity);
        }
        run = {};
        for (std::size_t b = 1; b < bins; ++b) {
            run = bin[b - 1].bounds.empty() ? run : joined(run, bin[b - 1]);
            const float cost = cluster_cost(run, regularity) + above[b];
            if (cost < best.cost) {
                best = {cost, axis, low + width * static_cast<float>(b) / bins};
            }
        }
    }
    return best;
}

}  // namespace

LightTree::LightTree(const std::vector<LightBounds>& lights) :
    leaf_of_light_(lights.size(), none) {
    std::vector<std::uint32_t> order;
    for (std::uint32_t i = 0; i < lights.size(); ++i) {
        if (lights[i].power > 0.0f) {
            order.push_back(i);
        }
    }
    if (order.empty()) {
        return;
    }
    nodes_.reserve(2 * order.size());
    nodes_.emplace_back();
    nodes_[0].parent = none;
    build(0, order, 0, order.size(), lights);
}

void LightTree::make_node(std::uint32_t index, const LightBounds& bounds,
                          std::uint32_t parent) {
    Node& node = nodes_[index];
    node.center = bounds.bounds.center();
    node.radius2 = 0.25f * length_squared(bounds.bounds.extent());
    node.axis = bounds.axis;
    node.cos_theta_o = bounds.cos_theta_o;
    node.cos_theta_e = bounds.cos_theta_e;
    node.power = bounds.two_sided ? -bounds.power : bounds.power;
    node.child = none;
    node.parent = parent;
    node.light = none;
}

void LightTree::build(std::uint32_t index, std::vector<std::uint32_t>& order,
                      std::size_t begin, std::size_t end,
                      const std::vector<LightBounds>& lights) {
    LightBounds total;
    Bounds centers;
    for (std::size_t i = begin; i < end; ++i) {
        total = joined(total, lights[order[i]]);
        centers.add(lights[order[i]].bounds.center());
    }
    make_node(index, total, nodes_[index].parent);
    if (end - begin == 1) {
        nodes_[index].light = order[begin];
        leaf_of_light_[order[begin]] = index;
        return;
    }
    const Split split = best_split(order, begin, end, lights, total, centers);
    auto middle = begin + (end - begin) / 2;
    if (split.axis >= 0) {
        const auto at = std::partition(order.begin() + static_cast<std::ptrdiff_t>(begin),
                                       order.begin() + static_cast<std::ptrdiff_t>(end),
                                       [&](std::uint32_t light) {
                                           return component(lights[light].bounds.center(),
                                                            split.axis) < split.position;
                                       });
        const auto split_at = static_cast<std::size_t>(at - order.begin());
        middle = split_at > begin && split_at < end ? split_at : middle;
    }
    const auto child = static_cast<std::uint32_t>(nodes_.size());
    nodes_.resize(nodes_.size() + 2);
    nodes_[index].child = child;
    nodes_[child].parent = nodes_[child + 1].parent = index;
    build(child, order, begin, middle, lights);
    build(child + 1, order, middle, end, lights);
}

}  // namespace raykiln
