#pragma once

#include <array>

#include "sampling/distribution.h"
#include "sampling/warp.h"

namespace raykiln {

enum class FilterKind : std::uint8_t { box, tent, gaussian, blackman_harris };

/// A separable pixel filter, sampled by importance (Ernst et al. 2006): a sample is moved
/// by an offset drawn from the filter and then counts fully, for its own pixel only.
class Filter {
  public:
    explicit Filter(FilterKind kind);
    /// Offset in pixels from the pixel's centre, along one axis, for u in [0, 1).
    template <class F>
    F offset(F u) const;
    /// The filter at an offset, integrating to 1.
    float density(float offset) const;
    float radius() const { return radius_; }

  private:
    static constexpr int cells = 1024;
    FilterKind kind_;
    float radius_;
    double integral_;                             // of the shape over (-1, 1)
    alignas(64) std::array<float, cells> cdf_{};  // of the even cells across it
};

template <class F>
inline F Filter::offset(F u) const {
    switch (kind_) {
        case FilterKind::box:
            return u - F(0.5f);
        case FilterKind::tent:
            return sample_tent(u, F(radius_));
        default:
            break;
    }
    // The cell that holds u, and where in it: there are as many as make the tails, where
    // little of the filter is spread wide, come out right.
    F within;
    const Uint<F> cell = Cdf::find(cdf_.data(), Uint<F>(0u), cells, u, within);
    return ((to_float(cell) + within) * F(2.0f / cells) - F(1.0f)) * F(radius_);
}

}  // namespace raykiln
