#pragma once

#include "math/bounds.h"
#include "scene/scene.h"

namespace raykiln {

/// Whether a ray passes through bounds: never false where it meets something in them, as
/// rounding takes less than a hundredth of what is granted.
template <class F>
inline Mask<F> may_cross(const Bounds& bounds, const Vec3<F>& origin,
                         const Vec3<F>& direction) {
    F enter(0.0f), leave(infinity);
    const auto slab = [&](float low, float high, F o, F d) {
        const F inverse = F(1.0f) / select(abs(d) > F(1e-20f), d, F(1e-20f));
        const F a = (F(low) - o) * inverse, b = (F(high) - o) * inverse;
        enter = max(enter, min(a, b));
        leave = min(leave, max(a, b));
    };
    slab(bounds.low.x, bounds.high.x, origin.x, direction.x);
    slab(bounds.low.y, bounds.high.y, origin.y, direction.y);
    slab(bounds.low.z, bounds.high.z, origin.z, direction.z);
    return enter <= leave * F(1.0001f);
}

/// Whether a ray may find light at its end. Where a path may not go on from there, no
/// other ray is worth tracing.
template <class F>
inline Mask<F> may_meet_light(const Scene& scene, const Vec3<F>& origin,
                              const Vec3<F>& direction) {
    if (!scene.light_table.environments.empty()) {
        return Mask<F>(true);
    }
    Mask<F> may(false);
    for (const Bounds& bounds : scene.emitter_bounds) {
        may = may | may_cross(bounds, origin, direction);
    }
    return may;
}

}  // namespace raykiln
