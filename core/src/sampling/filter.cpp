#include "sampling/filter.h"

#include <cmath>

namespace raykiln {

namespace {

/// Filters at x in units of the radius; up to a factor.
double shape(FilterKind kind, double x) {
    constexpr double tau = 6.283185307179586;
    switch (kind) {
        case FilterKind::box:
            return 1.0;
        case FilterKind::tent:
            return 1.0 - std::fabs(x);
        case FilterKind::gaussian:
            // Standard deviation 1/2 pixel, cut at 2 pixels and lowered to meet 0 there.
            return std::exp(-8.0 * x * x) - std::exp(-8.0);
        case FilterKind::blackman_harris: {
            const double p = 0.5 * (x + 1.0);
            return 0.35875 - 0.48829 * std::cos(tau * p) +
                   0.14128 * std::cos(2 * tau * p) - 0.01168 * std::cos(3 * tau * p);
        }
    }
    return 0.0;
}

float radius_of(FilterKind kind) {
    switch (kind) {
        case FilterKind::box:
            return 0.5f;
        case FilterKind::tent:
            return 1.0f;
        case FilterKind::gaussian:
            return 2.0f;
        case FilterKind::blackman_harris:
            return 1.5f;
    }
    return 0.5f;
}

/// Integral of the shape over one of n even parts of (-1, 1), by the midpoint rule.
double part_of_integral(FilterKind kind, int part, int n) {
    constexpr int steps = 64;
    double sum = 0;
    for (int i = 0; i < steps; ++i) {
        sum += shape(kind, 2.0 * (part + (i + 0.5) / steps) / n - 1.0);
    }
    return sum * 2.0 / n / steps;
}

}  // namespace

Filter::Filter(FilterKind kind) : kind_(kind), radius_(radius_of(kind)), integral_(0) {
    std::array<double, cells> masses{};
    for (int i = 0; i < cells; ++i) {
        integral_ += masses[static_cast<std::size_t>(i)] =
            part_of_integral(kind, i, cells);
    }
    Cdf::fill(masses.data(), cells, cdf_.data());
}

float Filter::density(float offset) const {
    if (std::fabs(offset) > radius_) {
        return 0.0f;
    }
    return static_cast<float>(shape(kind_, offset / radius_) / (integral_ * radius_));
}

}  // namespace raykiln
