#pragma once

#include "scene/scene.h"

namespace raykiln {

/// Chooses a light for a receiver by what it may contribute there: beyond the scene by
/// power, in it by the light tree. A probability of 0: no light reaches the receiver.
LightTree::Choice choose_light(const Scene& scene, const LightReceiver& receiver,
                               float u);
/// The probability with which `choose_light` returns a light.
float pmf_of_light(const Scene& scene, const LightReceiver& receiver,
                   std::uint32_t light);

/// A point on a light as seen from a surface point.
struct LightSample {
    Vec3f direction;  ///< unit, away from the surface point
    Vec3f point;      ///< where the light is, moved off its surface; unused if infinite
    bool infinite = false;  ///< beyond all geometry
    Vec3f
        radiance;  ///< arriving; for a delta light already divided by its (delta) density
    float pdf_solid_angle;  ///< of `direction`, given the light; 1 for a delta light
    bool delta = false;     ///< no other strategy can find it
};

/// Samples one light towards `p`. Radiance 0 (and density 0) where the light does not
/// reach p.
LightSample sample_light(const Scene& scene, const Light& light, const Vec3f& p, float u,
                         float v);

/// Density over solid angle with which `sample_light` finds the point hit by a ray from
/// `p` in unit `direction`, `distance` away, on an emissive triangle or sphere.
float pdf_light(const Light& light, const Vec3f& p, const Vec3f& direction,
                float distance);

/// Radiance of a surface emission at a texture coordinate; `front`: seen from its
/// normal's side.
Vec3f emitted_radiance(const Scene& scene, std::uint32_t emission, Vec2f uv, bool front);

/// Makes a light of each emissive triangle and sphere, and the tables to choose lights by
/// power.
void prepare_lights(Scene& scene);

}  // namespace raykiln
