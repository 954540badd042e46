#pragma once

#include "math/vec.h"

namespace raykiln {

/// Axis-aligned bounds; empty until something is added.
struct Bounds {
    Vec3f low{infinity, infinity, infinity};
    Vec3f high{-infinity, -infinity, -infinity};

    void add(const Vec3f& p) {
        low = {min(low.x, p.x), min(low.y, p.y), min(low.z, p.z)};
        high = {max(high.x, p.x), max(high.y, p.y), max(high.z, p.z)};
    }
    void add(const Bounds& b) {
        add(b.low);
        add(b.high);
    }
    bool empty() const { return !(low.x <= high.x); }
    Vec3f center() const { return (low + high) * 0.5f; }
    Vec3f extent() const { return high - low; }
};

/// From a point to the nearest of the bounds; 0 within them.
template <class F>
inline F distance_squared(const Bounds& b, const Vec3<F>& p) {
    const auto along = [](float low, float high, F at) {
        return max(max(F(low) - at, at - F(high)), F(0.0f));
    };
    return length_squared(Vec3<F>{along(b.low.x, b.high.x, p.x),
                                  along(b.low.y, b.high.y, p.y),
                                  along(b.low.z, b.high.z, p.z)});
}

}  // namespace raykiln
