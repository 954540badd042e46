#pragma once

#include <cstdint>
#include <vector>

#include "math/bounds.h"
#include "math/gather.h"

namespace raykiln {

/// Where light comes from and which way it may go: positions within `bounds`, emission
/// within angle `theta_e` of normals that lie within angle `theta_o` of `axis`.
struct LightBounds {
    Bounds bounds;
    float power = 0.0f;
    Vec3f axis{0, 0, 1};
    float cos_theta_o = 1.0f, cos_theta_e = 0.0f;
    bool two_sided = false;
};

/// A point to be lit. With a normal, only light from its side counts; (0, 0, 0) = from
/// all sides.
template <class F>
struct LightReceiverOf {
    Vec3<F> p;
    Vec3<F> normal{};
};
using LightReceiver = LightReceiverOf<float>;

template <class F>
struct LightChoiceOf {
    Uint<F> light;
    F pmf;  ///< 0: no light reaches the receiver
};

/// A bounding volume hierarchy over lights for choosing one by its likely contribution,
/// in time logarithmic in their number (Conty Estevez and Kulla 2018, "Importance
/// Sampling of Many Lights with Adaptive Tree Splitting"; single choice with one random
/// number).
class LightTree {
  public:
    using Choice = LightChoiceOf<float>;

    LightTree() = default;
    explicit LightTree(const std::vector<LightBounds>& lights);

    bool empty() const { return nodes_.empty(); }
    /// Light 0 with probability 0 where nothing reaches the receiver.
    template <class F>
    LightChoiceOf<F> sample(const LightReceiverOf<F>& receiver, F u) const;
    /// The probability with which `sample` returns a light; 0 for those not in the tree.
    template <class F>
    F pmf(const LightReceiverOf<F>& receiver, Uint<F> light) const;

  private:
    // Children of node i lie at `child` and `child + 1`; a leaf has no child but a light.
    struct Node {
        Vec3f center;
        float radius2;
        Vec3f axis;
        float cos_theta_o, cos_theta_e;
        float power;  // negative: emits to both sides
        std::uint32_t child, parent, light;
        std::uint32_t unused[3] = {};  // a node fills a cache line
    };
    static constexpr std::uint32_t none = 0xffffffffu;

    template <class F>
    Uint<F> word(std::uint32_t Node::* member, Uint<F> index) const {
        return gather_member<F>(nodes_.data(), member, index);
    }
    template <class F>
    F importance(Uint<F> index, const LightReceiverOf<F>& receiver) const;
    void make_node(std::uint32_t index, const LightBounds& bounds, std::uint32_t parent);
    void build(std::uint32_t index, std::vector<std::uint32_t>& order, std::size_t begin,
               std::size_t end, const std::vector<LightBounds>& lights);

