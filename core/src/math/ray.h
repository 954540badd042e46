#pragma once

#include "math/vec.h"

namespace raykiln {

struct Ray {
    Vec3f origin;
    Vec3f direction;
    float t_near = 0.0f;
    float t_far = infinity;
};

/// How far the computed position of a point on a surface may be from the surface, with a
/// wide margin (64 ulp), where no coordinate that it was interpolated from exceeds
/// `magnitude`.
template <class F>
inline F position_error(F magnitude) {
    return magnitude * F(0x1p-18f);
}

/// A point moved off its surface by `distance` along the geometric normal, to the side of
/// `direction`, so that a ray from it cannot hit the surface that it lies on.
template <class F>
inline Vec3<F> offset_origin(const Vec3<F>& p, const Vec3<F>& normal,
                             const Vec3<F>& direction, F distance) {
    return p + normal *
                   select(dot(normal, direction) < F(0.0f), F(0.0f) - distance, distance);
}

}  // namespace raykiln
