#pragma once

#include "math/elementary.h"
#include "math/frame.h"
#include "math/ray.h"
#include "math/transform.h"
#include "scene/scene.h"
#include "texture/texture.h"

// From what a ray met to a surface that can be shaded, over any number type.

namespace raykiln {

/// A point on a surface, ready to be shaded.
template <class F>
struct SurfacePoint {
    Vec3<F> p;
    Vec3<F> normal;    ///< geometric, unit, outside
    Frame<F> shading;  ///< interpolated and mapped normal; flipped towards `dir_out` if
                       ///< two-sided
    Vec2<F> uv;
    F error;  ///< how far to move a ray's origin off the surface
};

/// The corners of a triangle, in the space of its group. Without normals the face's own
/// counts, without texture coordinates the barycentric ones.
template <class F>
struct TriangleCorners {
    Vec3<F> p[3], n[3];
    Vec2<F> uv[3];
    Mask<F> has_normals, has_uv;
};

/// Geometry at a hit, before shading: first in the group's space, then in the world's.
template <class F>
struct Geometry {
    Vec3<F> p, normal, shading_normal;
    Vec3<F> dp_du, dp_dv;
    Vec2<F> uv;
    F magnitude;  // of the coordinates that p was computed from
};

template <class F>
inline Geometry<F> select(Mask<F> mask, const Geometry<F>& a, const Geometry<F>& b) {
    return {select(mask, a.p, b.p),
            select(mask, a.normal, b.normal),
            select(mask, a.shading_normal, b.shading_normal),
            select(mask, a.dp_du, b.dp_du),
            select(mask, a.dp_dv, b.dp_dv),
            select(mask, a.uv, b.uv),
            select(mask, a.magnitude, b.magnitude)};
}

/// Texture coordinates, and derivatives of the position over them: 0 where the mapping is
/// degenerate.
template <class F>
inline void set_texture_coordinates(Geometry<F>& g, const TriangleCorners<F>& t, F u,
                                    F v) {
    const F w = F(1.0f) - u - v;
    const Vec2<F> uv{w * t.uv[0].x + u * t.uv[1].x + v * t.uv[2].x,
                     w * t.uv[0].y + u * t.uv[1].y + v * t.uv[2].y};
    g.uv = select(t.has_uv, uv, g.uv);
    const Vec3<F> edge1 = t.p[1] - t.p[0], edge2 = t.p[2] - t.p[0];
    const F du1 = t.uv[1].x - t.uv[0].x, dv1 = t.uv[1].y - t.uv[0].y;
    const F du2 = t.uv[2].x - t.uv[0].x, dv2 = t.uv[2].y - t.uv[0].y;
    const F determinant = du1 * dv2 - dv1 * du2;
    const auto regular = t.has_uv & (abs(determinant) > F(3e-38f));
    const F scale = F(1.0f) / select(regular, determinant, F(1.0f));
    g.dp_du = select(regular, (edge1 * dv2 - edge2 * dv1) * scale, g.dp_du);
    g.dp_dv = select(regular, (edge2 * du1 - edge1 * du2) * scale, g.dp_dv);
}

/// At barycentric coordinates u, v of the second and third corner.
template <class F>
inline Geometry<F> triangle_geometry(const TriangleCorners<F>& t, F u, F v) {
    const F w = F(1.0f) - u - v;
    const Vec3<F> edge1 = t.p[1] - t.p[0], edge2 = t.p[2] - t.p[0];
    Geometry<F> g;
    g.p = t.p[0] * w + t.p[1] * u + t.p[2] * v;
    g.magnitude = max(max_abs(t.p[0]), max(max_abs(t.p[1]), max_abs(t.p[2])));
    g.normal = cross(edge1, edge2);
    g.shading_normal = g.normal;
    if (any(t.has_normals)) {
        const Vec3<F> n = t.n[0] * w + t.n[1] * u + t.n[2] * v;
        g.shading_normal =
            select(t.has_normals & (length_squared(n) > F(0.0f)), n, g.normal);
    }
    g.uv = {u, v};
    g.dp_du = g.dp_dv = Vec3<F>(F(0.0f));
    if (any(t.has_uv)) {
        set_texture_coordinates(g, t, u, v);
    }
    return g;
}

/// u = 1/2 + atan2(x, z) / 2 pi, v = acos(y) / pi in the sphere's own space. `outward`
/// need not be unit.
template <class F>
inline Geometry<F> sphere_geometry(const Vec3<F>& center, F radius,
                                   const Vec3<F>& outward) {
    Geometry<F> g;
    const Vec3<F> n = normalize(outward);
    g.p = center + n * radius;
    g.magnitude = max_abs(center) + radius;
    g.normal = g.shading_normal = n;
    g.uv = {F(0.5f) + atan2(n.x, n.z) * F(inv_two_pi), acos(n.y) * F(inv_pi)};
    const F ring = safe_sqrt(n.x * n.x + n.z * n.z);
    const auto off_axis = ring > F(0.0f);
    const F r = select(off_axis, ring, F(1.0f));
    g.dp_du = Vec3<F>{n.z, F(0.0f), F(0.0f) - n.x} * (F(two_pi) * radius);
    g.dp_dv =
        select(off_axis,
               Vec3<F>{n.y * n.x / r, F(0.0f) - ring, n.y * n.z / r} * (F(pi) * radius),
               Vec3<F>(F(0.0f)));
    return g;
}

template <class F>
inline Geometry<F> in_world(const Geometry<F>& g,
                            const TransformOf<F>& world_from_group) {
    const TransformOf<F>& m = world_from_group;
    const F scale = max(length(m.x), max(length(m.y), length(m.z)));
    return {m.point(g.p),
            m.normal(g.normal),
            m.normal(g.shading_normal),
            m.vector(g.dp_du),
            m.vector(g.dp_dv),
            g.uv,
            g.magnitude * scale * F(1.7320508f) + max_abs(m.origin)};
}

namespace detail {

/// A normal map's perturbation of the shading normal. In the map x runs along u and y
/// against v.
template <class F>
inline Vec3<F> mapped_normal(const Material& m, const std::vector<Texture>& textures,
                             const Geometry<F>& g, const Vec3<F>& normal) {
    const Frame<F> frame = frame_of_normal_and_tangent(normal, g.dp_du);
    const Vec3<F> rgb =
        lookup(textures[static_cast<std::size_t>(m.normal_map)], g.uv).rgb;
    const F scale(m.normal_scale);
    const F x = (F(2.0f) * rgb.x - F(1.0f)) * scale;
    const F y = (F(2.0f) * rgb.y - F(1.0f)) * scale;
    const F z = max(F(2.0f) * rgb.z - F(1.0f), F(1e-3f));
    const Vec3<F> bitangent = select(dot(frame.t, g.dp_dv) > F(0.0f), -frame.t, frame.t);
    return normalize(frame.s * x + bitangent * y + frame.n * z);
}

/// The normal of a two-sided surface on the side that `dir_out` sees, bent where it would
/// look away from a viewer on that side.
template <class F>
inline Vec3<F> facing_viewer(const Vec3<F>& normal, const Vec3<F>& geometric_normal,
                             const Vec3<F>& dir_out) {
    const F least(1e-3f);
    const Vec3<F> n = select(dot(dir_out, geometric_normal) < F(0.0f), -normal, normal);
    const F cosine = dot(dir_out, n);
    return select(cosine < least, normalize(n + dir_out * (least - cosine)), n);
}

}  // namespace detail

/// `sign`: -1 where the shape's normals are flipped; `dir_out` points back along the ray.
template <class F>
inline SurfacePoint<F> surface_point(const Geometry<F>& g, F sign,
                                     const Material& material,
                                     const std::vector<Texture>& textures,
                                     const Vec3<F>& dir_out) {
    SurfacePoint<F> s;
    s.p = g.p;
    s.uv = g.uv;
    s.error = position_error(g.magnitude);
    s.normal = normalize(g.normal) * sign;
    Vec3<F> n = normalize(g.shading_normal) * sign;
    if (material.normal_map != no_texture) {
        n = detail::mapped_normal(material, textures, g, n);
    }
    if (material.two_sided) {
        n = detail::facing_viewer(n, s.normal, dir_out);
    }
    s.shading = frame_of_normal_and_tangent(n, g.dp_du);
    return s;
}

}  // namespace raykiln
