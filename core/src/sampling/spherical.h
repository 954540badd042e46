#pragma once

#include "sampling/warp.h"

// Triangles and parallelograms sampled uniformly over the solid angle that they fill at a
// point. The map is Arvo's (1995); it is computed without inverse cosines, from
// half-angle tangents (Van Oosterom and Strackee 1983; Peters 2021, "BRDF Importance
// Sampling for Polygonal Lights"), so that nothing cancels where the solid angle is
// small.

namespace raykiln {

/// A triangle projected on the unit sphere: unit directions to its corners. `u` of a
/// sample sweeps the arc from a to c, `v` goes from b to that arc.
template <class F>
struct SphericalTriangle {
    Vec3<F> a, b, c;
    F volume;        ///< |a . (b x c)|
    F across, side;  ///< (a + b) . c, and 1 + a . b
    F solid_angle;
};

/// A corner's direction and its distance.
template <class F>
struct SphericalCorner {
    Vec3<F> direction;
    F distance;
};

/// `d`: a corner, relative to the point. Not a number at distance 0.
template <class F>
inline SphericalCorner<F> spherical_corner(const Vec3<F>& d) {
    const F distance = length(d);
    return {d / distance, distance};
}

/// `six_volume`: of the tetrahedron of the point and the corners (either sign). The
/// caller has it as edge cross products without the cancellation of a . (b x c).
template <class F>
inline SphericalTriangle<F> make_spherical_triangle(const SphericalCorner<F>& a,
                                                    const SphericalCorner<F>& b,
                                                    const SphericalCorner<F>& c,
                                                    F six_volume) {
    SphericalTriangle<F> t{a.direction, b.direction, c.direction, {}, {}, {}, {}};
    t.volume = abs(six_volume) / (a.distance * b.distance * c.distance);
    t.across = dot(a.direction, c.direction) + dot(b.direction, c.direction);
    t.side = F(1.0f) + dot(a.direction, b.direction);
    t.solid_angle = F(2.0f) * atan2(t.volume, t.across + t.side);
    return t;
}

/// `p0`: the first corner relative to the point; the other two are p0 + edge1, p0 +
/// edge2.
template <class F>
inline SphericalTriangle<F> make_spherical_triangle(const Vec3<F>& p0,
                                                    const Vec3<F>& edge1,
                                                    const Vec3<F>& edge2) {
    return make_spherical_triangle(spherical_corner(p0), spherical_corner(p0 + edge1),
                                   spherical_corner(p0 + edge2),
                                   dot(p0, cross(edge1, edge2)));
}

/// Whether the map below is well conditioned in single precision: not for specks, which
/// area sampling serves as well, nor for a point in the triangle's plane.
template <class F>
inline Mask<F> can_sample(const SphericalTriangle<F>& t) {
    return (t.solid_angle > F(1e-6f)) & (t.solid_angle < F(6.2f));
}

/// A unit direction in the triangle; pdf_solid_angle = 1 / solid_angle.
template <class F>
inline Vec3<F> sample_spherical_triangle(const SphericalTriangle<F>& t, F u, F v) {
    // The share u of the solid angle lies between a and d, d on the arc from a to c: d is
    // a mirrored at `half`.
    F sine, cosine;
    sin_cos_turns(t.solid_angle * u * F(0.5f * inv_two_pi), sine, cosine);
    const Vec3<F> half =
        t.a * (t.volume * cosine - t.across * sine) + t.c * (t.side * sine);
    const Vec3<F> d = half * (F(2.0f) * dot(t.a, half) / length_squared(half)) - t.a;
    // Cosines are uniform along the arc from b to d; 1 - cosine is what stays exact.
    const F whole = F(0.5f) * length_squared(d - t.b);
    const F part = v * whole;
    const F along = safe_sqrt(v * (F(2.0f) - part) / (F(2.0f) - whole));
    return normalize(t.b * (F(1.0f) - part - along + along * whole) + d * along);
}

/// Barycentric coordinates (of the second and third corner) of the point that a direction
/// meets; `p0` as above.
template <class F>
inline Vec2<F> place_in_triangle(const Vec3<F>& direction, const Vec3<F>& p0,
                                 const Vec3<F>& edge1, const Vec3<F>& edge2) {
    const Vec3<F> n = cross(edge1, edge2);
    const Vec3<F> q = direction * (dot(p0, n) / dot(direction, n)) - p0;
    const F scale = F(1.0f) / length_squared(n);
    const F x = clamp(dot(cross(q, edge2), n) * scale, F(0.0f), F(1.0f));
    return {x, clamp(dot(cross(edge1, q), n) * scale, F(0.0f), F(1.0f) - x)};
}

/// The same over a parallelogram: up to 1 along each of its edges.
template <class F>
inline Vec2<F> place_in_parallelogram(const Vec3<F>& direction, const Vec3<F>& p0,
                                      const Vec3<F>& edge1, const Vec3<F>& edge2) {
    const Vec3<F> n = cross(edge1, edge2);
    const Vec3<F> q = direction * (dot(p0, n) / dot(direction, n)) - p0;
    const F scale = F(1.0f) / length_squared(n);
    return {clamp(dot(cross(q, edge2), n) * scale, F(0.0f), F(1.0f)),
            clamp(dot(cross(edge1, q), n) * scale, F(0.0f), F(1.0f))};
}

/// The (u, v) that `sample_spherical_triangle` maps to a unit direction in the triangle.
template <class F>
inline Vec2<F> invert_spherical_triangle(const SphericalTriangle<F>& t,
                                         const Vec3<F>& direction) {
    const Vec3<F> aside = cross(cross(t.b, direction), cross(t.c, t.a));
    const F size = length(aside);
    const auto defined = size > F(0.0f);
    Vec3<F> d = select(defined, aside / select(defined, size, F(1.0f)), t.a);
    d = select(dot(d, t.a + t.c) < F(0.0f), -d, d);
    // Sine and cosine of half the solid angle between a and d, up to a factor: the mirror
    // line of d gives them by the equation that `sample` solves.
    const Vec3<F> half = t.a + d;
    const F cos_ac = dot(t.a, t.c);
    const F on_c =
        (dot(half, t.c) - cos_ac * dot(half, t.a)) / (F(1.0f) - cos_ac * cos_ac);
    const F on_a = dot(half, t.a) - on_c * cos_ac;
    const F angle = F(2.0f) * atan2(on_c * t.volume, on_a * t.side + on_c * t.across);
    const F whole = length_squared(d - t.b);
    const F part = length_squared(direction - t.b);
    return {clamp(angle / t.solid_angle, F(0.0f), F(1.0f)),
            select(whole > F(0.0f), min(part / whole, F(1.0f)), F(0.0f))};
}

/// A parallelogram projected on the unit sphere, as two triangles that share a corner:
/// `u` sweeps the two opposite edges in one go, so that strata of the unit square stay
/// whole.
template <class F>
struct SphericalParallelogram {
    SphericalTriangle<F> first, second;
    F solid_angle;
};

/// Corners p0, p0 + edge1, p0 + edge1 + edge2, p0 + edge2, relative to the point.
template <class F>
inline SphericalParallelogram<F> make_spherical_parallelogram(const Vec3<F>& p0,
                                                              const Vec3<F>& edge1,
                                                              const Vec3<F>& edge2) {
    const F six_volume = dot(p0, cross(edge1, edge2));
    const auto q0 = spherical_corner(p0), q1 = spherical_corner(p0 + edge1),
               q2 = spherical_corner(p0 + edge1 + edge2),
               q3 = spherical_corner(p0 + edge2);
    SphericalParallelogram<F> s{make_spherical_triangle(q1, q0, q2, six_volume),
                                make_spherical_triangle(q2, q0, q3, six_volume),
                                {}};
    s.solid_angle = s.first.solid_angle + s.second.solid_angle;
    return s;
}

template <class F>
inline Mask<F> can_sample(const SphericalParallelogram<F>& s) {
    return can_sample(s.first) & can_sample(s.second);
}

/// A unit direction in the parallelogram; pdf_solid_angle = 1 / solid_angle.
template <class F>
inline Vec3<F> sample_spherical_parallelogram(const SphericalParallelogram<F>& s, F u,
                                              F v) {
    const F angle = u * s.solid_angle;
    const Mask<F> in_first = angle < s.first.solid_angle;
    SphericalTriangle<F> t;
    t.a = select(in_first, s.first.a, s.second.a);
    t.b = s.first.b;
    t.c = select(in_first, s.first.c, s.second.c);
    t.volume = select(in_first, s.first.volume, s.second.volume);
    t.across = select(in_first, s.first.across, s.second.across);
    t.side = select(in_first, s.first.side, s.second.side);
    t.solid_angle = select(in_first, s.first.solid_angle, s.second.solid_angle);
    const F within = select(in_first, angle, angle - s.first.solid_angle) / t.solid_angle;
    return sample_spherical_triangle(t, clamp(within, F(0.0f), F(1.0f)), v);
}

}  // namespace raykiln
