#pragma once

#include <cstdint>
#include <vector>

#include "math/frame.h"
#include "math/gather.h"
#include "math/ray.h"
#include "scene/scene.h"

namespace raykiln {

/// The triangles of a scene that has only a few, for testing rays against all of them: a
/// hierarchy over so few costs more than it saves. The rays' lanes never influence each
/// other, and of surfaces at one distance the first in the list is met.
///
/// Watertight: vertices at one place are one vertex, and both triangles of an edge decide
/// by the same number, as in Woop, Benthin and Wald 2013, "Watertight Ray/Triangle
/// Intersection".
struct FewTriangles {
    static constexpr std::size_t most = 64;

    struct Edge {
        std::uint32_t a, b;  ///< vertices, a < b
    };
    struct Triangle {
        std::uint32_t edge[3];  ///< opposite of corners 0, 1 and 2
        std::uint32_t flip[3];  ///< the sign bit where it runs from its b to its a
        Vec3f corner, normal;   ///< corner 0; not normalised
    };
    std::vector<Vec3f> vertices;
    std::vector<Edge> edges;
    std::vector<Triangle> triangles;
    // Of each triangle.
    std::vector<std::uint32_t> geometry, primitive;

    FewTriangles() = default;
    /// Empty if there are more than `most` triangles, spheres, or instances.
    explicit FewTriangles(const Scene& scene);
    bool empty() const { return triangles.empty(); }
};

/// Where rays meet the first of the triangles.
template <class F>
struct FewTrianglesHit {
    Mask<F> met;
    Uint<F> triangle;
    F t, u, v;  ///< barycentric coordinates of corners 1 and 2
};

namespace detail {

/// Numbers for each vertex and edge, seen along the rays.
template <class F>
struct SeenEdges {
    F edge[3 * FewTriangles::most];

    SeenEdges(const FewTriangles& few, const Vec3<F>& origin, const Vec3<F>& direction) {
        F x[3 * FewTriangles::most], y[3 * FewTriangles::most];
        const Frame<F> frame = frame_of_normal(normalize(direction));
        for (std::size_t i = 0; i < few.vertices.size(); ++i) {
            const Vec3f& p = few.vertices[i];
            const Vec3<F> v = Vec3<F>(F(p.x), F(p.y), F(p.z)) - origin;
            x[i] = dot(v, frame.s);
            y[i] = dot(v, frame.t);
        }
        for (std::size_t i = 0; i < few.edges.size(); ++i) {
            const auto [a, b] = few.edges[i];
            edge[i] = x[a] * y[b] - x[b] * y[a];
        }
    }
};

/// Twice the areas that the ray makes with the triangle's edges, all of one sign where it
/// passes between them.
template <class F>
struct EdgeAreas {
    F area[3];

    EdgeAreas(const FewTriangles::Triangle& t, const SeenEdges<F>& seen) {
        for (int k = 0; k < 3; ++k) {
            area[k] = as_float(as_uint(seen.edge[t.edge[k]]) ^ Uint<F>(t.flip[k]));
        }
    }
    Mask<F> within() const {
        return (min(min(area[0], area[1]), area[2]) >= F(0.0f)) |
               (max(max(area[0], area[1]), area[2]) <= F(0.0f));
    }
};

template <class F>
inline F distance_to_plane(const FewTriangles::Triangle& t, const Vec3<F>& origin,
                           const Vec3<F>& direction) {
    const Vec3<F> n(F(t.normal.x), F(t.normal.y), F(t.normal.z));
    const Vec3<F> p(F(t.corner.x), F(t.corner.y), F(t.corner.z));
    return dot(n, p - origin) / dot(n, direction);
}

}  // namespace detail

template <class F>
inline FewTrianglesHit<F> intersect(const FewTriangles& few, const Vec3<F>& origin,
                                    const Vec3<F>& direction, F t_near, F t_far) {
    const detail::SeenEdges<F> seen(few, origin, direction);
    F nearest = t_far, area1(0.0f), area2(0.0f), sum(1.0f);
    Uint<F> triangle(no_index);
    for (std::size_t i = 0; i < few.triangles.size(); ++i) {
        const FewTriangles::Triangle& t = few.triangles[i];
        const detail::EdgeAreas<F> e(t, seen);
        const auto within = e.within();
        if (none(within)) {
            continue;
        }
        const F distance = detail::distance_to_plane(t, origin, direction);
        const F all = e.area[0] + e.area[1] + e.area[2];
        const auto nearer =
            within & (distance > t_near) & (distance < nearest) & (all != F(0.0f));
        nearest = select(nearer, distance, nearest);
        area1 = select(nearer, e.area[1], area1);
        area2 = select(nearer, e.area[2], area2);
        sum = select(nearer, all, sum);
        triangle = select(nearer, Uint<F>(static_cast<std::uint32_t>(i)), triangle);
    }
    return {triangle != Uint<F>(no_index), triangle, nearest, area1 / sum, area2 / sum};
}

/// Whether something lies between the ends of the rays, for those that are `wanted`.
template <class F>
inline Mask<F> occluded(const FewTriangles& few, const Vec3<F>& origin,
                        const Vec3<F>& direction, F t_far, Mask<F> wanted) {
    const detail::SeenEdges<F> seen(few, origin, direction);
    auto open = wanted;
    for (const FewTriangles::Triangle& t : few.triangles) {
        const detail::EdgeAreas<F> e(t, seen);
        const auto within = open & e.within();
        if (none(within)) {
            continue;
        }
        const F distance = detail::distance_to_plane(t, origin, direction);
        open = open & !(within & (distance > F(0.0f)) & (distance < t_far) &
                        (e.area[0] + e.area[1] + e.area[2] != F(0.0f)));
        if (none(open)) {
            break;
        }
    }
    return wanted & !open;
}

}  // namespace raykiln
