#pragma once

#include "accel/accel.h"
#include "bsdf/bsdf.h"
#include "integrator/geometry.h"

namespace raykiln {

/// A point on a surface, with what it is made of.
struct Surface : SurfacePoint<float> {
    const Material* material = nullptr;
    std::uint32_t emission = no_index;
    std::uint32_t light = no_index;  ///< index into Scene::lights if it emits
};

/// The shape that a hit lies on.
struct ShapeOfHit {
    const Mesh* mesh = nullptr;
    const Sphere* sphere = nullptr;
    const Instance* instance = nullptr;

    std::uint32_t material() const {
        return mesh != nullptr ? mesh->material : sphere->material;
    }
    std::uint32_t emission() const {
        return mesh != nullptr ? mesh->emission : sphere->emission;
    }
    bool flip() const {
        return mesh != nullptr ? mesh->flip_normals : sphere->flip_normals;
    }
};
ShapeOfHit shape_of(const Scene& scene, const Hit& hit);

/// The light, if any, that a hit lies on: index into Scene::lights, or no_index.
std::uint32_t light_of(const Scene& scene, const Hit& hit);

/// The surface at a hit; `dir_out` points back along the ray.
Surface make_surface(const Scene& scene, const Hit& hit, const Ray& ray);

/// Opacity at a hit, 0 to 1, with the material's cut-off applied.
float opacity_at(const Scene& scene, const Hit& hit);

/// A ray from a surface point into a unit direction.
inline Ray spawn_ray(const Surface& s, const Vec3f& direction) {
    return {offset_origin(s.p, s.normal, direction, s.error), direction};
}

}  // namespace raykiln
