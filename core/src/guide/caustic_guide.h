#pragma once

#include <vector>

#include "math/bounds.h"
#include "math/frame.h"
#include "math/gather.h"
#include "memory/pages.h"
#include "sampling/warp.h"

namespace raykiln {

/// Light that arrived at a surface by way of smooth ones.
struct Photon {
    Vec3f p;
    Vec3f direction;  ///< unit, towards where it came from
};

/// What a guide knows at a point.
template <class F>
struct GuideAt {
    Uint<F> first{0u}, count{0u};  ///< of the directions
    F share{0.0f};                 ///< of the samples that should ask the guide
};

/// Directions from which focused light arrives, learned from photons (Jensen 1995,
/// "Importance Driven Path Tracing using the Photon Map"): space is divided until each
/// cell holds a few, and a cell's density is the mean of one lobe about the direction of
/// each of them and of some from around it. A lobe of width a has the density
///
///     a (a + 2) / (4 pi (t + a)^2),  t = 1 - cos of the angle to the photon,
///
/// over the whole sphere: half of it lies within about t = a, and its tails are long, as
/// light that the lobes miss is noise.
class CausticGuide {
  public:
    CausticGuide() = default;
    /// `irradiance`: that of the lights on the smooth surfaces, in photons a square
    /// metre; `concentration`: their radiance over their irradiance, one over the
    /// steradians that they fill. Both tell where focused light is worth looking for.
    /// What comes of it is a pure function of the arguments.
    CausticGuide(std::vector<Photon> photons, float irradiance, float concentration);

    bool empty() const { return nodes_.empty(); }
    std::size_t size() const { return lobes_.size(); }

    /// Where `wanted`; elsewhere no share.
    template <class F>
    GuideAt<F> find(const Vec3<F>& p, Mask<F> wanted) const;
    /// A unit direction in world space; lanes without a share get any.
    template <class F>
    Vec3<F> sample(const GuideAt<F>& at, F which, F u, F v) const;
    /// Density of `sample` over solid angle; 0 in lanes without a share.
    template <class F>
    F pdf(const GuideAt<F>& at, const Vec3<F>& direction) const;

  private:
    static constexpr std::uint32_t cell_axis = 3;
    /// A row of words. Where space is divided: at which coordinate, along which axis, and
    /// the first of two neighbouring nodes. A cell: the share, and its first lobe above
    /// their count.
    struct Node {
        float split_or_share;
        std::uint32_t axis;
        std::uint32_t child_or_lobes;
        std::uint32_t unused = 0;
    };
    struct Lobe {
        Vec3f direction;
        float width;
    };
    using Lobes = std::vector<Lobe, PageAllocator<Lobe>>;
    static constexpr std::uint32_t count_bits = 7;

    void divide(std::uint32_t node, std::size_t begin, std::size_t end,
                const Bounds& region);
    void add_cell(std::uint32_t node, std::size_t begin, std::size_t end,
                  const Bounds& region);
    void add_lobes(std::size_t begin, std::size_t end, std::size_t step, Lobes& to) const;

    std::vector<Photon> photons_;  // while it is built
    float irradiance_ = 0.0f, concentration_ = 0.0f;
    Bounds bounds_;
    std::vector<Node, PageAllocator<Node>> nodes_;
    Lobes lobes_;
    Lobes around_;  // while it is built: of the wider cell about the one at hand
};

template <class F>
inline GuideAt<F> CausticGuide::find(const Vec3<F>& p, Mask<F> wanted) const {
    using U = Uint<F>;
    if (empty()) {
        return {};
    }
    const Vec3f low = bounds_.low, high = bounds_.high;
    wanted = wanted & (p.x >= F(low.x)) & (p.x <= F(high.x)) & (p.y >= F(low.y)) &
             (p.y <= F(high.y)) & (p.z >= F(low.z)) & (p.z <= F(high.z));
    GuideAt<F> at;
    U node(0u);
    for (auto open = wanted; any(open);) {
        const auto row = gather_row<F, 4>(nodes_.data(), node);
        const U axis = as_uint(row[1]), next = as_uint(row[2]);
        const auto arrived = open & (axis == U(cell_axis));
        at.share = select(arrived, row[0], at.share);
        at.first = select(arrived, next >> count_bits, at.first);
        at.count = select(arrived, next & U((1u << count_bits) - 1u), at.count);
        open = open & !arrived;
        const F x = select(axis == U(0u), p.x, select(axis == U(1u), p.y, p.z));
        node = select(open, next + select(x >= row[0], U(1u), U(0u)), node);
    }
    return at;
}

template <class F>
inline Vec3<F> CausticGuide::sample(const GuideAt<F>& at, F which, F u, F v) const {
    using U = Uint<F>;
    const auto guided = at.count > U(0u);
    const U last = select(guided, at.count - U(1u), U(0u));
    const U index = min(to_uint(which * to_float(at.count)), last);
    const auto row =
        gather_row<F, 4>(lobes_.data(), select(guided, at.first + index, U(0u)));
    const F a = row[3];
    const F t = F(2.0f) * a * u / (a + F(2.0f) - F(2.0f) * u);
    const Frame<F> frame = frame_of_normal<F>({row[0], row[1], row[2]});
    return normalize(frame.to_world(sample_cone(F(1.0f), v, t)));
}

template <class F>
inline F CausticGuide::pdf(const GuideAt<F>& at, const Vec3<F>& direction) const {
    using U = Uint<F>;
    F sum(0.0f);
    U left = at.count, lobe = at.first;
    for (auto open = left > U(0u); any(open); open = left > U(0u)) {
        const auto row = gather_row<F, 4>(lobes_.data(), select(open, lobe, U(0u)));
        const F a = row[3];
        const F t = F(0.5f) * length_squared(direction - Vec3<F>{row[0], row[1], row[2]});
        const F density = a * (a + F(2.0f)) / sqr(t + a);
        sum += select(open, density, F(0.0f));
        lobe = lobe + U(1u);
        left = select(open, left - U(1u), U(0u));
    }
    const F count = max(to_float(at.count), F(1.0f));
    return sum * F(0.25f * inv_pi) / count;
}

}  // namespace raykiln
