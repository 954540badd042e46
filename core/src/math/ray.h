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
inline float position_error(float magnitude) {
    return magnitude * 0x1p-18f;
}

/// A point moved off its surface by `distance` along the geometric normal, to the side of
/// `direction`, so that a ray from it cannot hit the surface that it lies on.
inline Vec3f offset_origin(const Vec3f& p, const Vec3f& normal, const Vec3f& direction,
                           float distance) {
    return p + normal * (dot(normal, direction) < 0.0f ? -distance : distance);
}

}  // namespace raykiln
