#pragma once

#include "math/elementary.h"
#include "sampling/warp.h"
#include "scene/scene.h"
#include "texture/texture.h"

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

namespace detail {

template <class F>
inline Frame<F> frame_in_lanes(const Frame<float>& f) {
    const auto in_lanes = [](const Vec3f& v) { return Vec3<F>{F(v.x), F(v.y), F(v.z)}; };
    return {in_lanes(f.s), in_lanes(f.t), in_lanes(f.n)};
}

}  // namespace detail

/// Radiance that arrives from `direction` (world space, away from the surface).
template <class F>
inline Vec3<F> environment_radiance(const EnvironmentLight& light,
                                    const std::vector<Texture>& textures,
                                    const Vec3<F>& direction) {
    const Vec3<F> scale{F(light.scale.x), F(light.scale.y), F(light.scale.z)};
    if (light.map == no_texture) {
        return scale;
    }
    const Frame<F> frame = detail::frame_in_lanes<F>(light.world_from_light);
    const Texture& map = textures[static_cast<std::size_t>(light.map)];
    return scale * lookup(map, uv_of_direction(frame.to_local(direction))).rgb;
}

/// Density over solid angle with which `sample_environment` returns `direction`.
template <class F>
inline F pdf_environment(const EnvironmentLight& light, const Vec3<F>& direction) {
    if (light.map == no_texture) {
        return F(0.25f * inv_pi);
    }
    const Vec3<F> local =
        detail::frame_in_lanes<F>(light.world_from_light).to_local(direction);
    const F sine = sine_to_axis(local);
    const auto off_axis = sine > F(0.0f);
    const F pdf = light.distribution.pdf(uv_of_direction(local)) /
                  (F(2.0f * pi * pi) * select(off_axis, sine, F(1.0f)));
    return select(off_axis, pdf, F(0.0f));
}

/// A direction in world space and its density over solid angle.
template <class F>
inline Vec3<F> sample_environment(const EnvironmentLight& light, F u, F v, F& pdf) {
    const Frame<F> frame = detail::frame_in_lanes<F>(light.world_from_light);
    if (light.map == no_texture) {
        pdf = F(0.25f * inv_pi);
        return frame.to_world(sample_sphere(u, v));
    }
    const Vec2<F> uv = light.distribution.sample(u, v, pdf);
    const Vec3<F> local = direction_of_uv(uv);
    const F sine = sine_to_axis(local);
    const auto off_axis = sine > F(0.0f);
    pdf = select(off_axis, pdf / (F(2.0f * pi * pi) * select(off_axis, sine, F(1.0f))),
                 F(0.0f));
    return frame.to_world(local);
}

}  // namespace raykiln
