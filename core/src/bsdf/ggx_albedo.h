#pragma once

#include "math/number.h"

namespace raykiln {

/// Share of light that a GGX surface reflects, as a sum over Schlick's two ends: `at_f0`
/// times the reflectance head-on plus `at_f90` times that at grazing angles.
template <class F>
struct GgxAlbedo {
    F at_f0, at_f90;

    F with_fresnel(F f0, F f90) const { return f0 * at_f0 + f90 * at_f90; }
};

namespace detail {

constexpr std::uint32_t ggx_cosines = 48;
constexpr std::uint32_t ggx_roughnesses = 24;

/// Nodes are even in the root of the cosine: towards grazing angles Fresnel's reflectance
/// rises too steeply for even cosines.
struct GgxTable {
    GgxAlbedo<float> towards[ggx_roughnesses * ggx_cosines];  ///< cosines run fastest
    GgxAlbedo<float> mean[ggx_roughnesses];
};
const GgxTable& ggx_table();

/// A place between two of n even nodes over [0, 1].
template <class F>
struct Place {
    Uint<F> node;
    F rest;

    Place(F x, std::uint32_t n) {
        const F scaled = clamp(x, F(0.0f), F(1.0f)) * F(static_cast<float>(n - 1));
        node = min(to_uint(scaled), Uint<F>(n - 2));
        rest = scaled - to_float(node);
    }
};

template <class F>
inline GgxAlbedo<F> entry(const GgxAlbedo<float>* table, Uint<F> index) {
    const Uint<F> at = index * Uint<F>(2u);
    return {gather(&table->at_f0, at), gather(&table->at_f90, at)};
}
template <class F>
inline GgxAlbedo<F> mix(const GgxAlbedo<F>& a, const GgxAlbedo<F>& b, F t) {
    return {lerp(a.at_f0, b.at_f0, t), lerp(a.at_f90, b.at_f90, t)};
}

}  // namespace detail

/// Towards one direction, for height-correlated shadowing; from a table.
template <class F>
inline GgxAlbedo<F> ggx_albedo(F alpha, F cosine) {
    using U = Uint<F>;
    const detail::Place<F> r(sqrt(alpha), detail::ggx_roughnesses);
    const detail::Place<F> c(safe_sqrt(cosine), detail::ggx_cosines);
    const auto* table = detail::ggx_table().towards;
    const U low = r.node * U(detail::ggx_cosines) + c.node;
    const U high = low + U(detail::ggx_cosines);
    return detail::mix(detail::mix(detail::entry<F>(table, low),
                                   detail::entry<F>(table, low + U(1u)), c.rest),
                       detail::mix(detail::entry<F>(table, high),
                                   detail::entry<F>(table, high + U(1u)), c.rest),
                       r.rest);
}

/// The cosine-weighted mean over all directions.
template <class F>
inline GgxAlbedo<F> ggx_mean_albedo(F alpha) {
    const detail::Place<F> r(sqrt(alpha), detail::ggx_roughnesses);
    const auto* table = detail::ggx_table().mean;
    return detail::mix(detail::entry<F>(table, r.node),
                       detail::entry<F>(table, r.node + Uint<F>(1u)), r.rest);
}

}  // namespace raykiln
