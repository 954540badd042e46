#pragma once

#include "math/elementary.h"
#include "math/vec.h"

// Maps from the unit square to the domains that are sampled, with their densities.

namespace raykiln {

/// Uniform on the unit disk; concentric map (Shirley and Chiu 1997).
template <class F>
inline Vec2<F> sample_disk(F u, F v) {
    const F a = F(2.0f) * u - F(1.0f);
    const F b = F(2.0f) * v - F(1.0f);
    const auto wide = abs(a) > abs(b);
    const F r = select(wide, a, b);
    const F other = select(wide, b, a);
    const F ratio = select(abs(r) > F(0.0f), other / r, F(0.0f));
    // Angle in turns: an eighth of the ratio, from the axis that r lies on.
    const F eighth = ratio * F(0.125f);
    const F turns = select(wide, eighth, F(0.25f) - eighth);
    F sine, cosine;
    sin_cos_turns(turns, sine, cosine);
    return {r * cosine, r * sine};
}

/// Cosine-weighted direction about +z; pdf_solid_angle = z / pi.
template <class F>
inline Vec3<F> sample_cosine_hemisphere(F u, F v) {
    const Vec2<F> d = sample_disk(u, v);
    return {d.x, d.y, safe_sqrt(F(1.0f) - d.x * d.x - d.y * d.y)};
}
template <class F>
inline F pdf_cosine_hemisphere(F cosine) {
    return max(cosine, F(0.0f)) * F(inv_pi);
}

/// Uniform direction; pdf_solid_angle = 1 / (4 pi).
template <class F>
inline Vec3<F> sample_sphere(F u, F v) {
    const F z = F(1.0f) - F(2.0f) * u;
    const F r = safe_sqrt(F(1.0f) - z * z);
    F sine, cosine;
    sin_cos_turns(v, sine, cosine);
    return {r * cosine, r * sine, z};
}

/// Uniform direction within a cone about +z, given 1 - cos of its half angle;
/// pdf_solid_angle = 1 / (2 pi (1 - cos)).
template <class F>
inline Vec3<F> sample_cone(F u, F v, F one_minus_cos) {
    const F h = u * one_minus_cos;  // 1 - z, kept exact for narrow cones
    const F r = safe_sqrt(h * (F(2.0f) - h));
    F sine, cosine;
    sin_cos_turns(v, sine, cosine);
    return {r * cosine, r * sine, F(1.0f) - h};
}
template <class F>
inline F pdf_cone(F one_minus_cos) {
    return F(inv_two_pi) / one_minus_cos;
}

/// Barycentric coordinates (of the second and third vertex), uniform over a triangle
/// (Heitz 2019, "A Low-Distortion Map Between Triangle and Square").
template <class F>
inline Vec2<F> sample_triangle(F u, F v) {
    const auto below = v > u;
    const F x = select(below, u * F(0.5f), u - v * F(0.5f));
    const F y = select(below, v - u * F(0.5f), v * F(0.5f));
    return {x, y};
}

/// Tent filter of radius `radius` about 0.
template <class F>
inline F sample_tent(F u, F radius) {
    const F x = F(2.0f) * u - F(1.0f);
    const F magnitude = F(1.0f) - safe_sqrt(F(1.0f) - abs(x));
    return copysign(magnitude * radius, x);
}

/// Converts a density over area to one over solid angle.
template <class F>
inline F pdf_solid_angle_of_area(F pdf_area, F distance_squared, F cosine_at_light) {
    return pdf_area * distance_squared / cosine_at_light;
}

/// Power heuristic with exponent 2 for one sample each (Veach 1997, section 9.2.4).
template <class F>
inline F mis_weight(F pdf_taken, F pdf_other) {
    // Dividing first keeps the squares in range.
    const F ratio = pdf_other / pdf_taken;
    return F(1.0f) / (F(1.0f) + ratio * ratio);
}

/// The same between light and BSDF sampling. The BSDF's density counts for more than it
/// is: where its direction misses the light it still brings what is reflected from there,
/// so that the sum over both varies less than that of two directions that bring nothing.
inline constexpr float bsdf_preference = 1.4f;
template <class F>
inline F mis_weight_of_light(F pdf_light, F pdf_bsdf) {
    return mis_weight(pdf_light, pdf_bsdf * F(bsdf_preference));
}
template <class F>
inline F mis_weight_of_bsdf(F pdf_bsdf, F pdf_light) {
    return mis_weight(pdf_bsdf * F(bsdf_preference), pdf_light);
}

}  // namespace raykiln
