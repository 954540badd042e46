#pragma once

#include "math/vec.h"

// The form of every BSDF here. Directions are unit, in the shading frame (normal +z), and
// point away from the surface: `dir_out` towards where the light goes (the camera side of
// a path), `dir_in` towards where it comes from.
//
//   evaluate(bsdf, dir_out, dir_in) -> value = f(dir_out, dir_in) |cos dir_in|, and the
//   density
//                                      with which `sample` returns dir_in (0 for mirror
//                                      lobes)
//   sample(bsdf, dir_out, u)        -> dir_in, weight = value / density
//
// `u.lobe` chooses between lobes; `u.x`, `u.y` place the direction.

namespace raykiln {

template <class F>
struct BsdfRandom {
    F lobe, x, y;
};

template <class F>
struct BsdfValue {
    Vec3<F> value;
    F pdf_solid_angle;
};

template <class F>
struct BsdfSample {
    Vec3<F> dir_in;
    Vec3<F> weight;     ///< 0 where the sample failed
    F pdf_solid_angle;  ///< of the whole BSDF; meaningless for a mirror direction
    F eta;              ///< index entered / index left by refraction, 1 for reflection
    Mask<F> specular;   ///< a mirror direction: no other strategy can find it
};

template <class F>
inline Vec3<F> reflect(const Vec3<F>& v) {
    return {F(0.0f) - v.x, F(0.0f) - v.y, v.z};
}
template <class F>
inline Vec3<F> reflect(const Vec3<F>& v, const Vec3<F>& m) {
    return m * (F(2.0f) * dot(v, m)) - v;
}
/// v refracted at a facet m, given the transmitted cosine (opposite in sign to v . m).
template <class F>
inline Vec3<F> refract(const Vec3<F>& v, const Vec3<F>& m, F cos_transmitted, F eta_ti) {
    return m * (dot(v, m) * eta_ti + cos_transmitted) - v * eta_ti;
}

}  // namespace raykiln
