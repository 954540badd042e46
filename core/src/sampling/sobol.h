#pragma once

#include <array>
#include <cstdint>

#include "math/number.h"

// Owen-scrambled Sobol' points as a pure function of (seed, pixel, sample, dimension), so
// that any sample can be drawn by itself, in any order, on any machine.
//
// Dimensions come in groups of four, each a scrambled 4D Sobol' sequence with its own
// shuffled index (padding): Burley, "Practical Hash-based Owen Scrambling", JCGT 9(4),
// 2020. The hash is Laine and Karras' with the constants of Vegdahl (2021).

namespace raykiln {

/// Mixes all bits (the finaliser of MurmurHash3).
template <class U>
inline U hash_bits(U x) {
    x = x ^ (x >> 16);
    x = x * U(0x85ebca6bu);
    x = x ^ (x >> 13);
    x = x * U(0xc2b2ae35u);
    return x ^ (x >> 16);
}

template <class U>
inline U hash_combine(U seed, U value) {
    return hash_bits(seed ^ (value + U(0x9e3779b9u) + (seed << 6) + (seed >> 2)));
}

template <class U>
inline U reverse_bits(U x) {
    x = ((x >> 1) & U(0x55555555u)) | ((x & U(0x55555555u)) << 1);
    x = ((x >> 2) & U(0x33333333u)) | ((x & U(0x33333333u)) << 2);
    x = ((x >> 4) & U(0x0f0f0f0fu)) | ((x & U(0x0f0f0f0fu)) << 4);
    x = ((x >> 8) & U(0x00ff00ffu)) | ((x & U(0x00ff00ffu)) << 8);
    return (x >> 16) | (x << 16);
}

/// Owen scrambling of a number given with its bits reversed: each bit is flipped by a
/// hash of the bits below it.
template <class U>
inline U owen_hash_reversed(U x, U seed) {
    x = x ^ (x * U(0x3d20adeau));
    x = x + seed;
    x = x * ((seed >> 16) | U(1u));
    x = x ^ (x * U(0x05526c56u));
    return x ^ (x * U(0x53a22864u));
}

namespace detail {

struct SobolDimension {
    int degree;
    std::uint32_t polynomial;
    std::array<std::uint32_t, 3> initial;
};

// Dimensions 2 to 4 of Joe and Kuo (2008); dimension 1 is the radical inverse.
inline constexpr std::array<SobolDimension, 3> sobol_dimensions{
    {{1, 0, {1, 0, 0}}, {2, 1, {1, 3, 0}}, {3, 1, {1, 3, 1}}}};

/// Column i: what bit i of the index adds to the point, with the point's bits reversed.
constexpr std::array<std::uint32_t, 32> sobol_columns_reversed(const SobolDimension& d) {
    std::array<std::uint32_t, 32> v{};
    const int s = d.degree;
    for (int i = 0; i < 32; ++i) {
        if (i < s) {
            v[i] = d.initial[i] << (31 - i);
            continue;
        }
        v[i] = v[i - s] ^ (v[i - s] >> s);
        for (int k = 1; k < s; ++k) {
            if ((d.polynomial >> (s - 1 - k)) & 1u) {
                v[i] ^= v[i - k];
            }
        }
    }
    for (auto& column : v) {
        std::uint32_t reversed = 0;
        for (int bit = 0; bit < 32; ++bit) {
            reversed |= ((column >> bit) & 1u) << (31 - bit);
        }
        column = reversed;
    }
    return v;
}

inline constexpr std::array<std::array<std::uint32_t, 32>, 3> sobol_columns{
    {sobol_columns_reversed(sobol_dimensions[0]),
     sobol_columns_reversed(sobol_dimensions[1]),
     sobol_columns_reversed(sobol_dimensions[2])}};

}  // namespace detail

/// Coordinate `dimension` (0 to 3) of point `index`, bits reversed.
template <class U>
inline U sobol_reversed(U index, int dimension) {
    if (dimension == 0) {
        return index;
    }
    const auto& columns = detail::sobol_columns[static_cast<std::size_t>(dimension - 1)];
    U x(0u);
    for (int bit = 0; bit < 32; ++bit) {
        x = x ^ ((U(0u) - ((index >> bit) & U(1u))) &
                 U(columns[static_cast<std::size_t>(bit)]));
    }
    return x;
}

namespace detail {

using SobolPoint = std::array<std::uint32_t, 4>;

/// What each value of each byte of the index adds to the four coordinates.
constexpr auto sobol_byte_table() {
    std::array<std::array<SobolPoint, 256>, 4> table{};
    for (std::size_t byte = 0; byte < 4; ++byte) {
        for (std::size_t value = 1; value < 256; ++value) {
            // What the value without its lowest bit adds, and what that bit does.
            const std::size_t bit = 8 * byte + std::countr_zero(value);
            SobolPoint x = table[byte][value & (value - 1)];
            x[0] ^= 1u << bit;
            for (std::size_t d = 0; d < 3; ++d) {
                x[d + 1] ^= sobol_columns[d][bit];
            }
            table[byte][value] = x;
        }
    }
    return table;
}

inline constexpr auto sobol_bytes = sobol_byte_table();

/// What each value of half byte `part` of the index adds to coordinate `d` + 1.
constexpr auto sobol_half_byte_table() {
    std::array<std::array<std::array<std::uint32_t, 16>, 3>, 8> table{};
    for (std::size_t part = 0; part < 8; ++part) {
        for (std::size_t d = 0; d < 3; ++d) {
            for (std::size_t bit = 0; bit < 4; ++bit) {
                for (std::size_t value = 0; value < 16; ++value) {
                    if ((value >> bit) % 2 != 0) {
                        table[part][d][value] ^= sobol_columns[d][4 * part + bit];
                    }
                }
            }
        }
    }
    return table;
}

inline constexpr auto sobol_half_bytes = sobol_half_byte_table();

}  // namespace detail

/// All four coordinates of point `index`, bits reversed.
inline detail::SobolPoint sobol_point_reversed(std::uint32_t index) {
    const auto& t = detail::sobol_bytes;
    detail::SobolPoint x{};
    for (std::size_t d = 0; d < 4; ++d) {
        x[d] = t[0][index & 255u][d] ^ t[1][(index >> 8) & 255u][d];
    }
    if (index >> 16 != 0) {
        for (std::size_t d = 0; d < 4; ++d) {
            x[d] ^= t[2][(index >> 16) & 255u][d] ^ t[3][index >> 24][d];
        }
    }
    return x;
}
template <class U>
inline std::array<U, 4> sobol_point_reversed(U index) {
    std::array<U, 4> x{index, U(0u), U(0u), U(0u)};
    const std::size_t parts = any(index >> 16 != U(0u)) ? 8 : 4;
    for (std::size_t part = 0; part < parts; ++part) {
        const U value = (index >> static_cast<int>(4 * part)) & U(15u);
        for (std::size_t d = 0; d < 3; ++d) {
            x[d + 1] = x[d + 1] ^ lookup16(detail::sobol_half_bytes[part][d], value);
        }
    }
    return x;
}

}  // namespace raykiln
