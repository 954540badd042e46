#pragma once

#include <bit>
#include <cmath>
#include <cstdint>
#include <limits>

// The numbers that shading is written over. Samplers, BSDFs and lights are templates over
// a number type F and decide with `select` on a `Mask<F>` instead of branches. Width 1 (F
// = float, Mask = bool) is the reference; a SIMD type joins by giving the same functions.

namespace raykiln {

template <class F>
struct NumberTraits;

template <>
struct NumberTraits<float> {
    using Mask = bool;
    using Uint = std::uint32_t;
};

template <class F>
using Mask = typename NumberTraits<F>::Mask;
template <class F>
using Uint = typename NumberTraits<F>::Uint;

/// a where the mask is set, else b.
inline float select(bool mask, float a, float b) {
    return mask ? a : b;
}
inline bool any(bool mask) {
    return mask;
}
inline bool all(bool mask) {
    return mask;
}

inline float abs(float x) {
    return std::fabs(x);
}
inline float sqrt(float x) {
    return std::sqrt(x);
}
inline float floor(float x) {
    return std::floor(x);
}
inline float min(float a, float b) {
    return a < b ? a : b;
}
inline float max(float a, float b) {
    return a > b ? a : b;
}
inline float copysign(float magnitude, float sign) {
    return std::copysign(magnitude, sign);
}

/// Nearest integer, halves away from zero towards +infinity.
template <class F>
inline F round_half_up(F x) {
    return floor(x + F(0.5f));
}
template <class F>
inline F clamp(F x, F low, F high) {
    return min(max(x, low), high);
}
/// Square root that takes a slightly negative argument for zero.
template <class F>
inline F safe_sqrt(F x) {
    return sqrt(max(x, F(0.0f)));
}
template <class F>
inline F sqr(F x) {
    return x * x;
}
template <class F>
inline F lerp(F a, F b, F t) {
    return a + (b - a) * t;
}

/// x = mantissa * 2^exponent with the mantissa in [sqrt(1/2), sqrt(2)); x positive and
/// normal.
inline float split_exponent(float x, float& exponent) {
    constexpr std::uint32_t offset = 0x3f3504f3u;  // bits of sqrt(1/2)
    const std::uint32_t bits = std::bit_cast<std::uint32_t>(x) - offset;
    const auto e = static_cast<std::int32_t>(bits) >> 23;
    exponent = static_cast<float>(e);
    return std::bit_cast<float>(std::bit_cast<std::uint32_t>(x) -
                                (static_cast<std::uint32_t>(e) << 23));
}
/// 2^n for an integral n in [-126, 127].
inline float exp2_integral(float n) {
    return std::bit_cast<float>(static_cast<std::uint32_t>(static_cast<int>(n) + 127)
                                << 23);
}
/// The 32 bits as a number in [0, 1): the upper 24 of them.
inline float unit_from_bits(std::uint32_t bits) {
    return static_cast<float>(bits >> 8) * 0x1p-24f;
}

constexpr float pi = 3.14159265358979323846f;
constexpr float inv_pi = 0.318309886183790671538f;
constexpr float two_pi = 6.28318530717958647693f;
constexpr float inv_two_pi = 0.159154943091895335769f;
constexpr float infinity = std::numeric_limits<float>::infinity();
constexpr float one_minus_epsilon = 0x1.fffffep-1f;

}  // namespace raykiln
