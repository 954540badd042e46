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

/// Four dimensions of an Owen-scrambled Sobol' sequence; `group` numbers the dimensions
/// by fours.
template <class F>
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
        const U dimension_seed =
            hash_combine(seed, U(static_cast<std::uint32_t>(d) + 1u));
        x[d] = reverse_bits(owen_hash_reversed(x[d], dimension_seed));
    }
    for (std::size_t d = 0; d < 4; ++d) {
        out[d] = unit_from_bits(x[d]);
    }
    return out;
}

/// Four independent random numbers.
template <class F>
inline Sample4<F> independent_sample(const SampleKey<F>& key, std::uint32_t group) {
    using U = Uint<F>;
    const U base = hash_combine(hash_combine(key.pixel, key.index), U(group));
    Sample4<F> out;
    for (int d = 0; d < 4; ++d) {
        const U bits = hash_combine(base, U(static_cast<std::uint32_t>(d)));
        out[static_cast<std::size_t>(d)] = unit_from_bits(bits);
    }
    return out;
}

template <class F>
inline Sample4<F> sample_4d(SamplerKind kind, const SampleKey<F>& key,
                            std::uint32_t group) {
    return kind == SamplerKind::sobol ? sobol_sample(key, group)
                                      : independent_sample(key, group);
}

}  // namespace raykiln
