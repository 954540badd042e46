#pragma once

#include "bsdf/fresnel.h"
#include "bsdf/ggx_albedo.h"
#include "bsdf/microfacet.h"
#include "bsdf/sample.h"
#include "scene/material.h"

namespace raykiln {

/// A diffuse base under a dielectric coat, smooth or rough. Light scattered back and
/// forth below the coat is summed in closed form, as the internal reflectance is the same
/// for all directions.
template <class F>
struct Plastic {
    F eta;
    Vec3<F> diffuse, specular;
    Microfacet<F> facet;
    const InterfaceTable* table = nullptr;
    bool smooth = false;
    bool nonlinear = false;
};

template <class F>
inline F interpolate_transmittance(const InterfaceTable& table, F cosine) {
    const detail::Place<F> at(cosine, InterfaceTable::size);
    return lerp(gather(table.transmittance, at.node),
                gather(table.transmittance, at.node + Uint<F>(1u)), at.rest);
}

namespace detail {

/// Share of the light at this angle that enters the coat.
template <class F>
inline F coat_transmittance(const Plastic<F>& b, F cosine) {
    if (b.smooth) {
        return F(1.0f) - fresnel_dielectric(cosine, b.eta).reflectance;
    }
    return interpolate_transmittance(*b.table, cosine);
}

/// f of the base without the two transmittances and 1 / pi.
template <class F>
inline Vec3<F> base_albedo(const Plastic<F>& b) {
    const Vec3<F> r(F(b.table->internal_reflectance));
    const Vec3<F> trapped = b.nonlinear ? b.diffuse * r : r;
    return b.diffuse / (Vec3<F>(F(1.0f)) - trapped) / (b.eta * b.eta);
}

/// Probability of choosing the coat's reflection.
template <class F>
inline F coat_probability(const Plastic<F>& b, F transmittance) {
    const F s = mean(b.specular);
    const F d = mean(b.diffuse);
    const F coat = (F(1.0f) - transmittance) * s;
    const F base = transmittance * d;
    return select(coat + base > F(0.0f), coat / (coat + base), F(1.0f));
}

}  // namespace detail

template <class F>
inline BsdfValue<F> evaluate(const Plastic<F>& b, const Vec3<F>& dir_out,
                             const Vec3<F>& dir_in) {
    const auto above = min(dir_out.z, dir_in.z) > F(0.0f);
    const F t_out = detail::coat_transmittance(b, dir_out.z);
    const F t_in = detail::coat_transmittance(b, dir_in.z);
    const F p_coat = detail::coat_probability(b, t_out);
    const F pdf_base = pdf_cosine_hemisphere(dir_in.z);
    Vec3<F> value = detail::base_albedo(b) * (t_out * t_in * pdf_base);
    F pdf = pdf_base * (F(1.0f) - p_coat);
    if (!b.smooth) {
        const Vec3<F> m = normalize(dir_out + dir_in);
        const F cosine = dot(dir_out, m);
        const F d = microfacet_d(b.facet, m);
        const F g = microfacet_g(b.facet, dir_out, dir_in, m);
        const F fresnel = fresnel_dielectric(cosine, b.eta).reflectance;
        value += b.specular * (fresnel * d * g / (F(4.0f) * dir_out.z));
        pdf = pdf + p_coat * pdf_microfacet(b.facet, dir_out, m) / (F(4.0f) * cosine);
    }
    return {select(above, value, Vec3<F>(F(0.0f))), select(above, pdf, F(0.0f))};
}

template <class F>
inline BsdfSample<F> sample(const Plastic<F>& b, const Vec3<F>& dir_out,
                            const BsdfRandom<F>& u) {
    const F t_out = detail::coat_transmittance(b, dir_out.z);
    const F p_coat = detail::coat_probability(b, t_out);
    const auto coat = u.lobe < p_coat;
    Vec3<F> dir_in = sample_cosine_hemisphere(u.x, u.y);
    if (b.smooth) {
        dir_in = select(coat, reflect(dir_out), dir_in);
    } else {
        dir_in =
            select(coat, reflect(dir_out, sample_microfacet(b.facet, dir_out, u.x, u.y)),
                   dir_in);
    }
    const BsdfValue<F> v = evaluate(b, dir_out, dir_in);
    const auto valid = v.pdf_solid_angle > F(0.0f);
    const F pdf = select(valid, v.pdf_solid_angle, F(1.0f));
    Vec3<F> weight = select(valid, v.value / pdf, Vec3<F>(F(0.0f)));
    const Mask<F> mirror = coat & Mask<F>(b.smooth);
    const auto above = dir_out.z > F(0.0f);
    const Vec3<F> mirror_weight =
        b.specular * ((F(1.0f) - t_out) / max(p_coat, F(1e-20f)));
    weight = select(mirror, select(above, mirror_weight, Vec3<F>(F(0.0f))), weight);
    return {dir_in, weight, v.pdf_solid_angle, F(1.0f), mirror};
}

}  // namespace raykiln
