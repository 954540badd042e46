#pragma once

#include "light/environment.h"
#include "light/flat_light.h"
#include "light/light.h"
#include "math/gather.h"
#include "math/ray.h"
#include "sampling/warp.h"

// How each kind of light is sampled, and the density of finding a point on it otherwise.

namespace raykiln {

template <class F>
inline LightSampleOf<F> sample_toward_point(const Vec3<F>& p, const Vec3<F>& position,
                                            const Vec3<F>& intensity) {
    const Vec3<F> d = position - p;
    const F distance2 = length_squared(d);
    const auto apart = distance2 > F(0.0f);
    const F safe = select(apart, distance2, F(1.0f));
    return select<F>(apart,
                     {d / sqrt(safe), position, Mask<F>(false), intensity / safe, F(1.0f),
                      Mask<F>(true)},
                     no_light_sample<F>());
}

template <class F>
inline F spot_falloff(F cos_inner, F cos_outer, F cosine) {
    const F range = max(cos_inner - cos_outer, F(1e-6f));
    return sqr(clamp((cosine - cos_outer) / range, F(0.0f), F(1.0f)));
}

template <class F>
inline LightSampleOf<F> sample_spot(const Vec3<F>& p, const Vec3<F>& position,
                                    const Vec3<F>& axis, const Vec3<F>& intensity,
                                    F cos_inner, F cos_outer) {
    LightSampleOf<F> s = sample_toward_point(p, position, intensity);
    s.radiance *= spot_falloff(cos_inner, cos_outer, F(0.0f) - dot(s.direction, axis));
    return s;
}

template <class F>
inline LightSampleOf<F> sample_directional(const Vec3<F>& direction,
                                           const Vec3<F>& irradiance) {
    return {-direction, Vec3<F>(F(0.0f)), Mask<F>(true),
            irradiance, F(1.0f),          Mask<F>(true)};
}

template <class F>
inline LightSampleOf<F> sample_environment_light(const Scene& scene,
                                                 const EnvironmentLight& light,
                                                 const Vec3<F>& normal, F u, F v, F w) {
    F pdf;
    const SkyPoint<F> at = sample_environment(light, normal, u, v, w, pdf);
    return select<F>(
        pdf > F(0.0f),
        {at.direction, Vec3<F>(F(0.0f)), Mask<F>(true),
         environment_radiance(light, scene.textures, at), pdf, Mask<F>(false)},
        no_light_sample<F>());
}

namespace detail {

/// So near that the cone to a sphere would be a half space: its area is sampled instead.
template <class F>
inline Mask<F> within_sphere(F distance2, F radius2) {
    return distance2 <= radius2 * F(1.0002f);
}
template <class F>
inline F one_minus_cos_of_cone(F distance2, F radius2) {
    const F sin2 = min(radius2 / distance2, F(1.0f));
    return sin2 / (F(1.0f) + safe_sqrt(F(1.0f) - sin2));
}

}  // namespace detail

/// Uniform within the cone that the sphere fills, seen from outside (Shirley et al.
/// 1996); uniform over its area, seen from within.
template <class F>
inline LightSampleOf<F> sample_sphere_light(const Scene& scene,
                                            const SphereLightOf<F>& light,
                                            const Vec3<F>& p, F u, F v) {
    const Vec3<F> to_center = light.center - p;
    const F distance2 = length_squared(to_center);
    const F radius2 = sqr(light.radius);
    const auto within = detail::within_sphere(distance2, radius2);
    const auto inward = light.inward != Uint<F>(0u);

    const F one_minus_cos = detail::one_minus_cos_of_cone(
        select(within, F(1.0f), distance2), select(within, F(0.5f), radius2));
    const F distance = sqrt(select(within, F(1.0f), distance2));
    const Frame<F> cone = frame_of_normal(
        select(within, {F(0.0f), F(0.0f), F(1.0f)}, to_center / distance));
    const Vec3<F> toward = normalize(cone.to_world(sample_cone(u, v, one_minus_cos)));
    const F along = dot(to_center, toward);
    const F half_chord = safe_sqrt(radius2 - (distance2 - along * along));
    const Vec3<F> n_outside = normalize(toward * (along - half_chord) - to_center);

    const Vec3<F> n = select(within, sample_sphere(u, v), n_outside);
    const Vec3<F> point = light.center + n * light.radius;
    const Vec3<F> d = point - p;
    const F d2 = length_squared(d);
    const auto apart = d2 > F(0.0f);
    const Vec3<F> direction =
        select(within, d / sqrt(select(apart, d2, F(1.0f))), toward);
    const F cosine = F(0.0f) - dot(direction, n);
    const auto valid = (!within) | (apart & (cosine != F(0.0f)));
    const F pdf_within = pdf_solid_angle_of_area(
        F(0.25f * inv_pi) / radius2, d2, select(cosine != F(0.0f), abs(cosine), F(1.0f)));
    const auto outside = (!within) | (cosine > F(0.0f));
    const F error = position_error(max_abs(light.center) + light.radius);
    return select<F>(
        valid,
        {direction, offset_origin(point, n, -direction, error), Mask<F>(false),
         emitted_radiance<F>(scene, light.emission, {F(0.0f), F(0.0f)},
                             outside != inward),
         select(within, pdf_within, pdf_cone(one_minus_cos)), Mask<F>(false)},
        no_light_sample<F>());
}

template <class F>
inline F pdf_sphere_light(const Vec3<F>& center, F radius, const Vec3<F>& p,
                          const Vec3<F>& direction, F distance) {
    const F distance2 = length_squared(center - p);
    const F radius2 = sqr(radius);
    const auto within = detail::within_sphere(distance2, radius2);
    const F pdf_outside = pdf_cone(detail::one_minus_cos_of_cone(
        select(within, F(1.0f), distance2), select(within, F(0.5f), radius2)));
    const Vec3<F> n = normalize(p + direction * distance - center);
    const F cosine = abs(dot(direction, n));
    const auto seen = cosine > F(0.0f);
    const F pdf_within = pdf_solid_angle_of_area(
        F(0.25f * inv_pi) / radius2, sqr(distance), select(seen, cosine, F(1.0f)));
    return select(within, select(seen, pdf_within, F(0.0f)), pdf_outside);
}

/// An emissive triangle (or half a parallelogram) a lane, with the first of its texture
/// coordinates.
template <class F, class T>
inline TriangleLightOf<F> flat_light_at(const LightTable::Rows<T>& lights, Uint<F> slot) {
    static_assert(sizeof(T) == sizeof(TriangleLight));
    const auto row = gather_row<F, 16>(lights.data(), slot);
    return {{row[0], row[1], row[2]},
            {row[3], row[4], row[5]},
            {row[6], row[7], row[8]},
            {row[9], row[10], row[11]},
            row[12],
            as_uint(row[13]),
            {row[14], row[15]},
            {},
            {}};
}
/// With all of them, if there are textures at all.
template <class F, class T>
inline TriangleLightOf<F> textured_light_at(const Scene& scene,
                                            const LightTable::Rows<T>& lights,
                                            Uint<F> slot) {
    TriangleLightOf<F> light = flat_light_at<F>(lights, slot);
    if (scene.textures.empty()) {
        light.uv1 = light.uv2 = light.uv0;
        return light;
    }
    const auto uvs = gather_row<F, 4>(lights.data(), slot, 16);
    light.uv1 = {uvs[0], uvs[1]};
    light.uv2 = {uvs[2], uvs[3]};
    return light;
}

/// An emissive sphere a lane.
template <class F>
inline SphereLightOf<F> sphere_light_at(const LightTable& table, Uint<F> slot) {
    const auto row = gather_row<F, 8>(table.spheres.data(), slot);
    return {{row[0], row[1], row[2]}, row[3], as_uint(row[4]), as_uint(row[5])};
}

/// Each lane's own light towards its own receiver; only lanes in `wanted` count, their
/// indices must be valid.
template <class F>
inline LightSampleOf<F> sample_light(const Scene& scene, Uint<F> light, Mask<F> wanted,
                                     const LightReceiverOf<F>& receiver, F u, F v, F w) {
    using U = Uint<F>;
    const Vec3<F>& p = receiver.p;
    const LightTable& table = scene.light_table;
    LightSampleOf<F> sample = no_light_sample<F>();
    light = select(wanted, light, U(0u));
    const U kind = gather(table.kind.data(), light);
    const U slots = gather(table.slot.data(), light);
    const auto each = [&](std::uint32_t of_kind, const auto& take) {
        const auto lanes = wanted & (kind == U(of_kind));
        if (any(lanes)) {
            const U slot = select(lanes, slots, U(0u));
            sample = select<F>(lanes, take(slot), sample);
        }
    };
    each(4, [&](U i) {
        return sample_triangle_light(
            scene, textured_light_at<F>(scene, table.triangles, i), p, u, v);
    });
    each(6, [&](U i) {
        return sample_parallelogram_light(
            scene, textured_light_at<F>(scene, table.parallelograms, i), p, u, v);
    });
    each(5, [&](U i) {
        return sample_sphere_light(scene, sphere_light_at<F>(table, i), p, u, v);
    });
    each(0, [&](U i) {
        using T = PointLight;
        const T* a = table.points.data();
        return sample_toward_point(p, gather_member<F>(a, &T::position, i),
                                   gather_member<F>(a, &T::intensity, i));
    });
    each(1, [&](U i) {
        using T = SpotLight;
        const T* a = table.spots.data();
        return sample_spot(
            p, gather_member<F>(a, &T::position, i), gather_member<F>(a, &T::axis, i),
            gather_member<F>(a, &T::intensity, i), gather_member<F>(a, &T::cos_inner, i),
            gather_member<F>(a, &T::cos_outer, i));
    });
    each(2, [&](U i) {
        using T = DirectionalLight;
        const T* a = table.directionals.data();
        return sample_directional(gather_member<F>(a, &T::direction, i),
                                  gather_member<F>(a, &T::irradiance, i));
    });
    for (const std::uint32_t i : table.environments) {
        const auto lanes = wanted & (light == U(i));
        if (any(lanes)) {
            const auto& environment = std::get<EnvironmentLight>(scene.lights[i]);
            sample = select<F>(
                lanes,
                sample_environment_light(scene, environment, receiver.normal, u, v, w),
                sample);
        }
    }
    return sample;
}

/// Density over solid angle with which `sample_light` finds the points hit by rays from
/// `p` in unit `direction`, `distance` away, on lights of surfaces.
template <class F>
inline F pdf_light(const Scene& scene, Uint<F> light, Mask<F> wanted, const Vec3<F>& p,
                   const Vec3<F>& direction, F distance) {
    using U = Uint<F>;
    const LightTable& table = scene.light_table;
    light = select(wanted, light, U(0u));
    const U kind = gather(table.kind.data(), light);
    const U slots = gather(table.slot.data(), light);
    F pdf(0.0f);
    const auto on_triangle = wanted & (kind == U(4u));
    if (any(on_triangle)) {
        const auto l =
            flat_light_at<F>(table.triangles, select(on_triangle, slots, U(0u)));
        pdf = select(on_triangle, pdf_triangle_light(l, p, direction, distance), pdf);
    }
    const auto on_parallelogram = wanted & (kind == U(6u));
    if (any(on_parallelogram)) {
        const auto l = flat_light_at<F>(table.parallelograms,
                                        select(on_parallelogram, slots, U(0u)));
        pdf = select(on_parallelogram, pdf_parallelogram_light(l, p, direction, distance),
                     pdf);
    }
    const auto on_sphere = wanted & (kind == U(5u));
    if (any(on_sphere)) {
        const auto l = sphere_light_at<F>(table, select(on_sphere, slots, U(0u)));
        pdf = select(on_sphere,
                     pdf_sphere_light(l.center, l.radius, p, direction, distance), pdf);
    }
    return pdf;
}

}  // namespace raykiln
