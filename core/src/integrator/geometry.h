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

/// The corners of a triangle, in the space of its group. Without texture coordinates
/// `uv` holds (0, 0), (1, 0), (0, 1), without normals `n` zeros.
template <class F>
struct TriangleCorners {
    Vec3<F> p[3], n[3];
    Vec2<F> uv[3];
    Mask<F> has_uv;
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

/// At barycentric coordinates u, v of the second and third corner.
template <class F>
inline Geometry<F> triangle_geometry(const TriangleCorners<F>& t, F u, F v) {
    const F w = F(1.0f) - u - v;
    const Vec3<F> edge1 = t.p[1] - t.p[0], edge2 = t.p[2] - t.p[0];
    Geometry<F> g;
    g.p = t.p[0] * w + t.p[1] * u + t.p[2] * v;
    g.magnitude = max(max_abs(t.p[0]), max(max_abs(t.p[1]), max_abs(t.p[2])));
    g.normal = cross(edge1, edge2);
    const Vec3<F> n = t.n[0] * w + t.n[1] * u + t.n[2] * v;
    g.shading_normal = select(length_squared(n) > F(0.0f), n, g.normal);
    g.uv = {w * t.uv[0].x + u * t.uv[1].x + v * t.uv[2].x,
            w * t.uv[0].y + u * t.uv[1].y + v * t.uv[2].y};
    // Derivatives of position over texture coordinates; 0 where the mapping is
    // degenerate.
    const F du1 = t.uv[1].x - t.uv[0].x, dv1 = t.uv[1].y - t.uv[0].y;
    const F du2 = t.uv[2].x - t.uv[0].x, dv2 = t.uv[2].y - t.uv[0].y;
    const F determinant = du1 * dv2 - dv1 * du2;
    const auto regular = t.has_uv & (abs(determinant) > F(3e-38f));
    const F scale = F(1.0f) / select(regular, determinant, F(1.0f));
    const Vec3<F> zero(F(0.0f));
    g.dp_du = select(regular, (edge1 * dv2 - edge2 * dv1) * scale, zero);
    g.dp_dv = select(regular, (edge2 * du1 - edge1 * du2) * scale, zero);
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

/// A normal map's perturbation of the shading frame. In the map x runs along u and y
/// against v.
template <class F>
inline Frame<F> mapped_frame(const Material& m, const std::vector<Texture>& textures,
                             const Geometry<F>& g, const Frame<F>& frame) {
    const Vec3<F> rgb =
        lookup(textures[static_cast<std::size_t>(m.normal_map)], g.uv).rgb;
    const F scale(m.normal_scale);
    const F x = (F(2.0f) * rgb.x - F(1.0f)) * scale;
    const F y = (F(2.0f) * rgb.y - F(1.0f)) * scale;
    const F z = max(F(2.0f) * rgb.z - F(1.0f), F(1e-3f));
    const Vec3<F> bitangent = select(dot(frame.t, g.dp_dv) > F(0.0f), -frame.t, frame.t);
    const Vec3<F> n = frame.s * x + bitangent * y + frame.n * z;
    return frame_of_normal_and_tangent(normalize(n), g.dp_du);
}

/// The side of a two-sided surface that `dir_out` sees: the frame is turned to it, and
/// bent where the shading normal would look away from a viewer on that side.
template <class F>
inline Frame<F> facing_viewer(const Frame<F>& f, const Vec3<F>& geometric_normal,
                              const Vec3<F>& dir_out) {
    const F least(1e-3f);
    Vec3<F> n = select(dot(dir_out, geometric_normal) < F(0.0f), -f.n, f.n);
    const F cosine = dot(dir_out, n);
    n = select(cosine < least, normalize(n + dir_out * (least - cosine)), n);
    return frame_of_normal_and_tangent(n, f.s);
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
    s.shading = frame_of_normal_and_tangent(normalize(g.shading_normal) * sign, g.dp_du);
    if (material.normal_map != no_texture) {
        s.shading = detail::mapped_frame(material, textures, g, s.shading);
    }
    if (material.two_sided) {
        s.shading = detail::facing_viewer(s.shading, s.normal, dir_out);
    }
    return s;
}

}  // namespace raykiln
