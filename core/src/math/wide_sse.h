#pragma once

#include <immintrin.h>

#include <cstdint>
#include <cstring>

// What math/wide.h asks of an instruction set: here SSE4.2 (x86-64-v2), 4 lanes.

namespace raykiln {
inline namespace wide_sse {

struct WideIsa {
    static constexpr int width = 4;
    static constexpr const char* name = "sse4.2";

    typedef float Float __attribute__((vector_size(16)));
    typedef std::uint32_t Uint __attribute__((vector_size(16)));
    typedef std::int32_t Int __attribute__((vector_size(16)));
    using Mask = Int;  ///< -1 where set, else 0

    static __m128i raw(Uint a) { return reinterpret_cast<__m128i>(a); }
    static Uint uint(__m128i a) { return reinterpret_cast<Uint>(a); }
    static __m128 lanes(Mask m) { return reinterpret_cast<__m128>(m); }

    static Mask mask_of(bool all) { return Mask{} - static_cast<std::int32_t>(all); }
    static Mask mask_of_bits(std::uint32_t bits) {
        const Uint lane_bit{1, 2, 4, 8};
        return (lane_bit & bits) != Uint{};
    }
    static std::uint32_t bits(Mask m) {
        return static_cast<std::uint32_t>(_mm_movemask_ps(lanes(m)));
    }
    static Mask mask_and(Mask a, Mask b) { return a & b; }
    static Mask mask_or(Mask a, Mask b) { return a | b; }
    static Mask mask_xor(Mask a, Mask b) { return a ^ b; }
    static Mask mask_not(Mask a) { return ~a; }

    static Mask equal(Float a, Float b) { return a == b; }
    static Mask less(Float a, Float b) { return a < b; }
    static Mask less_equal(Float a, Float b) { return a <= b; }
    static Mask equal(Uint a, Uint b) { return a == b; }
    static Mask less(Uint a, Uint b) { return a < b; }

    static Float select(Mask m, Float a, Float b) {
        return _mm_blendv_ps(b, a, lanes(m));
    }
    static Uint select(Mask m, Uint a, Uint b) {
        return uint(_mm_blendv_epi8(raw(b), raw(a), reinterpret_cast<__m128i>(m)));
    }
    static Float min(Float a, Float b) { return _mm_min_ps(a, b); }
    static Float max(Float a, Float b) { return _mm_max_ps(a, b); }
    static Uint min(Uint a, Uint b) { return uint(_mm_min_epu32(raw(a), raw(b))); }
    static Uint max(Uint a, Uint b) { return uint(_mm_max_epu32(raw(a), raw(b))); }
    static Float sqrt(Float a) { return _mm_sqrt_ps(a); }
    static Float floor(Float a) { return _mm_floor_ps(a); }

    static Float gather(const float* base, Uint index) {
        return Float{base[index[0]], base[index[1]], base[index[2]], base[index[3]]};
    }
    static Uint gather(const std::uint32_t* base, Uint index) {
        return Uint{base[index[0]], base[index[1]], base[index[2]], base[index[3]]};
    }
    template <class Scalar, class Value>
    static Value gather(Mask m, const Scalar* base, Uint index, Value otherwise) {
        for (std::uint32_t rest = bits(m); rest != 0; rest &= rest - 1) {
            const int lane = __builtin_ctz(rest);
            otherwise[lane] = base[index[lane]];
        }
        return otherwise;
    }
    template <class Scalar, class Value>
    static void scatter(Mask m, Scalar* base, Uint index, Value value) {
        for (std::uint32_t rest = bits(m); rest != 0; rest &= rest - 1) {
            const int lane = __builtin_ctz(rest);
            base[index[lane]] = value[lane];
        }
    }
    /// base[index + 0 .. 3] in each lane: four loads of 16 bytes, transposed.
    static void gather4(const float* base, Uint index, Float (&out)[4]) {
        std::uint32_t at[width];
        std::memcpy(at, &index, sizeof(at));
        __m128 row[4];
        for (int i = 0; i < 4; ++i) {
            row[i] = _mm_loadu_ps(base + at[i]);
        }
        const __m128 a = _mm_unpacklo_ps(row[0], row[1]);
        const __m128 b = _mm_unpackhi_ps(row[0], row[1]);
        const __m128 c = _mm_unpacklo_ps(row[2], row[3]);
        const __m128 d = _mm_unpackhi_ps(row[2], row[3]);
        const auto low = [](__m128 x, __m128 y) {
            return reinterpret_cast<Float>(_mm_unpacklo_pd(reinterpret_cast<__m128d>(x),
                                                           reinterpret_cast<__m128d>(y)));
        };
        const auto high = [](__m128 x, __m128 y) {
            return reinterpret_cast<Float>(_mm_unpackhi_pd(reinterpret_cast<__m128d>(x),
                                                           reinterpret_cast<__m128d>(y)));
        };
        out[0] = low(a, c);
        out[1] = high(a, c);
        out[2] = low(b, d);
        out[3] = high(b, d);
    }
    /// How many of base[index + 0 .. 15] are not above x.
    static Uint count_not_above(const float* base, Uint index, Float x) {
        Uint number{};
        for (int i = 0; i < width; ++i) {
            const __m128 most = _mm_set1_ps(x[i]);
            for (int k = 0; k < 16; k += 4) {
                const __m128 row = _mm_loadu_ps(base + index[i] + k);
                number[i] += static_cast<std::uint32_t>(__builtin_popcount(
                    static_cast<unsigned>(_mm_movemask_ps(_mm_cmple_ps(row, most)))));
            }
        }
        return number;
    }
    /// The lanes of the mask moved to the front; the others are unspecified.
    static Uint compress(Mask m, Uint value) {
        Uint front = value;
        int count = 0;
        for (std::uint32_t rest = bits(m); rest != 0; rest &= rest - 1) {
            front[count++] = value[__builtin_ctz(rest)];
        }
        return front;
    }
    /// Entry `index` of a table of 16, which must be < 16.
    static Uint lookup16(const std::uint32_t* table, Uint index) {
        return gather(table, index);
    }
    /// Within each 16 bytes: byte i of the result is byte index[i] of the table.
    static Uint shuffle_bytes(Uint table, Uint index) {
        return uint(_mm_shuffle_epi8(raw(table), raw(index)));
    }
};

}  // namespace wide_sse
}  // namespace raykiln
