#pragma once

#include "bsdf/fresnel.h"
#include "bsdf/ggx_albedo.h"
#include "bsdf/microfacet.h"
#include "bsdf/sample.h"

namespace raykiln {

/// Metallic-roughness material after glTF 2.0, appendix B, with KHR_materials_ior,
/// _specular and _transmission (thin-walled: transmitted light keeps its direction but
/// for the roughness).
template <class F>
struct Principled {
    Vec3<F> base_color;
    Vec3<F> dielectric_f0;  ///< reflectance head-on of the dielectric part
    F dielectric_f90;       ///< its reflectance at grazing angles
    F metallic, transmission;
    Microfacet<F> facet;  ///< GGX with alpha = roughness squared
};

namespace detail {

/// Probabilities of the three lobes; they add to 1.
template <class F>
struct PrincipledLobes {
    F specular, diffuse, transmission;
};

template <class F>
inline PrincipledLobes<F> principled_lobes(const Principled<F>& b, F cos_out) {
    const Vec3<F> f_d =
        fresnel_schlick(cos_out, b.dielectric_f0, Vec3<F>(b.dielectric_f90));
    const Vec3<F> f_m = fresnel_schlick(cos_out, b.base_color, Vec3<F>(F(1.0f)));
    const F entered = (F(1.0f) - b.metallic) * (F(1.0f) - max_component(f_d));
    const F color = max(luminance(b.base_color), F(1e-4f));
    const F specular = max(lerp(luminance(f_d), luminance(f_m), b.metallic), F(0.02f));
    const F diffuse = entered * color * (F(1.0f) - b.transmission);
    const F transmission = entered * color * b.transmission;
    const F scale = F(1.0f) / (specular + diffuse + transmission);
    return {specular * scale, diffuse * scale, transmission * scale};
}

/// Share of the light that the diffuse base gets between two directions: what the surface
/// leaves at both, scaled so that together they reflect all (Kelemen and Szirmay-Kalos
/// 2001). With the facet's Fresnel term in its place, as in glTF's appendix, smooth
/// surfaces would give off half more light at grazing angles than comes in.
template <class F>
inline F base_share(const Principled<F>& b, F cos_out, F cos_in) {
    const F f0 = max_component(b.dielectric_f0);
    const F out = ggx_albedo(b.facet.alpha_x, cos_out).with_fresnel(f0, b.dielectric_f90);
    const F in = ggx_albedo(b.facet.alpha_x, cos_in).with_fresnel(f0, b.dielectric_f90);
    const F mean = ggx_mean_albedo(b.facet.alpha_x).with_fresnel(f0, b.dielectric_f90);
    return (F(1.0f) - out) * (F(1.0f) - in) / max(F(1.0f) - mean, F(1e-3f));
}

}  // namespace detail

template <class F>
inline BsdfValue<F> evaluate(const Principled<F>& b, const Vec3<F>& dir_out,
                             const Vec3<F>& dir_in) {
    const auto through = dir_in.z < F(0.0f);
    // Transmission is the reflection lobe, mirrored to the other side of the wall.
    const Vec3<F> upper{dir_in.x, dir_in.y, abs(dir_in.z)};
    const auto valid = (dir_out.z > F(0.0f)) & (upper.z > F(0.0f));
    const Vec3<F> m = normalize(dir_out + upper);
    const F cosine = dot(dir_out, m);
    const F d = microfacet_d(b.facet, m);
    const F spread = d * ggx_visibility_correlated(b.facet, dir_out, upper) * upper.z;
    const F pdf_facet =
        pdf_microfacet(b.facet, dir_out, m) / (F(4.0f) * max(cosine, F(1e-12f)));
    const F pdf_cosine = pdf_cosine_hemisphere(upper.z);

    const Vec3<F> f_d =
        fresnel_schlick(cosine, b.dielectric_f0, Vec3<F>(b.dielectric_f90));
    const Vec3<F> f_m = fresnel_schlick(cosine, b.base_color, Vec3<F>(F(1.0f)));
    const Vec3<F> base = b.base_color * (F(1.0f) - b.metallic);
    const Vec3<F> passed = base * (F(1.0f) - max_component(f_d));
    const auto lobes = detail::principled_lobes(b, dir_out.z);

    const Vec3<F> reflected = lerp(f_d, f_m, b.metallic) * spread +
                              base * (detail::base_share(b, dir_out.z, upper.z) *
                                      (F(1.0f) - b.transmission) * pdf_cosine);
    const Vec3<F> transmitted = passed * (b.transmission * spread);
    const F pdf = select(through, lobes.transmission * pdf_facet,
                         lobes.specular * pdf_facet + lobes.diffuse * pdf_cosine);
    const Vec3<F> value = select(through, transmitted, reflected);
    return {select(valid, value, Vec3<F>(F(0.0f))), select(valid, pdf, F(0.0f))};
}

template <class F>
inline BsdfSample<F> sample(const Principled<F>& b, const Vec3<F>& dir_out,
                            const BsdfRandom<F>& u) {
    const auto lobes = detail::principled_lobes(b, dir_out.z);
    const Vec3<F> m = sample_microfacet(b.facet, dir_out, u.x, u.y);
    const Vec3<F> mirrored = reflect(dir_out, m);
    const Vec3<F> passed{mirrored.x, mirrored.y, F(0.0f) - mirrored.z};
    const auto diffuse = u.lobe < lobes.diffuse;
    const auto through = u.lobe >= lobes.diffuse + lobes.specular;
    Vec3<F> dir_in = select(through, passed, mirrored);
    dir_in = select(diffuse, sample_cosine_hemisphere(u.x, u.y), dir_in);
    const auto right_side = through == (dir_in.z < F(0.0f));
    const BsdfValue<F> v = evaluate(b, dir_out, dir_in);
    const auto valid = right_side & (v.pdf_solid_angle > F(0.0f));
    const F pdf = select(valid, v.pdf_solid_angle, F(1.0f));
    return {dir_in, select(valid, v.value / pdf, Vec3<F>(F(0.0f))), v.pdf_solid_angle,
            F(1.0f), Mask<F>(false)};
}

}  // namespace raykiln
