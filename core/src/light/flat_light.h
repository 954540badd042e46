#pragma once

#include "light/light_sample.h"
#include "math/ray.h"
#include "sampling/spherical.h"
#include "sampling/warp.h"

// Lights that are emissive triangles and parallelograms.

namespace raykiln {

namespace detail {

/// So small or far that its distance and its angle hardly differ from place to place:
/// points uniform over its area then serve as well as directions, for much less work.
template <class F>
inline Mask<F> looks_small(const TriangleLightOf<F>& light, const Vec3<F>& to_corner) {
    return (length_squared(light.edge1) + length_squared(light.edge2)) * F(64.0f) <
           length_squared(to_corner);
}

/// The point at `b` edges from the corner of a flat light; density 1 / solid_angle where
/// `by_angle` is set, elsewhere uniform over `area`.
template <class F>
inline LightSampleOf<F> sample_at(const Scene& scene, const TriangleLightOf<F>& light,
                                  const Vec3<F>& p, const Vec2<F>& b, Mask<F> by_angle,
                                  F solid_angle, F area) {
    const Vec3<F> point = light.p0 + light.edge1 * b.x + light.edge2 * b.y;
    const Vec3<F> d = point - p;
    const F distance2 = length_squared(d);
    const auto apart = distance2 > F(0.0f);
    const F safe = select(apart, distance2, F(1.0f));
    const Vec3<F> direction = d / sqrt(safe);
    const F cosine = F(0.0f) - dot(direction, light.normal);
    const auto valid = apart & (cosine != F(0.0f));
    const Vec2<F> uv{light.uv0.x + (light.uv1.x - light.uv0.x) * b.x +
                         (light.uv2.x - light.uv0.x) * b.y,
                     light.uv0.y + (light.uv1.y - light.uv0.y) * b.x +
                         (light.uv2.y - light.uv0.y) * b.y};
    const F size = max_abs(light.p0) + max_abs(light.edge1) + max_abs(light.edge2);
    const F pdf = select(by_angle, F(1.0f) / solid_angle,
                         pdf_solid_angle_of_area(F(1.0f) / area, safe,
                                                 select(valid, abs(cosine), F(1.0f))));
    return select<F>(
        valid,
        {direction, offset_origin(point, light.normal, -direction, position_error(size)),
         Mask<F>(false), emitted_radiance<F>(scene, light.emission, uv, cosine > F(0.0f)),
         pdf, Mask<F>(false)},
        no_light_sample<F>());
}

/// The density of that; `see` gives the light on the unit sphere.
template <class F, class See>
inline F pdf_at(const TriangleLightOf<F>& light, const See& see, F area, const Vec3<F>& p,
                const Vec3<F>& direction, F distance) {
    const F cosine = abs(dot(direction, light.normal));
    const auto facing = cosine > F(0.0f);
    const F by_area = pdf_solid_angle_of_area(F(1.0f) / area, sqr(distance),
                                              select(facing, cosine, F(1.0f)));
    F pdf = by_area;
    const Vec3<F> to_corner = light.p0 - p;
    const auto large = !looks_small(light, to_corner);
    if (any(large)) {
        const auto seen = see(to_corner, light.edge1, light.edge2);
        pdf = select(large & can_sample(seen), F(1.0f) / seen.solid_angle, by_area);
    }
    return select(facing, pdf, F(0.0f));
}

}  // namespace detail

/// Uniform over the solid angle, where that can be sampled precisely; over the area
/// elsewhere.
template <class F>
inline LightSampleOf<F> sample_triangle_light(const Scene& scene,
                                              const TriangleLightOf<F>& light,
                                              const Vec3<F>& p, F u, F v) {
    Vec2<F> b = sample_triangle(u, v);
    const Vec3<F> to_corner = light.p0 - p;
    auto by_angle = !detail::looks_small(light, to_corner);
    F solid_angle(1.0f);
    if (any(by_angle)) {
        const SphericalTriangle<F> seen =
            make_spherical_triangle(to_corner, light.edge1, light.edge2);
        solid_angle = seen.solid_angle;
        by_angle = by_angle & can_sample(seen);
        const Vec2<F> at = place_in_triangle(sample_spherical_triangle(seen, u, v),
                                             to_corner, light.edge1, light.edge2);
        b.x = select(by_angle, at.x, b.x);
        b.y = select(by_angle, at.y, b.y);
    }
    return detail::sample_at(scene, light, p, b, by_angle, solid_angle, light.area);
}

template <class F>
inline F pdf_triangle_light(const TriangleLightOf<F>& light, const Vec3<F>& p,
                            const Vec3<F>& direction, F distance) {
    const auto see = [](const Vec3<F>& p0, const Vec3<F>& edge1, const Vec3<F>& edge2) {
        return make_spherical_triangle(p0, edge1, edge2);
    };
    return detail::pdf_at(light, see, light.area, p, direction, distance);
}

/// The same over a parallelogram; `half` of it is given.
template <class F>
inline LightSampleOf<F> sample_parallelogram_light(const Scene& scene,
                                                   const TriangleLightOf<F>& half,
                                                   const Vec3<F>& p, F u, F v) {
    Vec2<F> b{u, v};
    const Vec3<F> to_corner = half.p0 - p;
    auto by_angle = !detail::looks_small(half, to_corner);
    F solid_angle(1.0f);
    if (any(by_angle)) {
        const SphericalParallelogram<F> seen =
            make_spherical_parallelogram(to_corner, half.edge1, half.edge2);
        solid_angle = seen.solid_angle;
        by_angle = by_angle & can_sample(seen);
        const Vec2<F> at =
            place_in_parallelogram(sample_spherical_parallelogram(seen, u, v), to_corner,
                                   half.edge1, half.edge2);
        b.x = select(by_angle, at.x, b.x);
        b.y = select(by_angle, at.y, b.y);
    }
    return detail::sample_at(scene, half, p, b, by_angle, solid_angle,
                             half.area * F(2.0f));
}

template <class F>
inline F pdf_parallelogram_light(const TriangleLightOf<F>& half, const Vec3<F>& p,
                                 const Vec3<F>& direction, F distance) {
    const auto see = [](const Vec3<F>& p0, const Vec3<F>& edge1, const Vec3<F>& edge2) {
        return make_spherical_parallelogram(p0, edge1, edge2);
    };
    return detail::pdf_at(half, see, half.area * F(2.0f), p, direction, distance);
}

}  // namespace raykiln
