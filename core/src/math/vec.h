#pragma once

#include "math/number.h"

namespace raykiln {

/// Two numbers: a texture coordinate, a point of the unit square.
template <class F>
struct Vec2 {
    F x{}, y{};
};

/// Three numbers: a point, a direction, a normal, or a colour (linear Rec.709 RGB).
template <class F>
struct Vec3 {
    F x{}, y{}, z{};

    Vec3() = default;
    Vec3(F x_, F y_, F z_) : x(x_), y(y_), z(z_) {}
    explicit Vec3(F all) : x(all), y(all), z(all) {}

    Vec3 operator-() const { return {F(0.0f) - x, F(0.0f) - y, F(0.0f) - z}; }
    Vec3& operator+=(const Vec3& b) { return *this = *this + b; }
    Vec3& operator*=(const Vec3& b) { return *this = *this * b; }
    Vec3& operator*=(F s) { return *this = *this * s; }

    friend Vec3 operator+(const Vec3& a, const Vec3& b) {
        return {a.x + b.x, a.y + b.y, a.z + b.z};
    }
    friend Vec3 operator-(const Vec3& a, const Vec3& b) {
        return {a.x - b.x, a.y - b.y, a.z - b.z};
    }
    friend Vec3 operator*(const Vec3& a, const Vec3& b) {
        return {a.x * b.x, a.y * b.y, a.z * b.z};
    }
    friend Vec3 operator/(const Vec3& a, const Vec3& b) {
        return {a.x / b.x, a.y / b.y, a.z / b.z};
    }
    friend Vec3 operator*(const Vec3& a, F s) { return {a.x * s, a.y * s, a.z * s}; }
    friend Vec3 operator*(F s, const Vec3& a) { return a * s; }
    friend Vec3 operator/(const Vec3& a, F s) { return a * (F(1.0f) / s); }
};

using Vec2f = Vec2<float>;
using Vec3f = Vec3<float>;

/// One lane of a number type of SIMD width.
template <class F>
inline Vec3f lane_of(const Vec3<F>& v, int lane) {
    return {v.x.lane(lane), v.y.lane(lane), v.z.lane(lane)};
}
template <class F>
inline void set_lane(Vec3<F>& v, int lane, const Vec3f& value) {
    v.x.set_lane(lane, value.x);
    v.y.set_lane(lane, value.y);
    v.z.set_lane(lane, value.z);
}

template <class F>
inline Vec3<F> select(Mask<F> mask, const Vec3<F>& a, const Vec3<F>& b) {
    return {select(mask, a.x, b.x), select(mask, a.y, b.y), select(mask, a.z, b.z)};
}
template <class F>
inline Vec2<F> select(Mask<F> mask, const Vec2<F>& a, const Vec2<F>& b) {
    return {select(mask, a.x, b.x), select(mask, a.y, b.y)};
}
template <class F>
inline F dot(const Vec3<F>& a, const Vec3<F>& b) {
    return a.x * b.x + a.y * b.y + a.z * b.z;
}
template <class F>
inline Vec3<F> cross(const Vec3<F>& a, const Vec3<F>& b) {
    return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}
template <class F>
inline F length_squared(const Vec3<F>& v) {
    return dot(v, v);
}
template <class F>
inline F length(const Vec3<F>& v) {
    return sqrt(dot(v, v));
}
template <class F>
inline Vec3<F> normalize(const Vec3<F>& v) {
    return v / length(v);
}
template <class F>
inline F max_component(const Vec3<F>& v) {
    return max(v.x, max(v.y, v.z));
}
/// Component 0 (x), 1 (y) or 2 (z).
inline float component(const Vec3f& v, int axis) {
    return axis == 0 ? v.x : axis == 1 ? v.y : v.z;
}
inline float& component(Vec3f& v, int axis) {
    return axis == 0 ? v.x : axis == 1 ? v.y : v.z;
}
/// The greatest magnitude of a component.
template <class F>
inline F max_abs(const Vec3<F>& v) {
    return max(abs(v.x), max(abs(v.y), abs(v.z)));
}
template <class F>
inline F mean(const Vec3<F>& v) {
    return (v.x + v.y + v.z) * F(1.0f / 3.0f);
}
/// Luminance of a linear Rec.709 colour.
template <class F>
inline F luminance(const Vec3<F>& c) {
    return F(0.212671f) * c.x + F(0.715160f) * c.y + F(0.072169f) * c.z;
}
inline bool is_finite(const Vec3f& v) {
    return std::isfinite(v.x) && std::isfinite(v.y) && std::isfinite(v.z);
}
template <class F>
inline Vec3<F> lerp(const Vec3<F>& a, const Vec3<F>& b, F t) {
    return a + (b - a) * t;
}
template <class F>
inline Vec3<F> safe_sqrt(const Vec3<F>& v) {
    return {safe_sqrt(v.x), safe_sqrt(v.y), safe_sqrt(v.z)};
}

}  // namespace raykiln
