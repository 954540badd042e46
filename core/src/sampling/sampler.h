#pragma once

#include <array>

#include "math/vec.h"
#include "sampling/sobol.h"

namespace raykiln {

enum class SamplerKind : std::uint8_t { sobol, independent };

/// Names one sample: everything drawn for it is a pure function of this and a group
/// number.
template <class F>
struct SampleKey {
    Uint<F> pixel;  ///< hash of seed and pixel
    Uint<F> index;  ///< number of the sample within the pixel
};

inline SampleKey<float> sample_key(std::uint32_t seed, std::uint32_t x, std::uint32_t y,
                                   std::uint32_t index) {
    return {hash_combine(hash_combine(hash_bits(seed + 0x68bc21ebu), x), y), index};
}

/// Four numbers in [0, 1).
template <class F>
using Sample4 = std::array<F, 4>;

// Which of the four are wanted, a bit each: the others are 0 and cost nothing.
constexpr std::uint32_t all_four = 0b1111, first_two = 0b0011, first_three = 0b0111,
                        the_third = 0b0100, the_fourth = 0b1000;

/// Four dimensions of an Owen-scrambled Sobol' sequence; `group` numbers the dimensions
/// by fours.
template <class F, std::uint32_t wanted = all_four>
inline Sample4<F> sobol_sample(const SampleKey<F>& key, std::uint32_t group) {
    using U = Uint<F>;
    const U seed = hash_combine(key.pixel, U(group));
    // Shuffling the index decorrelates the groups and keeps the net property of each.
    // Within blocks of 2^16 samples: bits above those would only add to the scrambling.
    const U low(0xffffu);
    const U shuffled = reverse_bits(owen_hash_reversed(reverse_bits(key.index), seed));
    const U index = (shuffled & low) | (key.index & ~low);
    std::array<U, 4> x = sobol_point_reversed(index);
    Sample4<F> out;
    for (std::size_t d = 0; d < 4; ++d) {
        if ((wanted >> d & 1u) == 0) {
            out[d] = F(0.0f);
            continue;
        }
        const U dimension_seed =
            hash_combine(seed, U(static_cast<std::uint32_t>(d) + 1u));
        out[d] = unit_from_bits(reverse_bits(owen_hash_reversed(x[d], dimension_seed)));
    }
    return out;
}

/// Four independent random numbers.
template <class F, std::uint32_t wanted = all_four>
inline Sample4<F> independent_sample(const SampleKey<F>& key, std::uint32_t group) {
    using U = Uint<F>;
    const U base = hash_combine(hash_combine(key.pixel, key.index), U(group));
    Sample4<F> out;
    for (std::size_t d = 0; d < 4; ++d) {
        const U bits = hash_combine(base, U(static_cast<std::uint32_t>(d)));
        out[d] = (wanted >> d & 1u) != 0 ? unit_from_bits(bits) : F(0.0f);
    }
    return out;
}

template <class F, std::uint32_t wanted = all_four>
inline Sample4<F> sample_4d(SamplerKind kind, const SampleKey<F>& key,
                            std::uint32_t group) {
    return kind == SamplerKind::sobol ? sobol_sample<F, wanted>(key, group)
                                      : independent_sample<F, wanted>(key, group);
}

}  // namespace raykiln
