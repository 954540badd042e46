#pragma once

#include <array>

#include "math/vec.h"

// One member of the elements of an array, an element a lane.

namespace raykiln {

/// The value of the first lane.
inline std::uint32_t first_lane(std::uint32_t x) {
    return x;
}
template <class U>
inline std::uint32_t first_lane(const U& x) {
    return x.lane(0);
}

namespace detail {

template <class T>
constexpr std::uint32_t words = sizeof(T) / sizeof(float);

}  // namespace detail

template <class F, class T>
inline F gather_member(const T* array, float T::* member, Uint<F> index) {
    static_assert(sizeof(T) % sizeof(float) == 0);
    return gather(&(array->*member), index * Uint<F>(detail::words<T>));
}
template <class F, class T>
inline Uint<F> gather_member(const T* array, std::uint32_t T::* member, Uint<F> index) {
    static_assert(sizeof(T) % sizeof(float) == 0);
    return gather(&(array->*member), index * Uint<F>(detail::words<T>));
}
template <class F, class T>
inline Vec2<F> gather_member(const T* array, Vec2f T::* member, Uint<F> index) {
    static_assert(sizeof(T) % sizeof(float) == 0);
    const Vec2f& first = array->*member;
    const Uint<F> at = index * Uint<F>(detail::words<T>);
    return {gather(&first.x, at), gather(&first.y, at)};
}
template <class F, class T>
inline Vec3<F> gather_member(const T* array, Vec3f T::* member, Uint<F> index) {
    static_assert(sizeof(T) % sizeof(float) == 0);
    const Vec3f& first = array->*member;
    const Uint<F> at = index * Uint<F>(detail::words<T>);
    return {gather(&first.x, at), gather(&first.y, at), gather(&first.z, at)};
}
/// base[index .. index + 2] in each lane, of an array of `size` >= 4 words: four at once,
/// the last three from one before them.
template <class F>
inline std::array<F, 3> gather3(const float* base, std::uint32_t size, Uint<F> index) {
    const Uint<F> begin = min(index, Uint<F>(size - 4));
    const std::array<F, 4> four = gather4(base, begin);
    const auto last = begin != index;
    return {select(last, four[1], four[0]), select(last, four[2], four[1]),
            select(last, four[3], four[2])};
}
/// `count` words (a multiple of four) of an element, from word `first` on: much cheaper
/// than as many gathers. Words that are no floats keep their bits (`as_uint`).
template <class F, std::uint32_t count, class T>
inline std::array<F, count> gather_row(const T* array, Uint<F> index,
                                       std::uint32_t first = 0) {
    static_assert(sizeof(T) % sizeof(float) == 0 && count % 4 == 0);
    const auto* words = reinterpret_cast<const float*>(array) + first;
    const Uint<F> at = index * Uint<F>(detail::words<T>);
    std::array<F, count> row;
    for (std::uint32_t i = 0; i < count; i += 4) {
        const std::array<F, 4> four = gather4(words + i, at);
        for (std::uint32_t k = 0; k < 4; ++k) {
            row[i + k] = four[k];
        }
    }
    return row;
}

}  // namespace raykiln
