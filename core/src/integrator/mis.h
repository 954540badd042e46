#pragma once

#include "integrator/context.h"
#include "sampling/warp.h"

namespace raykiln {

/// Weight of light that the BSDF's sampling found, given the densities of both ways.
template <class F>
inline F weight_of_bsdf(Strategy strategy, F pdf_bsdf, F pdf_light) {
    switch (strategy) {
        case Strategy::light_only:
            return F(0.0f);
        case Strategy::bsdf_only:
            return F(1.0f);
        case Strategy::mis:
            break;
    }
    return mis_weight_of_bsdf(pdf_bsdf, pdf_light);
}

/// The same of light that light sampling found; `delta`: nothing else can find it.
template <class F>
inline F weight_of_light(Strategy strategy, Mask<F> delta, F pdf_light, F pdf_bsdf) {
    if (strategy == Strategy::light_only) {
        return F(1.0f);
    }
    const F other = strategy == Strategy::bsdf_only
                        ? F(0.0f)
                        : mis_weight_of_light(pdf_light, pdf_bsdf);
    return select(delta, F(1.0f), other);
}

/// Where light samples alone find the lights of a scene's surfaces, if these look small:
/// on surfaces that have no direction of their own, whose density is at most 1 / pi.
template <class B>
inline bool leaves_small_lights(Strategy, const B&) {
    return false;
}
template <class F>
inline bool leaves_small_lights(Strategy strategy, const Diffuse<F>&) {
    return strategy == Strategy::mis;
}
inline bool leaves_small_lights(Strategy strategy, const Bsdf& bsdf) {
    return std::visit([&](const auto& b) { return leaves_small_lights(strategy, b); },
                      bsdf);
}

}  // namespace raykiln
