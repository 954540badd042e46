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

}  // namespace raykiln
