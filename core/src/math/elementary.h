#pragma once

#include "math/number.h"

// Elementary functions from plain arithmetic: the same bits with every C library, and the
// same source at every SIMD width. Series are cut where the next term is below float
// precision.

namespace raykiln {

/// sin and cos of 2 pi x; x in turns, |x| < 2^20. Absolute error below 2e-7.
template <class F>
inline void sin_cos_turns(F x, F& sine, F& cosine) {
    // Reduce to an eighth of a turn about the nearest quarter.
    const F quarter = round_half_up(x * F(4.0f));
    const F r = (x * F(4.0f) - quarter) * F(0.5f * pi);
    const F r2 = r * r;
    const F s =
        r + r * r2 *
                (F(-1.0f / 6) +
                 r2 * (F(1.0f / 120) + r2 * (F(-1.0f / 5040) + r2 * F(1.0f / 362880))));
    const F c = F(1.0f) +
                r2 * (F(-0.5f) +
                      r2 * (F(1.0f / 24) + r2 * (F(-1.0f / 720) + r2 * F(1.0f / 40320))));
    const F half = floor(quarter * F(0.5f));
    const auto odd = quarter - half * F(2.0f) > F(0.5f);
    const auto upper = half - floor(half * F(0.5f)) * F(2.0f) > F(0.5f);
    const F a = select(odd, c, s);
    const F b = select(odd, F(0.0f) - s, c);
    sine = select(upper, F(0.0f) - a, a);
    cosine = select(upper, F(0.0f) - b, b);
}

/// atan(x) for 0 <= x <= 1.
template <class F>
inline F atan_unit(F x) {
    constexpr float tan_pi_8 = 0.41421356237f;
    const auto large = x > F(tan_pi_8);
    const F z = select(large, (x - F(1.0f)) / (x + F(1.0f)), x);
    const F z2 = z * z;
    F sum = F(-1.0f / 15);
    sum = F(1.0f / 13) + z2 * sum;
    sum = F(-1.0f / 11) + z2 * sum;
    sum = F(1.0f / 9) + z2 * sum;
    sum = F(-1.0f / 7) + z2 * sum;
    sum = F(1.0f / 5) + z2 * sum;
    sum = F(-1.0f / 3) + z2 * sum;
    return select(large, F(0.25f * pi), F(0.0f)) + z + z * z2 * sum;
}

/// Angle of (x, y) in [-pi, pi]; 0 at the origin. Absolute error below 1e-6.
template <class F>
inline F atan2(F y, F x) {
    const F ax = abs(x);
    const F ay = abs(y);
    const F high = max(ax, ay);
    const F ratio = select(high > F(0.0f), min(ax, ay) / high, F(0.0f));
    F angle = atan_unit(ratio);
    angle = select(ay > ax, F(0.5f * pi) - angle, angle);
    angle = select(x < F(0.0f), F(pi) - angle, angle);
    return select(y < F(0.0f), F(0.0f) - angle, angle);
}

/// Arc cosine of x, clamped to [-1, 1].
template <class F>
inline F acos(F x) {
    return atan2(safe_sqrt((F(1.0f) - x) * (F(1.0f) + x)), x);
}

/// Natural logarithm of a positive normal number. Relative error below 1e-6.
template <class F>
inline F log(F x) {
    F exponent;
    const F m = split_exponent(x, exponent);
    const F s = (m - F(1.0f)) / (m + F(1.0f));
    const F s2 = s * s;
    const F tail =
        s2 * (F(1.0f / 3) + s2 * (F(1.0f / 5) + s2 * (F(1.0f / 7) + s2 * F(1.0f / 9))));
    return exponent * F(0.693147180559945f) + F(2.0f) * (s + s * tail);
}

/// e^x; 0 below -87. Relative error below 1e-6.
template <class F>
inline F exp(F x) {
    const F y = clamp(x, F(-87.0f), F(88.0f));
    const F n = round_half_up(y * F(1.44269504088896f));
    const F r = (y - n * F(0.693359375f)) + n * F(2.12194440e-4f);
    F sum = F(1.0f / 5040);
    sum = F(1.0f / 720) + r * sum;
    sum = F(1.0f / 120) + r * sum;
    sum = F(1.0f / 24) + r * sum;
    sum = F(1.0f / 6) + r * sum;
    sum = F(0.5f) + r * sum;
    sum = F(1.0f) + r * (F(1.0f) + r * sum);
    return select(x < F(-87.0f), F(0.0f), sum * exp2_integral(n));
}

}  // namespace raykiln
