#pragma once

#include "math/ray.h"
#include "scene/camera.h"

namespace raykiln {

/// The ray through a point of the image; x and y from 0 to 1, from the left and from the
/// top. t_near and t_far hold the clip planes, as distances along the ray.
inline Ray camera_ray(const Camera& camera, float x, float y) {
    const Vec3f local{(2.0f * (x - camera.offset_x) - 1.0f) * camera.tan_half_x,
                      (1.0f - 2.0f * (y - camera.offset_y)) * camera.tan_half_y, -1.0f};
    const float stretch = length(local);
    return {camera.origin, camera.world_from_camera.to_world(local / stretch),
            camera.near * stretch, camera.far * stretch};
}

/// Distance of a point along the view axis, in metres.
inline float view_depth(const Camera& camera, const Vec3f& p) {
    return -dot(p - camera.origin, camera.world_from_camera.n);
}

}  // namespace raykiln
