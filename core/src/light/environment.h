#pragma once

#include "math/elementary.h"
#include "scene/scene.h"

// The mapping of raykiln.scene.EnvironmentLight: u = atan2(x, -z) / 2 pi, v = acos(y) /
// pi.

namespace raykiln {

/// Sine of a unit direction's angle to the y axis. Near the poles y alone does not tell:
/// it rounds to 1.
template <class F>
inline F sine_to_axis(const Vec3<F>& d) {
    return sqrt(d.x * d.x + d.z * d.z);
}

template <class F>
inline Vec2<F> uv_of_direction(const Vec3<F>& d) {
    const F u = atan2(d.x, F(0.0f) - d.z) * F(inv_two_pi);
    return {u - floor(u), atan2(sine_to_axis(d), d.y) * F(inv_pi)};
}

template <class F>
inline Vec3<F> direction_of_uv(const Vec2<F>& uv) {
    F sin_theta, cos_theta, sin_phi, cos_phi;
    sin_cos_turns(uv.y * F(0.5f), sin_theta, cos_theta);
    sin_cos_turns(uv.x, sin_phi, cos_phi);
    return {sin_phi * sin_theta, cos_theta, F(0.0f) - cos_phi * sin_theta};
}

/// Sets the distribution and the power of a light with a map.
void prepare_environment(EnvironmentLight& light, const std::vector<Texture>& textures);

/// Radiance that arrives from `direction` (world space, away from the surface).
Vec3f environment_radiance(const EnvironmentLight& light,
                           const std::vector<Texture>& textures, const Vec3f& direction);
/// Density over solid angle with which `sample_environment` returns `direction`.
float pdf_environment(const EnvironmentLight& light, const Vec3f& direction);
/// A direction in world space and its density over solid angle.
Vec3f sample_environment(const EnvironmentLight& light, float u, float v, float& pdf);

}  // namespace raykiln
