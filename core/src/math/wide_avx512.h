#pragma once

#include <immintrin.h>

#include <cstdint>
#include <cstring>

// What math/wide.h asks of an instruction set: here AVX-512 (x86-64-v4), 16 lanes.

namespace raykiln {
inline namespace wide_avx512 {

struct WideIsa {
    static constexpr int width = 16;
    static constexpr const char* name = "avx512";

    typedef float Float __attribute__((vector_size(64)));
    typedef std::uint32_t Uint __attribute__((vector_size(64)));
    typedef std::int32_t Int __attribute__((vector_size(64)));
    using Mask = __mmask16;

    // GCC 12 warns of uninitialised values inside its unmasked intrinsics; the masked
    // forms with a constant mask become the same instructions.
    static constexpr Mask every_lane = 0xffff;

    static __m512i raw(Uint a) { return reinterpret_cast<__m512i>(a); }
    static Uint uint(__m512i a) { return reinterpret_cast<Uint>(a); }

    static Mask mask_of(bool all) { return all ? 0xffff : 0; }
    static Mask mask_of_bits(std::uint32_t bits) { return static_cast<Mask>(bits); }
    static std::uint32_t bits(Mask m) { return m; }
    static Mask mask_and(Mask a, Mask b) { return _kand_mask16(a, b); }
    static Mask mask_or(Mask a, Mask b) { return _kor_mask16(a, b); }
    static Mask mask_xor(Mask a, Mask b) { return _kxor_mask16(a, b); }
    static Mask mask_not(Mask a) { return _knot_mask16(a); }

    static Mask equal(Float a, Float b) { return _mm512_cmp_ps_mask(a, b, _CMP_EQ_OQ); }
    static Mask less(Float a, Float b) { return _mm512_cmp_ps_mask(a, b, _CMP_LT_OS); }
    static Mask less_equal(Float a, Float b) {
        return _mm512_cmp_ps_mask(a, b, _CMP_LE_OS);
    }
    static Mask equal(Uint a, Uint b) { return _mm512_cmpeq_epu32_mask(raw(a), raw(b)); }
    static Mask less(Uint a, Uint b) { return _mm512_cmplt_epu32_mask(raw(a), raw(b)); }

    static Float select(Mask m, Float a, Float b) {
        return _mm512_mask_blend_ps(m, b, a);
    }
    static Uint select(Mask m, Uint a, Uint b) {
        return uint(_mm512_mask_blend_epi32(m, raw(b), raw(a)));
    }
    static Float min(Float a, Float b) { return _mm512_maskz_min_ps(every_lane, a, b); }
    static Float max(Float a, Float b) { return _mm512_maskz_max_ps(every_lane, a, b); }
    static Uint min(Uint a, Uint b) {
        return uint(_mm512_maskz_min_epu32(every_lane, raw(a), raw(b)));
    }
    static Uint max(Uint a, Uint b) {
        return uint(_mm512_maskz_max_epu32(every_lane, raw(a), raw(b)));
    }
    static Float sqrt(Float a) { return _mm512_maskz_sqrt_ps(every_lane, a); }
    static Float floor(Float a) {
        return _mm512_maskz_roundscale_ps(every_lane, a,
                                          _MM_FROUND_TO_NEG_INF | _MM_FROUND_NO_EXC);
    }

    static Float gather(const float* base, Uint index) {
        return gather(every_lane, base, index, Float{});
    }
    static Uint gather(const std::uint32_t* base, Uint index) {
        return gather(every_lane, base, index, Uint{});
    }
    static Float gather(Mask m, const float* base, Uint index, Float otherwise) {
        return _mm512_mask_i32gather_ps(otherwise, m, raw(index), base, 4);
    }
    static Uint gather(Mask m, const std::uint32_t* base, Uint index, Uint otherwise) {
        return uint(_mm512_mask_i32gather_epi32(raw(otherwise), m, raw(index), base, 4));
    }
    static void scatter(Mask m, float* base, Uint index, Float value) {
        _mm512_mask_i32scatter_ps(base, m, raw(index), value, 4);
    }
    static void scatter(Mask m, std::uint32_t* base, Uint index, Uint value) {
        _mm512_mask_i32scatter_epi32(base, m, raw(index), raw(value), 4);
    }
    /// base[index + 0 .. 3] in each lane: four loads of 16 bytes, transposed.
    static void gather4(const float* base, Uint index, Float (&out)[4]) {
        std::uint32_t at[width];
        std::memcpy(at, &index, sizeof(at));
        __m512 row[4];
        for (int i = 0; i < 4; ++i) {
            __m512 x = _mm512_zextps128_ps512(_mm_loadu_ps(base + at[i]));
            x = _mm512_maskz_insertf32x4(every_lane, x, _mm_loadu_ps(base + at[i + 4]),
                                         1);
            x = _mm512_maskz_insertf32x4(every_lane, x, _mm_loadu_ps(base + at[i + 8]),
                                         2);
            row[i] = _mm512_maskz_insertf32x4(every_lane, x,
                                              _mm_loadu_ps(base + at[i + 12]), 3);
        }
        const __m512 a = _mm512_maskz_unpacklo_ps(every_lane, row[0], row[1]);
        const __m512 b = _mm512_maskz_unpackhi_ps(every_lane, row[0], row[1]);
        const __m512 c = _mm512_maskz_unpacklo_ps(every_lane, row[2], row[3]);
        const __m512 d = _mm512_maskz_unpackhi_ps(every_lane, row[2], row[3]);
        const auto low = [](__m512 x, __m512 y) {
            return reinterpret_cast<Float>(_mm512_maskz_unpacklo_pd(
                0xff, reinterpret_cast<__m512d>(x), reinterpret_cast<__m512d>(y)));
        };
        const auto high = [](__m512 x, __m512 y) {
            return reinterpret_cast<Float>(_mm512_maskz_unpackhi_pd(
                0xff, reinterpret_cast<__m512d>(x), reinterpret_cast<__m512d>(y)));
        };
        out[0] = low(a, c);
        out[1] = high(a, c);
        out[2] = low(b, d);
        out[3] = high(b, d);
    }
    /// How many of base[index + 0 .. 15] are not above x.
    static Uint count_not_above(const float* base, Uint index, Float x) {
        std::uint32_t at[width], number[width];
        std::memcpy(at, &index, sizeof(at));
        for (int i = 0; i < width; ++i) {
            number[i] = static_cast<std::uint32_t>(__builtin_popcount(_mm512_cmp_ps_mask(
                _mm512_loadu_ps(base + at[i]), _mm512_set1_ps(x[i]), _CMP_LE_OQ)));
        }
        std::memcpy(&index, number, sizeof(number));
        return index;
    }
    /// The lanes of the mask moved to the front; the others are 0.
    static Uint compress(Mask m, Uint value) {
        return uint(_mm512_maskz_compress_epi32(m, raw(value)));
    }
    /// Entry `index` of a table of 16, which must be < 16.
    static Uint lookup16(const std::uint32_t* table, Uint index) {
        return uint(_mm512_maskz_permutexvar_epi32(every_lane, raw(index),
                                                   _mm512_loadu_si512(table)));
    }
    /// Within each 16 bytes: byte i of the result is byte index[i] of the table.
    static Uint shuffle_bytes(Uint table, Uint index) {
        return uint(_mm512_shuffle_epi8(raw(table), raw(index)));
    }
};

}  // namespace wide_avx512
}  // namespace raykiln
