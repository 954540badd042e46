#pragma once

#include "bsdf/sample.h"
#include "sampling/warp.h"

namespace raykiln {

/// Lambert: f = reflectance / pi above the surface.
template <class F>
struct Diffuse {
    Vec3<F> reflectance;
};

template <class F>
inline BsdfValue<F> evaluate(const Diffuse<F>& b, const Vec3<F>& dir_out,
                             const Vec3<F>& dir_in) {
    const auto above = min(dir_out.z, dir_in.z) > F(0.0f);
    const F pdf = select(above, pdf_cosine_hemisphere(dir_in.z), F(0.0f));
    return {b.reflectance * pdf, pdf};
}

template <class F>
inline BsdfSample<F> sample(const Diffuse<F>& b, const Vec3<F>& dir_out,
                            const BsdfRandom<F>& u) {
    const Vec3<F> dir_in = sample_cosine_hemisphere(u.x, u.y);
    const auto above = min(dir_out.z, dir_in.z) > F(0.0f);
    return {dir_in, select(above, b.reflectance, Vec3<F>(F(0.0f))),
            pdf_cosine_hemisphere(dir_in.z), F(1.0f), Mask<F>(false)};
}

}  // namespace raykiln
