#pragma once

#include "math/vec.h"

namespace raykiln {

/// Fresnel reflectance of a dielectric interface for unpolarised light, and how it
/// refracts.
template <class F>
struct DielectricFresnel {
    F reflectance;
    F cos_transmitted;  ///< cosine on the other side; opposite sign to the incident
                        ///< cosine
    F eta_ti;           ///< index of the side left over index of the side entered
};

/// `cosine` of the angle to the normal (negative: from inside), `eta` = index inside /
/// outside. Fresnel's equations, e.g. Born and Wolf, section 1.5.2.
template <class F>
inline DielectricFresnel<F> fresnel_dielectric(F cosine, F eta) {
    const auto outside = cosine >= F(0.0f);
    const F eta_it = select(outside, eta, F(1.0f) / eta);
    const F eta_ti = select(outside, F(1.0f) / eta, eta);
    const F sin2_t = eta_ti * eta_ti * (F(1.0f) - cosine * cosine);
    const F cos_t = safe_sqrt(F(1.0f) - sin2_t);
    const F cos_i = abs(cosine);
    const F a_s = (cos_i - eta_it * cos_t) / (cos_i + eta_it * cos_t);
    const F a_p = (cos_t - eta_it * cos_i) / (cos_t + eta_it * cos_i);
    const F r = F(0.5f) * (a_s * a_s + a_p * a_p);
    const auto total = sin2_t >= F(1.0f);
    const auto matched = eta == F(1.0f);
    return {select(total, F(1.0f), select(matched, F(0.0f), r)),
            select(outside, F(0.0f) - cos_t, cos_t), eta_ti};
}

/// Fresnel reflectance of a conductor with complex index eta + i k (relative to the
/// outside), one channel. Exact form, e.g. Born and Wolf, section 14.2.
template <class F>
inline F fresnel_conductor(F cosine, F eta, F k) {
    const F cos2 = cosine * cosine;
    const F sin2 = F(1.0f) - cos2;
    const F t0 = eta * eta - k * k - sin2;
    const F a2_plus_b2 = safe_sqrt(t0 * t0 + F(4.0f) * eta * eta * k * k);
    const F a = safe_sqrt(F(0.5f) * (a2_plus_b2 + t0));
    const F t1 = a2_plus_b2 + cos2;
    const F t2 = F(2.0f) * a * cosine;
    const F r_s = (t1 - t2) / (t1 + t2);
    const F t3 = a2_plus_b2 * cos2 + sin2 * sin2;
    const F t4 = t2 * sin2;
    const F r_p = r_s * (t3 - t4) / (t3 + t4);
    return F(0.5f) * (r_s + r_p);
}

template <class F>
inline Vec3<F> fresnel_conductor(F cosine, const Vec3<F>& eta, const Vec3<F>& k) {
    return {fresnel_conductor(cosine, eta.x, k.x), fresnel_conductor(cosine, eta.y, k.y),
            fresnel_conductor(cosine, eta.z, k.z)};
}

/// Schlick's approximation between f0 (head-on) and f90 (grazing).
template <class F>
inline Vec3<F> fresnel_schlick(F cosine, const Vec3<F>& f0, const Vec3<F>& f90) {
    const F m = clamp(F(1.0f) - cosine, F(0.0f), F(1.0f));
    const F m2 = m * m;
    return f0 + (f90 - f0) * (m2 * m2 * m);
}

/// Hemispherical average of the Fresnel reflectance, for light that meets the interface
/// from the side of relative index `eta` (index beyond / index before), by quadrature
/// over the cosine.
inline float fresnel_diffuse_reflectance(float eta) {
    constexpr int n = 1024;
    double sum = 0;
    for (int i = 0; i < n; ++i) {
        const float cosine = (static_cast<float>(i) + 0.5f) / n;
        sum += 2.0 * cosine * fresnel_dielectric(cosine, eta).reflectance / n;
    }
    return static_cast<float>(sum);
}

}  // namespace raykiln
