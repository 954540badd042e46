#pragma once

#include <array>

#include "math/vec.h"

namespace raykiln {

/// An affine map, stored as the columns of its linear part and a translation.
template <class F>
struct TransformOf {
    Vec3<F> x{F(1.0f), F(0.0f), F(0.0f)}, y{F(0.0f), F(1.0f), F(0.0f)},
        z{F(0.0f), F(0.0f), F(1.0f)}, origin{F(0.0f), F(0.0f), F(0.0f)};

    Vec3<F> point(const Vec3<F>& p) const { return vector(p) + origin; }
    Vec3<F> vector(const Vec3<F>& v) const { return x * v.x + y * v.y + z * v.z; }
    /// A direction of the surface normal: the inverse transpose, up to its positive
    /// scale.
    Vec3<F> normal(const Vec3<F>& n) const {
        const Vec3<F> cofactors =
            cross(y, z) * n.x + cross(z, x) * n.y + cross(x, y) * n.z;
        return select(determinant() < F(0.0f), -cofactors, cofactors);
    }
    F determinant() const { return dot(x, cross(y, z)); }
};
using Transform = TransformOf<float>;

/// The inverse linear part (the translation is dropped); the determinant must not be 0.
inline Transform inverse_linear(const Transform& m) {
    const float s = 1.0f / m.determinant();
    const Vec3f r0 = cross(m.y, m.z) * s;
    const Vec3f r1 = cross(m.z, m.x) * s;
    const Vec3f r2 = cross(m.x, m.y) * s;
    return {{r0.x, r1.x, r2.x}, {r0.y, r1.y, r2.y}, {r0.z, r1.z, r2.z}, {0, 0, 0}};
}

/// From the first three rows of a row-major 4 x 4 matrix that acts on column vectors.
inline Transform transform_of_rows(const float* m) {
    return {
        {m[0], m[4], m[8]}, {m[1], m[5], m[9]}, {m[2], m[6], m[10]}, {m[3], m[7], m[11]}};
}

}  // namespace raykiln
