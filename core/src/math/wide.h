#pragma once

#include <array>
#include <cstring>

#include "math/number.h"

// The number type of SIMD width: as many lanes as the instruction set of the translation
// unit has. Each function gives in each lane the bits that its counterpart for float
// gives (math/number.h). There are no approximate reciprocals: their bits differ between
// makers of processors.
//
// The types live in an inline namespace named after the instruction set, so that
// templates over them have a symbol of their own in each.

#if defined(__AVX512F__) && defined(__AVX512DQ__) && defined(__AVX512BW__) && \
    defined(__AVX512VL__)
#include "math/wide_avx512.h"
#define RAYKILN_WIDE_NAMESPACE wide_avx512
#elif defined(__AVX2__) && defined(__FMA__) && defined(__BMI2__)
#include "math/wide_avx2.h"
#define RAYKILN_WIDE_NAMESPACE wide_avx2
#elif defined(__SSE4_2__)
#include "math/wide_sse.h"
#define RAYKILN_WIDE_NAMESPACE wide_sse
#else
#error "math/wide.h needs SSE4.2 at least"
#endif

namespace raykiln {
inline namespace RAYKILN_WIDE_NAMESPACE {

/// One truth value a lane.
struct WideMask {
    WideIsa::Mask v;

    WideMask() = default;
    explicit WideMask(WideIsa::Mask raw, int) : v(raw) {}
    /// The same in all lanes.
    explicit WideMask(bool all) : v(WideIsa::mask_of(all)) {}
    /// Lane i is set where bit i is.
    static WideMask of_bits(std::uint32_t bits) {
        return WideMask(WideIsa::mask_of_bits(bits), 0);
    }
    /// The first n lanes are set; 0 <= n <= width.
    static WideMask first(int n) { return of_bits((1u << n) - 1u); }

    friend WideMask operator&(WideMask a, WideMask b) {
        return WideMask(WideIsa::mask_and(a.v, b.v), 0);
    }
    friend WideMask operator|(WideMask a, WideMask b) {
        return WideMask(WideIsa::mask_or(a.v, b.v), 0);
    }
    friend WideMask operator^(WideMask a, WideMask b) {
        return WideMask(WideIsa::mask_xor(a.v, b.v), 0);
    }
    friend WideMask operator!(WideMask a) { return WideMask(WideIsa::mask_not(a.v), 0); }
    friend WideMask operator==(WideMask a, WideMask b) { return !(a ^ b); }
    friend WideMask operator!=(WideMask a, WideMask b) { return a ^ b; }
    WideMask& operator&=(WideMask b) { return *this = *this & b; }
    WideMask& operator|=(WideMask b) { return *this = *this | b; }

    bool lane(int i) const { return ((WideIsa::bits(v) >> i) & 1u) != 0; }
};

/// One 32-bit unsigned number a lane, modulo 2^32.
struct WideUint {
    WideIsa::Uint v;

    WideUint() = default;
    explicit WideUint(WideIsa::Uint raw, int) : v(raw) {}
    /// The same in all lanes.
    explicit WideUint(std::uint32_t all) : v(WideIsa::Uint{} + all) {}

    friend WideUint operator+(WideUint a, WideUint b) { return WideUint(a.v + b.v, 0); }
    friend WideUint operator-(WideUint a, WideUint b) { return WideUint(a.v - b.v, 0); }
    friend WideUint operator*(WideUint a, WideUint b) { return WideUint(a.v * b.v, 0); }
    friend WideUint operator&(WideUint a, WideUint b) { return WideUint(a.v & b.v, 0); }
    friend WideUint operator|(WideUint a, WideUint b) { return WideUint(a.v | b.v, 0); }
    friend WideUint operator^(WideUint a, WideUint b) { return WideUint(a.v ^ b.v, 0); }
    friend WideUint operator~(WideUint a) { return WideUint(~a.v, 0); }
    friend WideUint operator<<(WideUint a, int n) { return WideUint(a.v << n, 0); }
    friend WideUint operator>>(WideUint a, int n) { return WideUint(a.v >> n, 0); }
    WideUint& operator+=(WideUint b) { return *this = *this + b; }
    WideUint& operator-=(WideUint b) { return *this = *this - b; }
    WideUint& operator*=(WideUint b) { return *this = *this * b; }
    WideUint& operator&=(WideUint b) { return *this = *this & b; }
    WideUint& operator|=(WideUint b) { return *this = *this | b; }
    WideUint& operator^=(WideUint b) { return *this = *this ^ b; }

    friend WideMask operator==(WideUint a, WideUint b) {
        return WideMask(WideIsa::equal(a.v, b.v), 0);
    }
    friend WideMask operator<(WideUint a, WideUint b) {
        return WideMask(WideIsa::less(a.v, b.v), 0);
    }
    friend WideMask operator!=(WideUint a, WideUint b) { return !(a == b); }
    friend WideMask operator>(WideUint a, WideUint b) { return b < a; }
    friend WideMask operator<=(WideUint a, WideUint b) { return !(b < a); }
    friend WideMask operator>=(WideUint a, WideUint b) { return !(a < b); }

    std::uint32_t lane(int i) const { return v[i]; }
    void set_lane(int i, std::uint32_t value) { v[i] = value; }
};

/// One float a lane.
struct Wide {
    WideIsa::Float v;

    Wide() = default;
    explicit Wide(WideIsa::Float raw, int) : v(raw) {}
    /// The same in all lanes.
    explicit Wide(float all) : v(all - WideIsa::Float{}) {}  // -0 - 0 = -0

    friend Wide operator+(Wide a, Wide b) { return Wide(a.v + b.v, 0); }
    friend Wide operator-(Wide a, Wide b) { return Wide(a.v - b.v, 0); }
    friend Wide operator*(Wide a, Wide b) { return Wide(a.v * b.v, 0); }
    friend Wide operator/(Wide a, Wide b) { return Wide(a.v / b.v, 0); }
    friend Wide operator-(Wide a) { return Wide(-a.v, 0); }
    Wide& operator+=(Wide b) { return *this = *this + b; }
    Wide& operator-=(Wide b) { return *this = *this - b; }
    Wide& operator*=(Wide b) { return *this = *this * b; }
    Wide& operator/=(Wide b) { return *this = *this / b; }

    friend WideMask operator==(Wide a, Wide b) {
        return WideMask(WideIsa::equal(a.v, b.v), 0);
    }
    friend WideMask operator<(Wide a, Wide b) {
        return WideMask(WideIsa::less(a.v, b.v), 0);
    }
    friend WideMask operator<=(Wide a, Wide b) {
        return WideMask(WideIsa::less_equal(a.v, b.v), 0);
    }
    friend WideMask operator!=(Wide a, Wide b) { return !(a == b); }
    friend WideMask operator>(Wide a, Wide b) { return b < a; }
    friend WideMask operator>=(Wide a, Wide b) { return b <= a; }

    float lane(int i) const { return v[i]; }
    void set_lane(int i, float value) { v[i] = value; }
};

inline bool any(WideMask m) {
    return WideIsa::bits(m.v) != 0;
}
inline bool all(WideMask m) {
    return WideIsa::bits(m.v) == (1u << WideIsa::width) - 1u;
}
inline bool none(WideMask m) {
    return !any(m);
}
inline int count(WideMask m) {
    return __builtin_popcount(WideIsa::bits(m.v));
}
inline std::uint32_t bits(WideMask m) {
    return WideIsa::bits(m.v);
}
inline WideMask select(WideMask m, WideMask a, WideMask b) {
    return (m & a) | ((!m) & b);
}

inline Wide select(WideMask m, Wide a, Wide b) {
    return Wide(WideIsa::select(m.v, a.v, b.v), 0);
}
inline WideUint select(WideMask m, WideUint a, WideUint b) {
    return WideUint(WideIsa::select(m.v, a.v, b.v), 0);
}

inline WideUint as_uint(Wide x) {
    return WideUint(reinterpret_cast<WideIsa::Uint>(x.v), 0);
}
inline Wide as_float(WideUint x) {
    return Wide(reinterpret_cast<WideIsa::Float>(x.v), 0);
}
inline Wide to_float(WideUint x) {
    return Wide(
        __builtin_convertvector(reinterpret_cast<WideIsa::Int>(x.v), WideIsa::Float), 0);
}
inline WideUint to_uint(Wide x) {
    return WideUint(
        reinterpret_cast<WideIsa::Uint>(__builtin_convertvector(x.v, WideIsa::Int)), 0);
}

inline Wide abs(Wide x) {
    return as_float(as_uint(x) & WideUint(0x7fffffffu));
}
inline Wide copysign(Wide magnitude, Wide sign) {
    return as_float((as_uint(magnitude) & WideUint(0x7fffffffu)) |
                    (as_uint(sign) & WideUint(0x80000000u)));
}
inline Wide sqrt(Wide x) {
    return Wide(WideIsa::sqrt(x.v), 0);
}
inline Wide floor(Wide x) {
    return Wide(WideIsa::floor(x.v), 0);
}
inline Wide min(Wide a, Wide b) {
    return Wide(WideIsa::min(a.v, b.v), 0);
}
inline Wide max(Wide a, Wide b) {
    return Wide(WideIsa::max(a.v, b.v), 0);
}
inline WideUint min(WideUint a, WideUint b) {
    return WideUint(WideIsa::min(a.v, b.v), 0);
}
inline WideUint max(WideUint a, WideUint b) {
    return WideUint(WideIsa::max(a.v, b.v), 0);
}

inline Wide split_exponent(Wide x, Wide& exponent) {
    const WideIsa::Int e =
        reinterpret_cast<WideIsa::Int>((as_uint(x) - WideUint(0x3f3504f3u)).v) >> 23;
    exponent = Wide(__builtin_convertvector(e, WideIsa::Float), 0);
    return as_float(as_uint(x) - (WideUint(reinterpret_cast<WideIsa::Uint>(e), 0) << 23));
}
inline Wide exp2_integral(Wide n) {
    return as_float((to_uint(n) + WideUint(127u)) << 23);
}
inline Wide unit_from_bits(WideUint bits) {
    return to_float(bits >> 8) * Wide(0x1p-24f);
}

/// base[index] in each lane; index < 2^31.
inline Wide gather(const float* base, WideUint index) {
    return Wide(WideIsa::gather(base, index.v), 0);
}
inline WideUint gather(const std::uint32_t* base, WideUint index) {
    return WideUint(WideIsa::gather(base, index.v), 0);
}
/// The same where the mask is set (nothing else is read), and `otherwise` elsewhere.
inline Wide gather(WideMask m, const float* base, WideUint index, Wide otherwise) {
    return Wide(WideIsa::gather(m.v, base, index.v, otherwise.v), 0);
}
inline WideUint gather(WideMask m, const std::uint32_t* base, WideUint index,
                       WideUint otherwise) {
    return WideUint(WideIsa::gather(m.v, base, index.v, otherwise.v), 0);
}
/// base[index .. index + 3] in each lane; cheaper than four gathers.
inline std::array<Wide, 4> gather4(const float* base, WideUint index) {
    WideIsa::Float x[4];
    WideIsa::gather4(base, index.v, x);
    return {Wide(x[0], 0), Wide(x[1], 0), Wide(x[2], 0), Wide(x[3], 0)};
}
/// How many of base[index .. index + 15] are not above x, in each lane.
inline WideUint count_not_above(const float* base, WideUint index, Wide x) {
    return WideUint(WideIsa::count_not_above(base, index.v, x.v), 0);
}
/// base[index] = value where the mask is set; of equal indices the highest lane stays.
inline void scatter(WideMask m, float* base, WideUint index, Wide value) {
    WideIsa::scatter(m.v, base, index.v, value.v);
}
inline void scatter(WideMask m, std::uint32_t* base, WideUint index, WideUint value) {
    WideIsa::scatter(m.v, base, index.v, value.v);
}

/// No alignment is needed.
inline void store(float* to, Wide x) {
    std::memcpy(to, &x.v, sizeof(x.v));
}
inline void store(std::uint32_t* to, WideUint x) {
    std::memcpy(to, &x.v, sizeof(x.v));
}
/// The lanes of the mask alone; the others must be there to be read.
inline void store(WideMask m, float* to, Wide x) {
    Wide old;
    std::memcpy(&old.v, to, sizeof(old.v));
    store(to, select(m, x, old));
}
inline void store(WideMask m, std::uint32_t* to, WideUint x) {
    WideUint old;
    std::memcpy(&old.v, to, sizeof(old.v));
    store(to, select(m, x, old));
}
/// The lanes of the mask moved to the front, in order.
inline WideUint compress(WideMask m, WideUint values) {
    return WideUint(WideIsa::compress(m.v, values.v), 0);
}
/// Appends the lanes of the mask in order and returns their number. There must be room
/// for all lanes: what follows the appended ones is overwritten.
inline int compress_store(WideMask m, WideUint values, std::uint32_t* out) {
    store(out, WideUint(WideIsa::compress(m.v, values.v), 0));
    return count(m);
}
inline int compress_store(WideMask m, Wide values, float* out) {
    store(out, as_float(WideUint(WideIsa::compress(m.v, as_uint(values).v), 0)));
    return count(m);
}

/// Reverses bits by table look-ups of half bytes.
inline WideUint reverse_bits(WideUint x) {
    const auto bytes = [](std::uint32_t a, std::uint32_t b, std::uint32_t c,
                          std::uint32_t d) {
        WideIsa::Uint t;
        for (int i = 0; i < WideIsa::width; i += 4) {
            t[i] = a, t[i + 1] = b, t[i + 2] = c, t[i + 3] = d;
        }
        return t;
    };
    const auto low =
        bytes(0xc0408000u, 0xe060a020u, 0xd0509010u, 0xf070b030u);  // reversed, << 4
    const auto high = bytes(0x0c040800u, 0x0e060a02u, 0x0d050901u, 0x0f070b03u);
    const auto swap = bytes(0x00010203u, 0x04050607u, 0x08090a0bu, 0x0c0d0e0fu);
    const WideUint half(0x0f0f0f0fu);
    const auto reversed = WideIsa::shuffle_bytes(low, (x & half).v) |
                          WideIsa::shuffle_bytes(high, ((x >> 4) & half).v);
    return WideUint(WideIsa::shuffle_bytes(reversed, swap), 0);
}

/// Entry `index` of a table of 16; index < 16.
inline WideUint lookup16(const std::array<std::uint32_t, 16>& table, WideUint index) {
    return WideUint(WideIsa::lookup16(table.data(), index.v), 0);
}

}  // namespace RAYKILN_WIDE_NAMESPACE

template <>
struct NumberTraits<Wide> {
    using Mask = WideMask;
    using Uint = WideUint;
    using Scalar = float;
    static constexpr int width = WideIsa::width;

    static Wide load(const float* from) {
        Wide x;
        std::memcpy(&x.v, from, sizeof(x.v));
        return x;
    }
};

template <>
struct NumberTraits<WideUint> {
    using Mask = WideMask;
    using Scalar = std::uint32_t;
    static constexpr int width = WideIsa::width;

    static WideUint load(const std::uint32_t* from) {
        WideUint x;
        std::memcpy(&x.v, from, sizeof(x.v));
        return x;
    }
    static WideUint iota() {
        WideUint x;
        for (int i = 0; i < width; ++i) {
            x.v[i] = static_cast<std::uint32_t>(i);
        }
        return x;
    }
};

}  // namespace raykiln
