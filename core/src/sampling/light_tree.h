#pragma once

#include <cstdint>
#include <vector>

#include "math/bounds.h"
#include "math/gather.h"
#include "memory/pages.h"

namespace raykiln {

/// Where light comes from and which way it may go: positions within `bounds`, emission
/// within angle `theta_e` of normals that lie within angle `theta_o` of `axis`.
struct LightBounds {
    Bounds bounds;
    float power = 0.0f;
    Vec3f axis{0, 0, 1};
    float cos_theta_o = 1.0f, cos_theta_e = 0.0f;
    bool two_sided = false;
    float radiance = infinity;  ///< luminance of the surface; infinity: there is none
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
    /// Whether all lights look small from there (`LightTree::small_share`).
    Mask<F> small = Mask<F>(false);
};

/// A bounding volume hierarchy over lights for choosing one by its likely contribution,
/// in time logarithmic in their number (after Conty Estevez and Kulla 2018, "Importance
/// Sampling of Many Lights with Adaptive Tree Splitting"; single choice with one random
/// number). Nodes have four children: fewer estimates are made on the way to a light than
/// with two, and less is lost by those that are off.
class LightTree {
  public:
    using Choice = LightChoiceOf<float>;

    LightTree() = default;
    explicit LightTree(const std::vector<LightBounds>& lights);

    bool empty() const { return nodes_.empty(); }
    /// Lights that may be chosen.
    std::size_t size() const { return size_; }

    /// Lights look small where all of them, seen or not, fill less than this part of what
    /// a diffuse surface sees, by its cosine: each is then sampled at 1 / small_share
    /// times the surface's own density or more, and the power heuristic leaves samples of
    /// the surface less than a weight of small_share², whatever they meet. Known by the
    /// estimates at the root, and only at some distance from the lights: nearer, one of
    /// them could count for more than that tells.
    static constexpr float small_share = 0.1f;

    /// Neighbours in the tree have like places, which are less than this.
    static constexpr std::uint32_t places = 256;
    /// Any place for lights not in the tree; the index must be valid.
    template <class F>
    Uint<F> place(Uint<F> light) const {
        return gather(place_of_light_.data(), light);
    }
    /// Light 0 with probability 0 where nothing reaches the receiver.
    template <class F>
    LightChoiceOf<F> sample(const LightReceiverOf<F>& receiver, F u) const;
    /// The probability with which `sample` returns a light, to the last bit; 0 for those
    /// not in the tree.
    template <class F>
    F pmf(const LightReceiverOf<F>& receiver, Uint<F> light) const;

  private:
    /// What is known of a light or of many, in 32 bytes. Two numbers share a word, the
    /// first as a float whose low bits are noise, the second as the upper half of one.
    template <class F>
    struct ClusterOf {
        Vec3<F> center;
        Uint<F> amplitude_aside;  ///< sum of the intensities, 0: nothing here; `aside`
        Uint<F> axis_xy;          ///< unit
        Uint<F> axis_z_forward;
        Uint<F> radius_reach;  ///< second half: bytes `behind`, `lean`
        Uint<F> next;          ///< a node; or a light, with `is_light` set
    };
    using Cluster = ClusterOf<float>;
    struct alignas(64) Node {
        Cluster child[4];
    };
    /// Contributions of the children of a node, and where they lead.
    template <class F>
    struct Weighed {
        F weight[4];
        Uint<F> next[4];
    };
    struct Builder;

    static constexpr std::uint32_t none = 0xffffffffu;
    static constexpr std::uint32_t is_light = 0x80000000u;
    // Scales of the bytes.
    static constexpr float lean_step = 2.02f / 255.0f, behind_step = 2.75f / 255.0f;

    template <class F>
    static F contribution(const ClusterOf<F>& cluster, const LightReceiverOf<F>& receiver,
                          F any_side);
    template <class F>
    void weigh(Uint<F> node, const LightReceiverOf<F>& receiver, F any_side,
               Weighed<F>& out) const;

