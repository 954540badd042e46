#pragma once

#include "bsdf/fresnel.h"
#include "bsdf/microfacet.h"
#include "bsdf/sample.h"

namespace raykiln {

/// A metal: mirror or microfacet reflection with the Fresnel reflectance of eta + i k.
template <class F>
struct Conductor {
    Vec3<F> eta, k, reflectance;
    Microfacet<F> facet;
    bool smooth = false;
};

/// Walter et al. 2007, equation 20.
template <class F>
inline BsdfValue<F> evaluate(const Conductor<F>& b, const Vec3<F>& dir_out,
                             const Vec3<F>& dir_in) {
    const auto above = min(dir_out.z, dir_in.z) > F(0.0f);
    if (b.smooth || !any(above)) {
        return {Vec3<F>(F(0.0f)), F(0.0f)};
    }
    const Vec3<F> m = normalize(dir_out + dir_in);
    const F cosine = dot(dir_out, m);
    const F d = microfacet_d(b.facet, m);
    const F g = microfacet_g(b.facet, dir_out, dir_in, m);
    const Vec3<F> fresnel = fresnel_conductor(cosine, b.eta, b.k) * b.reflectance;
    const F pdf = pdf_microfacet(b.facet, dir_out, m) / (F(4.0f) * cosine);
    const Vec3<F> value = fresnel * (d * g / (F(4.0f) * dir_out.z));
    return {select(above, value, Vec3<F>(F(0.0f))), select(above, pdf, F(0.0f))};
}

template <class F>
inline BsdfSample<F> sample(const Conductor<F>& b, const Vec3<F>& dir_out,
                            const BsdfRandom<F>& u) {
    if (b.smooth) {
        const auto above = dir_out.z > F(0.0f);
        const Vec3<F> fresnel = fresnel_conductor(dir_out.z, b.eta, b.k) * b.reflectance;
        return {reflect(dir_out), select(above, fresnel, Vec3<F>(F(0.0f))), F(1.0f),
                F(1.0f), Mask<F>(true)};
    }
    const Vec3<F> m = sample_microfacet(b.facet, dir_out, u.x, u.y);
    const Vec3<F> dir_in = reflect(dir_out, m);
    const BsdfValue<F> v = evaluate(b, dir_out, dir_in);
    const auto valid = v.pdf_solid_angle > F(0.0f);
    const F pdf = select(valid, v.pdf_solid_angle, F(1.0f));
    return {dir_in, select(valid, v.value / pdf, Vec3<F>(F(0.0f))), v.pdf_solid_angle,
            F(1.0f), Mask<F>(false)};
}

}  // namespace raykiln
