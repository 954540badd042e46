#pragma once

#include <immintrin.h>

#include <cstdint>
#include <cstring>

// What math/wide.h asks of an instruction set: here AVX2 with FMA (x86-64-v3), 8 lanes.

namespace raykiln {
inline namespace wide_avx2 {

struct WideIsa {
    static constexpr int width = 8;
    static constexpr const char* name = "avx2";

    typedef float Float __attribute__((vector_size(32)));
    typedef std::uint32_t Uint __attribute__((vector_size(32)));
    typedef std::int32_t Int __attribute__((vector_size(32)));
    using Mask = Int;  ///< -1 where set, else 0

    static __m256i raw(Uint a) { return reinterpret_cast<__m256i>(a); }
    static Uint uint(__m256i a) { return reinterpret_cast<Uint>(a); }
    static __m256 lanes(Mask m) { return reinterpret_cast<__m256>(m); }

    static Mask mask_of(bool all) { return Mask{} - static_cast<std::int32_t>(all); }
    static Mask mask_of_bits(std::uint32_t bits) {
        const Uint lane_bit{1, 2, 4, 8, 16, 32, 64, 128};
        return (lane_bit & bits) != Uint{};
    }
    static std::uint32_t bits(Mask m) {
        return static_cast<std::uint32_t>(_mm256_movemask_ps(lanes(m)));
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
        return _mm256_blendv_ps(b, a, lanes(m));
    }
    static Uint select(Mask m, Uint a, Uint b) {
        return uint(_mm256_blendv_epi8(raw(b), raw(a), reinterpret_cast<__m256i>(m)));
    }
    static Float min(Float a, Float b) { return _mm256_min_ps(a, b); }
    static Float max(Float a, Float b) { return _mm256_max_ps(a, b); }
    static Uint min(Uint a, Uint b) { return uint(_mm256_min_epu32(raw(a), raw(b))); }
    static Uint max(Uint a, Uint b) { return uint(_mm256_max_epu32(raw(a), raw(b))); }
    static Float sqrt(Float a) { return _mm256_sqrt_ps(a); }
    static Float floor(Float a) { return _mm256_floor_ps(a); }

    static Float gather(const float* base, Uint index) {
        return _mm256_i32gather_ps(base, raw(index), 4);
    }
    static Uint gather(const std::uint32_t* base, Uint index) {
        return uint(
            _mm256_i32gather_epi32(reinterpret_cast<const int*>(base), raw(index), 4));
    }
    static Float gather(Mask m, const float* base, Uint index, Float otherwise) {
        return _mm256_mask_i32gather_ps(otherwise, base, raw(index), lanes(m), 4);
    }
    static Uint gather(Mask m, const std::uint32_t* base, Uint index, Uint otherwise) {
        return uint(_mm256_mask_i32gather_epi32(
            raw(otherwise), reinterpret_cast<const int*>(base), raw(index),
            reinterpret_cast<__m256i>(m), 4));
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
        __m256 row[4];
        for (int i = 0; i < 4; ++i) {
            row[i] =
                _mm256_insertf128_ps(_mm256_castps128_ps256(_mm_loadu_ps(base + at[i])),
                                     _mm_loadu_ps(base + at[i + 4]), 1);
        }
        const __m256 a = _mm256_unpacklo_ps(row[0], row[1]);
        const __m256 b = _mm256_unpackhi_ps(row[0], row[1]);
        const __m256 c = _mm256_unpacklo_ps(row[2], row[3]);
        const __m256 d = _mm256_unpackhi_ps(row[2], row[3]);
        const auto low = [](__m256 x, __m256 y) {
            return reinterpret_cast<Float>(_mm256_unpacklo_pd(
                reinterpret_cast<__m256d>(x), reinterpret_cast<__m256d>(y)));
        };
        const auto high = [](__m256 x, __m256 y) {
            return reinterpret_cast<Float>(_mm256_unpackhi_pd(
                reinterpret_cast<__m256d>(x), reinterpret_cast<__m256d>(y)));
        };
        out[0] = low(a, c);
        out[1] = high(a, c);
        out[2] = low(b, d);
        out[3] = high(b, d);
    }
    /// How many of base[index + 0 .. 15] are not above x.
    static Uint count_not_above(const float* base, Uint index, Float x) {
        const auto counted = [](const float* row, __m256 most) {
            const __m256 below = _mm256_cmp_ps(_mm256_loadu_ps(row), most, _CMP_LE_OQ);
            return __builtin_popcount(static_cast<unsigned>(_mm256_movemask_ps(below)));
        };
        Uint number{};
        for (int i = 0; i < width; ++i) {
            const float* row = base + index[i];
            const __m256 most = _mm256_set1_ps(x[i]);
            number[i] =
                static_cast<std::uint32_t>(counted(row, most) + counted(row + 8, most));
        }
        return number;
    }
    /// The lanes of the mask moved to the front; the others are unspecified.
    static Uint compress(Mask m, Uint value) {
        const std::uint64_t bytes = _pdep_u64(bits(m), 0x0101010101010101u) * 0xffu;
        const std::uint64_t order = _pext_u64(0x0706050403020100u, bytes);
        const __m256i lane =
            _mm256_cvtepu8_epi32(_mm_cvtsi64_si128(static_cast<long long>(order)));
        return uint(_mm256_permutevar8x32_epi32(raw(value), lane));
    }
    /// Entry `index` of a table of 16, which must be < 16.
    static Uint lookup16(const std::uint32_t* table, Uint index) {
        const auto* half = reinterpret_cast<const __m256i*>(table);
        const __m256i low =
            _mm256_permutevar8x32_epi32(_mm256_loadu_si256(half), raw(index));
        const __m256i high =
            _mm256_permutevar8x32_epi32(_mm256_loadu_si256(half + 1), raw(index));
        // Bit 3 of the index, moved to the sign, chooses the half.
        return reinterpret_cast<Uint>(select(reinterpret_cast<Mask>(index << 28),
                                             reinterpret_cast<Float>(high),
                                             reinterpret_cast<Float>(low)));
    }
    /// Within each 16 bytes: byte i of the result is byte index[i] of the table.
    static Uint shuffle_bytes(Uint table, Uint index) {
        return uint(_mm256_shuffle_epi8(raw(table), raw(index)));
    }
};

}  // namespace wide_avx2
}  // namespace raykiln
