#pragma once

#include "math/ray.h"
#include "scene/camera.h"

namespace raykiln {

template <class F>
struct CameraRay {
    Vec3<F> direction;  ///< unit; the origin is the camera's
    F t_near, t_far;    ///< the clip planes, as distances along the ray
};

/// The ray through a point of the image; x and y from 0 to 1, from the left and from the
/// top.
template <class F>
inline CameraRay<F> camera_ray_toward(const Camera& camera, F x, F y) {
    const auto in_lanes = [](const Vec3f& v) { return Vec3<F>{F(v.x), F(v.y), F(v.z)}; };
    const Vec3<F> local{
        (F(2.0f) * (x - F(camera.offset_x)) - F(1.0f)) * F(camera.tan_half_x),
        (F(1.0f) - F(2.0f) * (y - F(camera.offset_y))) * F(camera.tan_half_y), F(-1.0f)};
    const F stretch = length(local);
    const Frame<float>& f = camera.world_from_camera;
    const Frame<F> frame{in_lanes(f.s), in_lanes(f.t), in_lanes(f.n)};
    return {frame.to_world(local / stretch), F(camera.near) * stretch,
            F(camera.far) * stretch};
}
inline Ray camera_ray(const Camera& camera, float x, float y) {
    const CameraRay<float> r = camera_ray_toward(camera, x, y);
    return {camera.origin, r.direction, r.t_near, r.t_far};
}

/// Distance of a point along the view axis, in metres.
inline float view_depth(const Camera& camera, const Vec3f& p) {
    return -dot(p - camera.origin, camera.world_from_camera.n);
}

}  // namespace raykiln
