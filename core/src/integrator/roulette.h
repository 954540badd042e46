#pragma once

#include "math/vec.h"

namespace raykiln {

/// Probability with which Russian roulette lets a path go on. The root, as what a path
/// brings does not shrink as its throughput does; `eta_scale` takes out what refractions
/// did to the radiance.
template <class F>
inline F survival_probability(const Vec3<F>& throughput, F eta_scale) {
    return min(sqrt(max_component(throughput)) * eta_scale, F(0.95f));
}

}  // namespace raykiln
