#include "render/filter.h"

#include <cmath>
#include <vector>

#include "sampling/warp.h"

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

double integral(FilterKind kind) {
    constexpr int n = 1 << 16;
    double sum = 0;
    for (int i = 0; i < n; ++i) {
        sum += shape(kind, 2.0 * (i + 0.5) / n - 1.0) * 2.0 / n;
    }
    return sum;
}

}  // namespace

Filter::Filter(FilterKind kind) : kind_(kind), radius_(radius_of(kind)) {
    // Tabulate where the running integral crosses each fraction.
    constexpr int n = 1 << 16;
    const double total = integral(kind);
    double running = 0;
    int next = 1;
    inverse_cdf_[0] = -radius_;
    for (int i = 0; i < n && next < segments; ++i) {
        const double step = shape(kind, 2.0 * (i + 0.5) / n - 1.0) * 2.0 / n / total;
        while (next < segments &&
               running + step >= static_cast<double>(next) / segments) {
            const double within = (static_cast<double>(next) / segments - running) / step;
            inverse_cdf_[static_cast<std::size_t>(next++)] =
                static_cast<float>((2.0 * (i + within) / n - 1.0) * radius_);
        }
        running += step;
    }
    inverse_cdf_[segments] = radius_;
}

float Filter::offset(float u) const {
    switch (kind_) {
        case FilterKind::box:
            return u - 0.5f;
        case FilterKind::tent:
            return sample_tent(u, radius_);
        default:
            break;
    }
    const float x = u * segments;
    const int i = std::min(static_cast<int>(x), segments - 1);
    return lerp(inverse_cdf_[static_cast<std::size_t>(i)],
                inverse_cdf_[static_cast<std::size_t>(i + 1)], x - static_cast<float>(i));
}

float Filter::density(float offset) const {
    if (std::fabs(offset) > radius_) {
        return 0.0f;
    }
    return static_cast<float>(shape(kind_, offset / radius_) /
                              (integral(kind_) * radius_));
}

}  // namespace raykiln
