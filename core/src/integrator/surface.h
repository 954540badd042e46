#pragma once

#include "accel/accel.h"
#include "bsdf/bsdf.h"

namespace raykiln {

/// A point on a surface, ready to be shaded.
struct Surface {
    Vec3f p;
    Vec3f normal;          ///< geometric, unit, outside
    Frame<float> shading;  ///< interpolated and mapped normal; flipped towards `dir_out`
                           ///< if two-sided
    Vec2f uv;
    float error;  ///< how far to move a ray's origin off the surface
    const Material* material = nullptr;
    std::uint32_t emission = no_index;
    std::uint32_t light = no_index;  ///< index into Scene::lights if it emits
};

/// The surface at a hit; `dir_out` points back along the ray.
Surface make_surface(const Scene& scene, const Hit& hit, const Ray& ray);

/// Opacity at a hit, 0 to 1, with the material's cut-off applied.
float opacity_at(const Scene& scene, const Hit& hit);

/// A ray from a surface point into a unit direction.
inline Ray spawn_ray(const Surface& s, const Vec3f& direction) {
    return {offset_origin(s.p, s.normal, direction, s.error), direction};
}

}  // namespace raykiln
