#pragma once

#include "math/vec.h"

namespace raykiln {

/// An orthonormal frame; in local coordinates the normal is +z.
template <class F>
struct Frame {
    Vec3<F> s, t, n;

    Vec3<F> to_local(const Vec3<F>& v) const { return {dot(v, s), dot(v, t), dot(v, n)}; }
    Vec3<F> to_world(const Vec3<F>& v) const { return s * v.x + t * v.y + n * v.z; }
};

/// Frame about a unit normal without singularities (Duff et al., JCGT 6(1), 2017).
template <class F>
inline Frame<F> frame_of_normal(const Vec3<F>& n) {
    const F sign = copysign(F(1.0f), n.z);
    const F a = F(-1.0f) / (sign + n.z);
    const F b = n.x * n.y * a;
    return {{F(1.0f) + sign * n.x * n.x * a, sign * b, F(0.0f) - sign * n.x},
            {b, sign + n.y * n.y * a, F(0.0f) - n.y},
            n};
}

/// Frame about a unit normal whose s follows `tangent` (dp/du); any frame if that is
/// degenerate.
template <class F>
inline Frame<F> frame_of_normal_and_tangent(const Vec3<F>& n, const Vec3<F>& tangent) {
    const Vec3<F> s = tangent - n * dot(n, tangent);
    const F len2 = length_squared(s);
    const auto usable = len2 > F(1e-12f) * length_squared(tangent);
    const Frame<F> any_frame = frame_of_normal(n);
    const Vec3<F> unit =
        select(usable, s / sqrt(select(usable, len2, F(1.0f))), any_frame.s);
    return {unit, cross(n, unit), n};
}

}  // namespace raykiln
