#pragma once

#include <array>

#include "math/vec.h"

namespace raykiln {

enum class FilterKind : std::uint8_t { box, tent, gaussian, blackman_harris };

/// A separable pixel filter, sampled by importance (Ernst et al. 2006): a sample is moved
/// by an offset drawn from the filter and then counts fully, for its own pixel only.
class Filter {
  public:
    explicit Filter(FilterKind kind);
    /// Offset in pixels from the pixel's centre, along one axis, for u in [0, 1).
    float offset(float u) const;
    /// The filter at an offset, integrating to 1.
    float density(float offset) const;
    float radius() const { return radius_; }

  private:
    static constexpr int cells = 1024, parts = 256;
    FilterKind kind_;
    float radius_;
    double integral_;                               // of the shape over (-1, 1)
    std::array<float, cells + 1> cdf_{};            // of the even cells across it
    std::array<std::uint16_t, parts + 1> first_{};  // cell that holds u = i / parts
};

}  // namespace raykiln