    std::vector<Node> nodes_;
    std::vector<std::uint32_t> leaf_of_light_;
};

namespace detail {

/// cos(max(0, a - b)) for angles given by their cosines and sines.
template <class F>
inline F cos_of_difference(F sin_a, F cos_a, F sin_b, F cos_b) {
    return select(cos_a > cos_b, F(1.0f), cos_a * cos_b + sin_a * sin_b);
}
template <class F>
inline F sin_of_difference(F sin_a, F cos_a, F sin_b, F cos_b) {
    return select(cos_a > cos_b, F(0.0f), sin_a * cos_b - cos_a * sin_b);
}

}  // namespace detail

/// An estimate of what a cluster contributes: power over distance squared, times the
/// cosine at the receiver, as if its lights filled its bounds, and the greatest cosine at
/// the lights. 0 only where no part of it can contribute.
template <class F>
inline F LightTree::importance(Uint<F> index, const LightReceiverOf<F>& r) const {
    using detail::cos_of_difference;
    using detail::sin_of_difference;
    // Cosines are rounded: a light that only just reaches the receiver must keep a
    // chance.
    const F angle_slack(1e-4f);
    const F least_cosine(0.01f);
    // Near the root all lanes look at one node.
    const std::uint32_t first = first_lane(index);
    const bool same = all(index == Uint<F>(first));
    const auto number = [&](float Node::* member) {
        return same ? F(nodes_[first].*member)
                    : gather_member<F>(nodes_.data(), member, index);
    };
    const auto vector = [&](Vec3f Node::* member) {
        if (!same) {
            return gather_member<F>(nodes_.data(), member, index);
        }
        const Vec3f& v = nodes_[first].*member;
        return Vec3<F>{F(v.x), F(v.y), F(v.z)};
    };
    const F radius2 = number(&Node::radius2);
    const F signed_power = number(&Node::power);
    const F power = abs(signed_power);
    const Vec3<F> d = vector(&Node::center) - r.p;
    const F distance2 = length_squared(d);
    const Vec3<F> direction = d * (F(1.0f) / sqrt(max(distance2, F(1e-30f))));
    const auto inside = distance2 <= radius2;
    const F sin2_b = select(inside, F(0.0f), radius2 / distance2);
    const F sin_b = sqrt(sin2_b);
    const F cos_b = select(inside, F(-1.0f), safe_sqrt(F(1.0f) - sin2_b));

    const F cos_axis = F(0.0f) - dot(vector(&Node::axis), direction);
    const auto two_sided = signed_power < F(0.0f);
    const F cos_w = select(two_sided, abs(cos_axis), cos_axis);
    const F sin_w = safe_sqrt(F(1.0f) - cos_w * cos_w);
    const F cos_o = number(&Node::cos_theta_o);
    const F sin_o = safe_sqrt(F(1.0f) - cos_o * cos_o);
    const F cos_x = cos_of_difference(sin_w, cos_w, sin_o, cos_o);
    const F sin_x = sin_of_difference(sin_w, cos_w, sin_o, cos_o);
    const F cos_e = cos_of_difference(sin_x, cos_x, sin_b, cos_b);
    const auto emits = inside | (cos_e > number(&Node::cos_theta_e) - angle_slack);
    // How far its lights lie from its middle, squared, if they fill the box: what keeps
    // the estimates finite within a cluster, and smooth about it.
    const F spread2 = max(radius2 * F(0.125f), F(1e-20f));
    const F weight = power * max(select(inside, F(1.0f), cos_e), least_cosine) /
                     max(distance2, spread2);
    // The mean of the cosine over the part of the cluster above the horizon.
    const F height = dot(r.normal, d);
    const F cosine =
        F(0.5f) * (height + sqrt(height * height + spread2)) / sqrt(distance2 + spread2);
    const auto above = height + sqrt(radius2) > F(0.0f) - angle_slack * sqrt(distance2);
    const F reached = select(above, max(cosine, least_cosine), F(0.0f));
    const auto any_side = max_abs(r.normal) == F(0.0f);
    return select(emits, weight * select(any_side, F(1.0f), reached), F(0.0f));
}

template <class F>
inline LightChoiceOf<F> LightTree::sample(const LightReceiverOf<F>& receiver, F u) const {
    using U = Uint<F>;
    if (nodes_.empty()) {
        return {U(0u), F(0.0f)};
    }
    U node(0u);
    F pmf(1.0f);
    U child = word<F>(&Node::child, node);
    auto inner = child != U(none);
    while (any(inner)) {
        child = select(inner, child, U(0u));
        const F a = importance(child, receiver);
        const F b = importance(child + U(1u), receiver);
        const auto reached = a + b > F(0.0f);
        const F first = a / select(reached, a + b, F(1.0f));
        const auto left = u < first;
        const F share = select(left, first, F(1.0f) - first);
        const F rest = select(left, u, u - first) / share;
        u = select(inner, min(rest, F(one_minus_epsilon)), u);
        pmf = select(inner, select(reached, pmf * share, F(0.0f)), pmf);
        inner = inner & reached;
        node = select(inner, select(left, child, child + U(1u)), node);
        child = word<F>(&Node::child, node);
        inner = inner & (child != U(none));
    }
    return {select(pmf > F(0.0f), word<F>(&Node::light, node), U(0u)), pmf};
}

template <class F>
inline F LightTree::pmf(const LightReceiverOf<F>& receiver, Uint<F> light) const {
    using U = Uint<F>;
    if (nodes_.empty()) {
        return F(0.0f);
    }
    const U leaf = gather(leaf_of_light_.data(), light);
    const auto known = leaf != U(none);
    U index = select(known, leaf, U(0u));
    F pmf = select(known, F(1.0f), F(0.0f));
    U parent = word<F>(&Node::parent, index);
    auto inner = known & (parent != U(none));
    while (any(inner)) {
        parent = select(inner, parent, U(0u));
        // The root of a tree of one light has no child, but then no lane is here.
        const U child = select(inner, word<F>(&Node::child, parent), U(0u));
        const F a = importance(child, receiver);
        const F b = importance(child + U(1u), receiver);
        const auto reached = a + b > F(0.0f);
        const F first = a / select(reached, a + b, F(1.0f));
        const F share = select(index == child, first, F(1.0f) - first);
        pmf = select(inner, select(reached, pmf * share, F(0.0f)), pmf);
        inner = inner & reached;
        index = select(inner, parent, index);
        parent = word<F>(&Node::parent, index);
        inner = inner & (parent != U(none));
    }
    return pmf;
}

}  // namespace raykiln
