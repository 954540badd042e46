#pragma once

#include "sampling/warp.h"

// Microfacet surfaces (Walter et al. 2007, "Microfacet Models for Refraction through
// Rough Surfaces"; Heitz 2014, JCGT 3(2)). Directions are in the shading frame, normal
// +z.

namespace raykiln {

template <class F>
struct Microfacet {
    F alpha_x, alpha_y;
    bool beckmann = false;  ///< the same for all lanes: it belongs to the material
};

/// Narrower distributions are beyond float precision.
constexpr float min_alpha = 1e-4f;

/// Density D(m) of microfacet normals, per solid angle and projected area.
template <class F>
inline F microfacet_d(const Microfacet<F>& mf, const Vec3<F>& m) {
    const F x = m.x / mf.alpha_x;
    const F y = m.y / mf.alpha_y;
    const F z2 = m.z * m.z;
    const F area = F(pi) * mf.alpha_x * mf.alpha_y;
    const F slope2 = (x * x + y * y) / z2;
    const F d = mf.beckmann ? exp(F(0.0f) - slope2) / (area * z2 * z2)
                            : F(1.0f) / (area * sqr(z2 * (F(1.0f) + slope2)));
    return select(m.z > F(0.0f), d, F(0.0f));
}

/// Smith's shadowing of one direction. Beckmann: Walter's rational fit (equation 27).
template <class F>
inline F microfacet_g1(const Microfacet<F>& mf, const Vec3<F>& v, const Vec3<F>& m) {
    const F xy_alpha2 = sqr(mf.alpha_x * v.x) + sqr(mf.alpha_y * v.y);
    const F tan2_alpha2 = xy_alpha2 / (v.z * v.z);
    F g;
    if (mf.beckmann) {
        const F a = F(1.0f) / sqrt(max(tan2_alpha2, F(1e-20f)));
        const F a2 = a * a;
        const F fit =
            (F(3.535f) * a + F(2.181f) * a2) / (F(1.0f) + F(2.276f) * a + F(2.577f) * a2);
        g = select(a >= F(1.6f), F(1.0f), fit);
    } else {
        g = F(2.0f) / (F(1.0f) + sqrt(F(1.0f) + tan2_alpha2));
    }
    const auto same_side = dot(v, m) * v.z > F(0.0f);
    return select(same_side, g, F(0.0f));
}

/// Shadowing and masking, the two directions taken as independent (as Walter et al. do).
template <class F>
inline F microfacet_g(const Microfacet<F>& mf, const Vec3<F>& a, const Vec3<F>& b,
                      const Vec3<F>& m) {
    return microfacet_g1(mf, a, m) * microfacet_g1(mf, b, m);
}

/// Height-correlated GGX shadowing and masking over (4 |a.z| |b.z|), as glTF 2.0 uses it
/// (Heitz 2014, equation 99); both directions above the surface.
template <class F>
inline F ggx_visibility_correlated(const Microfacet<F>& mf, const Vec3<F>& a,
                                   const Vec3<F>& b) {
    const auto stretched = [&](const Vec3<F>& v) {
        return sqrt(sqr(mf.alpha_x * v.x) + sqr(mf.alpha_y * v.y) + v.z * v.z);
    };
    const F sum = abs(b.z) * stretched(a) + abs(a.z) * stretched(b);
    return F(0.5f) / max(sum, F(1e-20f));
}

/// Visible normal for a direction above the surface (v.z > 0), GGX: spherical caps
/// (Dupuy and Benyoub 2023); Beckmann: by D(m) cos. See `pdf_microfacet` for the density.
template <class F>
inline Vec3<F> sample_microfacet(const Microfacet<F>& mf, const Vec3<F>& v, F u1, F u2) {
    if (mf.beckmann) {
        const F slope = sqrt(F(0.0f) - log(max(F(1.0f) - u1, F(1e-7f))));
        F sine, cosine;
        sin_cos_turns(u2, sine, cosine);
        return normalize(
            Vec3<F>{mf.alpha_x * slope * cosine, mf.alpha_y * slope * sine, F(1.0f)});
    }
    const Vec3<F> stretched = normalize(Vec3<F>{mf.alpha_x * v.x, mf.alpha_y * v.y, v.z});
    const F z = (F(1.0f) - u1) * (F(1.0f) + stretched.z) - stretched.z;
    const F r = safe_sqrt(F(1.0f) - z * z);
    F sine, cosine;
    sin_cos_turns(u2, sine, cosine);
    const Vec3<F> h = Vec3<F>{r * cosine, r * sine, z} + stretched;
    return normalize(Vec3<F>{mf.alpha_x * h.x, mf.alpha_y * h.y, max(h.z, F(1e-12f))});
}

/// Density over solid angle of the normals that `sample_microfacet` returns for v.
template <class F>
inline F pdf_microfacet(const Microfacet<F>& mf, const Vec3<F>& v, const Vec3<F>& m) {
    const F d = microfacet_d(mf, m);
    if (mf.beckmann) {
        return d * m.z;
    }
    return d * microfacet_g1(mf, v, m) * max(dot(v, m), F(0.0f)) / v.z;
}

}  // namespace raykiln
