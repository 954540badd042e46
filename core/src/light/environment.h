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

/// The distribution has a view for each of the vertices of an octahedron, unfolded to a
/// square (Cigolle et al. 2014) and divided so often from its middle to its edge; and a
/// last one without a normal.
inline constexpr std::uint32_t normal_steps = 5;
inline constexpr std::uint32_t normal_side = 2 * normal_steps + 1;

/// Whether a receiver's normal is known: it is (0, 0, 0) else.
template <class F>
inline Mask<F> has_normal(const Vec3<F>& normal) {
    return length_squared(normal) > F(0.0f);
}

/// The views around a normal (in the light's axes): the vertices of the triangle that it
/// lies in, by their barycentric coordinates.
template <class F>
inline ViewMix<F> views_of_normal(const Vec3<F>& n) {
    using U = Uint<F>;
    const auto known = has_normal(n);
    const F sum = abs(n.x) + abs(n.y) + abs(n.z);
    const F scale = F(1.0f) / select(known, sum, F(1.0f));
    const F ax = abs(n.x) * scale, az = abs(n.z) * scale;
    // The lower half is folded outwards.
    const auto lower = n.y < F(0.0f);
    constexpr auto steps = static_cast<float>(normal_steps);
    const F x = select(lower, F(1.0f) - az, ax) * F(steps);
    const F z = select(lower, F(1.0f) - ax, az) * F(steps);
    const auto step = [](F at) {
        return min(to_uint(max(at, F(0.0f))), U(normal_steps - 1));
    };
    const U ix = step(x), iz = step(z);
    const F fx = clamp(x - to_float(ix), F(0.0f), F(1.0f));
    const F fz = clamp(z - to_float(iz), F(0.0f), F(1.0f));
    const auto outer = fx + fz > F(1.0f);
    const auto vertex = [&](U i, U k) {
        const U middle(normal_steps);
        const U column = select(n.x < F(0.0f), middle - i, middle + i);
        const U row = select(n.z < F(0.0f), middle - k, middle + k);
        return select(known, row * U(normal_side) + column, U(normal_side * normal_side));
    };
    const U one(1u);
    return {{vertex(select(outer, ix + one, ix), select(outer, iz + one, iz)),
             vertex(ix + one, iz), vertex(ix, iz + one)},
            {abs(F(1.0f) - fx - fz), select(outer, F(1.0f) - fz, fx),
             select(outer, F(1.0f) - fx, fz)}};
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

/// A direction (world space, away from the surface) and where it is in a light's map, if
/// that has one.
template <class F>
struct SkyPoint {
    Vec3<F> direction;
    Vec3<F> local;
    Vec2<F> uv;
};

template <class F>
inline SkyPoint<F> sky_point(const EnvironmentLight& light, const Vec3<F>& direction) {
    SkyPoint<F> at{direction, direction, {F(0.0f), F(0.0f)}};
    if (light.map != no_texture) {
        at.local = detail::frame_in_lanes<F>(light.world_from_light).to_local(direction);
        at.uv = uv_of_direction(at.local);
    }
    return at;
}

/// Radiance that arrives from there.
template <class F>
inline Vec3<F> environment_radiance(const EnvironmentLight& light,
                                    const std::vector<Texture>& textures,
                                    const SkyPoint<F>& at) {
    const Vec3<F> scale{F(light.scale.x), F(light.scale.y), F(light.scale.z)};
    if (light.map == no_texture) {
        return scale;
    }
    const Texture& map = textures[static_cast<std::size_t>(light.map)];
    return scale * lookup(map, at.uv).rgb;
}

namespace detail {

/// The density of directions where the map has none: about the normal by the cosine, even
/// without a normal.
template <class F>
inline F pdf_even_sky(const Vec3<F>& normal, const Vec3<F>& direction) {
    return select(has_normal(normal), pdf_cosine_hemisphere(dot(direction, normal)),
                  F(0.25f * inv_pi));
}

/// The density over solid angle of one over the map's unit square.
template <class F>
inline F pdf_of_directions(F pdf_of_uv, const Vec3<F>& local) {
    const F sine = sine_to_axis(local);
    const auto off_axis = sine > F(0.0f);
    return select(off_axis,
                  pdf_of_uv / (F(2.0f * pi * pi) * select(off_axis, sine, F(1.0f))),
                  F(0.0f));
}

}  // namespace detail

/// Density over solid angle with which `sample_environment` returns that direction.
template <class F>
inline F pdf_environment(const EnvironmentLight& light, const Vec3<F>& normal,
                         const SkyPoint<F>& at) {
    if (light.map == no_texture) {
        return detail::pdf_even_sky(normal, at.direction);
    }
    const Frame<F> frame = detail::frame_in_lanes<F>(light.world_from_light);
    return detail::pdf_of_directions(
        light.distribution.pdf(views_of_normal(frame.to_local(normal)), at.uv), at.local);
}

/// A direction and its density over solid angle, for a surface of that unit normal:
/// mostly where both the light and the cosine are great. (0, 0, 0): for one that takes
/// light from all sides.
template <class F>
inline SkyPoint<F> sample_environment(const EnvironmentLight& light,
                                      const Vec3<F>& normal, F u, F v, F w, F& pdf) {
    const Frame<F> frame = detail::frame_in_lanes<F>(light.world_from_light);
    if (light.map == no_texture) {
        const auto known = has_normal(normal);
        const Vec3<F> up{F(0.0f), F(0.0f), F(1.0f)};
        const Vec3<F> around = frame_of_normal(select(known, normal, up))
                                   .to_world(sample_cosine_hemisphere(u, v));
        const Vec3<F> d = select(known, around, frame.to_world(sample_sphere(u, v)));
        pdf = detail::pdf_even_sky(normal, d);
        return sky_point(light, d);
    }
    const Vec2<F> uv =
        light.distribution.sample(views_of_normal(frame.to_local(normal)), u, v, w, pdf);
    const Vec3<F> local = direction_of_uv(uv);
    pdf = detail::pdf_of_directions(pdf, local);
    return {frame.to_world(local), local, uv};
}

}  // namespace raykiln