    std::vector<Node, PageAllocator<Node>> nodes_;
    // Which child leads to a light, two bits a node from the root on.
    std::vector<std::uint32_t, PageAllocator<std::uint32_t>> path_of_light_,
        place_of_light_;
    std::size_t size_ = 0;
    // While its lights are small, the estimates at the root are in all less than this for
    // a receiver farther than `clearance_` from the bounds of the lights.
    float small_total_ = 0.0f, clearance_ = 0.0f;
    Bounds bounds_;
};

namespace detail {

// By the bits of the exponent: the same on every processor, as instructions for it are
// not.

/// sqrt(x) to within 4 %, for x >= 0.
template <class F>
inline F rough_sqrt(F x) {
    return as_float((as_uint(x) >> 1) + Uint<F>(0x1fbb4f2eu));
}
/// 1 / sqrt(x) to within a thousandth, for x > 0: with one step of Newton's method
/// (constants of Moroz et al. 2018).
template <class F>
inline F rough_rsqrt(F x) {
    const F y = as_float(Uint<F>(0x5f376908u) - (as_uint(x) >> 1));
    return y * (F(1.50087896f) - F(0.5f) * x * y * y);
}

/// 1 where light from all sides counts, else 0.
template <class F>
inline F any_side_of(const LightReceiverOf<F>& receiver) {
    return select(max_abs(receiver.normal) == F(0.0f), F(1.0f), F(0.0f));
}

}  // namespace detail

/// An estimate of what a cluster contributes: intensity over distance squared, times the
/// cosine at the receiver, as if its lights filled its bounds. 0 only where no part of it
/// can contribute.
template <class F>
inline F LightTree::contribution(const ClusterOf<F>& c, const LightReceiverOf<F>& r,
                                 F any_side) {
    using U = Uint<F>;
    using detail::rough_rsqrt;
    using detail::rough_sqrt;
    const F slack(1e-3f);         // of what is rounded here
    const F least_cosine(0.02f);  // twice the cosine, as all of them below
    const auto first = [](U pair) { return as_float(pair); };
    const auto second = [](U pair) { return as_float(pair << 16); };
    const F radius = first(c.radius_reach);
    // How far its lights lie from its middle, squared, if they fill the box: what keeps
    // the estimates finite within a cluster, and smooth about it.
    const F spread2 = radius * radius * F(0.125f);
    const Vec3<F> d = c.center - r.p;
    const F distance2 = length_squared(d);
    const F about2 = distance2 + spread2;
    const F inverse = rough_rsqrt(about2);
    const F distance = about2 * inverse;

    const F to_axis = F(0.0f) - dot(d, Vec3<F>{first(c.axis_xy), second(c.axis_xy),
                                               first(c.axis_z_forward)});
    const F lean = to_float(c.radius_reach & U(0xffu)) * F(lean_step) - F(1.0f);
    const F behind =
        to_float(c.radius_reach & U(0xff00u)) * F(behind_step / 256.0f) * radius;
    const auto emits = to_axis + lean * distance + behind > F(0.0f);
    const F forward = second(c.axis_z_forward), aside = second(c.amplitude_aside);
    const F even2 = (F(1.0f) - F(3.0f) * aside) * to_axis * to_axis + aside * distance2 +
                    F(0.125f) * behind * behind;
    const F emitted = max((forward * to_axis + rough_sqrt(max(even2, F(0.0f)))) * inverse,
                          least_cosine);

    // The mean of the cosine over the part of the cluster above the horizon.
    const F height = dot(r.normal, d);
    const F across2 = height * height + spread2 + any_side * distance2;
    const F received = max((height + rough_sqrt(across2)) * inverse, least_cosine);
    const auto above = height + radius + slack * distance > F(0.0f);
    const F amplitude = first(c.amplitude_aside);
    return select(emits & above, amplitude * inverse * inverse * (emitted * received),
                  F(0.0f));
}

/// Not inlined: the same instructions, and so the same bits, for `sample` and `pmf`.
template <class F>
[[gnu::noinline]] inline void LightTree::weigh(Uint<F> node,
                                               const LightReceiverOf<F>& receiver,
                                               F any_side, Weighed<F>& out) const {
    using U = Uint<F>;
    // Near the root all lanes look at one node.
    const std::uint32_t first = first_lane(node);
    const bool same = all(node == U(first));
    for (int i = 0; i < 4; ++i) {
        ClusterOf<F> c;
        if (same) {
            const Cluster& one = nodes_[first].child[i];
            if (one.amplitude_aside == 0) {
                out.weight[i] = F(0.0f);
                out.next[i] = U(0u);
                continue;
            }
            c = {{F(one.center.x), F(one.center.y), F(one.center.z)},
                 U(one.amplitude_aside),
                 U(one.axis_xy),
                 U(one.axis_z_forward),
                 U(one.radius_reach),
                 U(one.next)};
        } else {
            const auto row = gather_row<F, 8>(nodes_.data(), node, 8 * i);
            c = {{row[0], row[1], row[2]}, as_uint(row[3]), as_uint(row[4]),
                 as_uint(row[5]),          as_uint(row[6]), as_uint(row[7])};
        }
        out.weight[i] = contribution(c, receiver, any_side);
        out.next[i] = c.next;
    }
}

template <class F>
inline LightChoiceOf<F> LightTree::sample(const LightReceiverOf<F>& receiver, F u) const {
    using U = Uint<F>;
    if (nodes_.empty()) {
        return {U(0u), F(0.0f)};
    }
    const F any_side = detail::any_side_of(receiver);
    U node(0u), light(0u);
    F pmf(1.0f);
    Mask<F> inner(true), small(false);
    Weighed<F> w;
    for (bool at_root = true; any(inner); at_root = false) {
        weigh(node, receiver, any_side, w);
        // Running sums; u < 1, so that `at` stays below the last.
        F below(0.0f), chosen = w.weight[0], sum = w.weight[0];
        U next = w.next[0];
        const F sum1 = sum + w.weight[1], sum2 = sum1 + w.weight[2];
        const F total = sum2 + w.weight[3];
        const F at = u * total;
        if (at_root) {
            small = (total < F(small_total_)) &
                    (distance_squared(bounds_, receiver.p) > F(sqr(clearance_)));
        }
        const auto step = [&](F begin, int i) {
            const auto past = at >= begin;
            below = select(past, begin, below);
            chosen = select(past, w.weight[i], chosen);
            next = select(past, w.next[i], next);
        };
        step(sum, 1);
        step(sum1, 2);
        step(sum2, 3);
        const auto reached = total > F(0.0f);
        const F share = chosen / select(reached, total, F(1.0f));
        const F rest = (at - below) / select(reached, chosen, F(1.0f));
        u = min(rest, F(one_minus_epsilon));
        pmf = select(inner, pmf * share, pmf);
        const auto found = inner & reached & ((next & U(is_light)) != U(0u));
        light = select(found, next & U(~is_light), light);
        inner = inner & reached & !found;
        node = select(inner, next, U(0u));
    }
    return {light, pmf, small};
}

template <class F>
inline F LightTree::pmf(const LightReceiverOf<F>& receiver, Uint<F> light) const {
    using U = Uint<F>;
    if (nodes_.empty()) {
        return F(0.0f);
    }
    const F any_side = detail::any_side_of(receiver);
    U path = gather(path_of_light_.data(), light);
    Mask<F> inner = path != U(none);
    F pmf = select(inner, F(1.0f), F(0.0f));
    U node(0u);
    Weighed<F> w;
    while (any(inner)) {
        weigh(node, receiver, any_side, w);
        const F total = ((w.weight[0] + w.weight[1]) + w.weight[2]) + w.weight[3];
        const U way = path & U(3u);
        F chosen = w.weight[0];
        U next = w.next[0];
        for (std::uint32_t i = 1; i < 4; ++i) {
            const auto here = way == U(i);
            chosen = select(here, w.weight[i], chosen);
            next = select(here, w.next[i], next);
        }
        const auto reached = total > F(0.0f);
        const F share = chosen / select(reached, total, F(1.0f));
        pmf = select(inner, pmf * share, pmf);
        inner = inner & reached & ((next & U(is_light)) == U(0u));
        node = select(inner, next, U(0u));
        path = path >> 2;
    }
    return pmf;
}

}  // namespace raykiln
