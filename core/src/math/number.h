#pragma once

#include <array>
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
    using Scalar = float;
    static constexpr int width = 1;

    static float load(const float* from) { return *from; }
};
template <>
struct NumberTraits<std::uint32_t> {
    using Mask = bool;
    using Scalar = std::uint32_t;
    static constexpr int width = 1;

    static std::uint32_t load(const std::uint32_t* from) { return *from; }
    static std::uint32_t iota() { return 0; }
};

template <class F>
using Mask = typename NumberTraits<F>::Mask;
template <class F>
using Uint = typename NumberTraits<F>::Uint;

/// As many neighbours in memory as there are lanes; N is F or Uint<F>. No alignment is
/// needed.
template <class N>
inline N load(const typename NumberTraits<N>::Scalar* from) {
    return NumberTraits<N>::load(from);
}
inline void store(float* to, float x) {
    *to = x;
}
inline void store(std::uint32_t* to, std::uint32_t x) {
    *to = x;
}
/// The number of each lane.
template <class U>
inline U iota() {
    return NumberTraits<U>::iota();
}

/// a where the mask is set, else b.
inline float select(bool mask, float a, float b) {
    return mask ? a : b;
}
inline std::uint32_t select(bool mask, std::uint32_t a, std::uint32_t b) {
    return mask ? a : b;
}
inline bool select(bool mask, bool a, bool b) {
    return mask ? a : b;
}
inline bool any(bool mask) {
    return mask;
}
inline bool all(bool mask) {
    return mask;
}
inline bool none(bool mask) {
    return !mask;
}
/// Lanes that are set.
inline int count(bool mask) {
    return static_cast<int>(mask);
}
/// Bit i is lane i.
inline std::uint32_t bits(bool mask) {
    return static_cast<std::uint32_t>(mask);
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
inline std::uint32_t min(std::uint32_t a, std::uint32_t b) {
    return a < b ? a : b;
}
inline std::uint32_t max(std::uint32_t a, std::uint32_t b) {
    return a > b ? a : b;
}
inline float copysign(float magnitude, float sign) {
    return std::copysign(magnitude, sign);
}

/// The bits of a number, and back.
inline std::uint32_t as_uint(float x) {
    return std::bit_cast<std::uint32_t>(x);
}
inline float as_float(std::uint32_t x) {
    return std::bit_cast<float>(x);
}
/// The value as a number of the other kind, below 2^31; fractions are cut off.
inline std::uint32_t to_uint(float x) {
    return static_cast<std::uint32_t>(static_cast<std::int32_t>(x));
}
inline float to_float(std::uint32_t x) {
    return static_cast<float>(static_cast<std::int32_t>(x));
}

/// base[index] in each lane; index < 2^31.
inline float gather(const float* base, std::uint32_t index) {
    return base[index];
}
inline std::uint32_t gather(const std::uint32_t* base, std::uint32_t index) {
    return base[index];
}
/// The same where the mask is set (nothing else is read), and `otherwise` elsewhere.
inline float gather(bool mask, const float* base, std::uint32_t index, float otherwise) {
    return mask ? base[index] : otherwise;
}
inline std::uint32_t gather(bool mask, const std::uint32_t* base, std::uint32_t index,
                            std::uint32_t otherwise) {
    return mask ? base[index] : otherwise;
}
/// base[index .. index + 3] in each lane.
inline std::array<float, 4> gather4(const float* base, std::uint32_t index) {
    return {base[index], base[index + 1], base[index + 2], base[index + 3]};
}
/// How many of base[index .. index + 15] are not above x, in each lane.
inline std::uint32_t count_not_above(const float* base, std::uint32_t index, float x) {
    std::uint32_t number = 0;
    for (std::uint32_t i = 0; i < 16; ++i) {
        number += base[index + i] <= x ? 1 : 0;
    }
    return number;
}
/// base[index] = value where the mask is set; of equal indices the highest lane stays.
inline void scatter(bool mask, float* base, std::uint32_t index, float value) {
    if (mask) {
        base[index] = value;
    }
}
inline void scatter(bool mask, std::uint32_t* base, std::uint32_t index,
                    std::uint32_t value) {
    if (mask) {
        base[index] = value;
    }
}
/// Appends the lanes of the mask in order and returns their number. There must be room
/// for all lanes: what follows the appended ones is overwritten.
inline int compress_store(bool mask, float value, float* out) {
    *out = value;
    return count(mask);
}
inline int compress_store(bool mask, std::uint32_t value, std::uint32_t* out) {
    *out = value;
    return count(mask);
}

/// Neither infinite nor not a number.
template <class F>
inline Mask<F> is_finite(F x) {
    return abs(x) < F(std::numeric_limits<float>::infinity());
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

/// Entry `index` of a table of 16; index < 16.
inline std::uint32_t lookup16(const std::array<std::uint32_t, 16>& table,
                              std::uint32_t index) {
    return table[index];
}

constexpr float pi = 3.14159265358979323846f;
constexpr float inv_pi = 0.318309886183790671538f;
constexpr float two_pi = 6.28318530717958647693f;
constexpr float inv_two_pi = 0.159154943091895335769f;
constexpr float infinity = std::numeric_limits<float>::infinity();
constexpr float one_minus_epsilon = 0x1.fffffep-1f;

}  // namespace raykiln
