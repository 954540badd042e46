#pragma once

#include "bsdf/fresnel.h"
#include "bsdf/microfacet.h"
#include "bsdf/sample.h"

namespace raykiln {

/// A clear interface: reflects and refracts, smooth or through microfacets. `eta` = index
/// inside over outside; the normal points outside. Radiance is scaled by the square of
/// the relative index on refraction. `thin`: both faces of a pane at once, light goes
/// straight on.
template <class F>
struct Dielectric {
    F eta;
    Vec3<F> reflectance, transmittance;
    Microfacet<F> facet;
    bool smooth = false;
    bool thin = false;
};

/// Reflectance of a thin pane: the sum over all reflections between its two faces.
template <class F>
inline F thin_reflectance(F r) {
    return select(r < F(1.0f), F(2.0f) * r / (F(1.0f) + r), F(1.0f));
}

/// Walter et al. 2007, equations 20 and 21.
template <class F>
inline BsdfValue<F> evaluate(const Dielectric<F>& b, const Vec3<F>& dir_out,
                             const Vec3<F>& dir_in) {
    if (b.smooth || b.thin) {
        return {Vec3<F>(F(0.0f)), F(0.0f)};
    }
    const auto reflected = dir_out.z * dir_in.z > F(0.0f);
    const auto outside = dir_out.z > F(0.0f);
    const F eta_it = select(outside, b.eta, F(1.0f) / b.eta);
    Vec3<F> m = select(reflected, dir_out + dir_in, dir_out + dir_in * eta_it);
    m = normalize(m);
    m = select(m.z < F(0.0f), -m, m);
    const F cos_out = dot(dir_out, m);
    const F cos_in = dot(dir_in, m);
    const F r = fresnel_dielectric(cos_out, b.eta).reflectance;
    const F d = microfacet_d(b.facet, m);
    const F g = microfacet_g(b.facet, dir_out, dir_in, m);
    // The facet is sampled for the direction as seen from above.
    const Vec3<F> upper = select(outside, dir_out, -dir_out);
    const F pdf_m = pdf_microfacet(b.facet, upper, m);
    const F scale = cos_out + eta_it * cos_in;
    const F jacobian = select(reflected, F(1.0f) / (F(4.0f) * abs(cos_out)),
                              eta_it * eta_it * abs(cos_in) / (scale * scale));
    const F spread = d * g / abs(dir_out.z);
    const Vec3<F> value =
        select(reflected, b.reflectance * (r * spread * F(0.25f)),
               b.transmittance *
                   ((F(1.0f) - r) * spread * abs(cos_out * cos_in) / (scale * scale)));
    const F pdf = pdf_m * jacobian * select(reflected, r, F(1.0f) - r);
    const auto valid =
        (abs(dir_out.z * dir_in.z) > F(0.0f)) & (g > F(0.0f)) & (pdf > F(0.0f));
    return {select(valid, value, Vec3<F>(F(0.0f))), select(valid, pdf, F(0.0f))};
}

namespace detail {

template <class F>
inline BsdfSample<F> sample_smooth(const Dielectric<F>& b, const Vec3<F>& dir_out,
                                   F u_lobe) {
    const DielectricFresnel<F> f = fresnel_dielectric(dir_out.z, b.eta);
    if (b.thin) {
        const F r =
            thin_reflectance(fresnel_dielectric(abs(dir_out.z), b.eta).reflectance);
        const auto reflects = u_lobe < r;
        return {select(reflects, reflect(dir_out), -dir_out),
                select(reflects, b.reflectance, b.transmittance), F(1.0f), F(1.0f),
                Mask<F>(true)};
    }
    const auto reflects = u_lobe < f.reflectance;
    const Vec3<F> refracted{F(0.0f) - f.eta_ti * dir_out.x,
                            F(0.0f) - f.eta_ti * dir_out.y, f.cos_transmitted};
    return {select(reflects, reflect(dir_out), refracted),
            select(reflects, b.reflectance, b.transmittance * sqr(f.eta_ti)), F(1.0f),
            select(reflects, F(1.0f), F(1.0f) / f.eta_ti), Mask<F>(true)};
}

}  // namespace detail

template <class F>
inline BsdfSample<F> sample(const Dielectric<F>& b, const Vec3<F>& dir_out,
                            const BsdfRandom<F>& u) {
    if (b.smooth || b.thin) {
        return detail::sample_smooth(b, dir_out, u.lobe);
    }
    const Vec3<F> upper = select(dir_out.z > F(0.0f), dir_out, -dir_out);
    const Vec3<F> m = sample_microfacet(b.facet, upper, u.x, u.y);
    const DielectricFresnel<F> f = fresnel_dielectric(dot(dir_out, m), b.eta);
    const auto reflects = u.lobe < f.reflectance;
    const Vec3<F> dir_in = select(reflects, reflect(dir_out, m),
                                  refract(dir_out, m, f.cos_transmitted, f.eta_ti));
    const auto right_side = reflects == (dir_out.z * dir_in.z > F(0.0f));
    const BsdfValue<F> v = evaluate(b, dir_out, dir_in);
    const auto valid = right_side & (v.pdf_solid_angle > F(0.0f));
    const F pdf = select(valid, v.pdf_solid_angle, F(1.0f));
    return {dir_in, select(valid, v.value / pdf, Vec3<F>(F(0.0f))), v.pdf_solid_angle,
            select(reflects, F(1.0f), F(1.0f) / f.eta_ti), Mask<F>(false)};
}

}  // namespace raykiln
