#pragma once

#include "math/gather.h"
#include "math/vec.h"
#include "math/wide.h"
#include "wide/kernels.h"

// The state of a batch of paths, a plane for each number.

namespace raykiln {
inline namespace RAYKILN_WIDE_NAMESPACE {

using F = Wide;
using U = WideUint;
using M = WideMask;
constexpr int lanes = NumberTraits<F>::width;

inline F load(const float* from) {
    return NumberTraits<F>::load(from);
}
inline U load(const std::uint32_t* from) {
    return NumberTraits<U>::load(from);
}
inline Vec3<F> in_lanes(const Vec3f& v) {
    return {F(v.x), F(v.y), F(v.z)};
}

/// Whether the slots are neighbours: then whole vectors are read and written, for which
/// there are quicker ways.
inline bool in_a_row(U slots) {
    return all(slots == U(first_lane(slots)) + iota<U>());
}

/// A number a path.
struct alignas(64) Plane {
    float at[Batch::padded];

    F operator[](U slots) const {
        return in_a_row(slots) ? load(at + first_lane(slots)) : gather(at, slots);
    }
    void put(M where, U slots, F value) {
        if (in_a_row(slots)) {
            store(where, at + first_lane(slots), value);
        } else {
            scatter(where, at, slots, value);
        }
    }
};

/// Three numbers a path.
struct Plane3 {
    Plane x, y, z;

    Vec3<F> operator[](U slots) const { return {x[slots], y[slots], z[slots]}; }
    Vec3<F> load_at(int i) const {
        return {load(x.at + i), load(y.at + i), load(z.at + i)};
    }
    void put(M where, U slots, const Vec3<F>& v) {
        x.put(where, slots, v.x);
        y.put(where, slots, v.y);
        z.put(where, slots, v.z);
    }
    /// Adds where the mask is set; each slot at most once.
    void add(M where, U slots, const Vec3<F>& v) {
        put(where, slots, (*this)[slots] + v);
    }
    void store_at(int i, const Vec3<F>& v) {
        store(x.at + i, v.x);
        store(y.at + i, v.y);
        store(z.at + i, v.z);
    }
    /// Appends the lanes of the mask.
    void append(M which, int i, const Vec3<F>& v) {
        compress_store(which, v.x, x.at + i);
        compress_store(which, v.y, y.at + i);
        compress_store(which, v.z, z.at + i);
    }
    Vec3f one(std::uint32_t slot) const { return {x.at[slot], y.at[slot], z.at[slot]}; }
};

/// A slot number, or another index, a path.
struct alignas(64) Indices {
    std::uint32_t at[Batch::padded];

    U operator[](U slots) const {
        return in_a_row(slots) ? load(at + first_lane(slots)) : gather(at, slots);
    }
};

/// All paths of a batch; a path keeps its slot.
struct Paths {
    Plane3 origin, direction;  // of the ray
    Plane t_near, t_far;       // of camera rays
    Plane3 throughput, radiance;
    Plane eta_scale;  // of the radiance, by the refractions so far
    // The vertex that the ray was sent from, and the density of its direction: 0 if no
    // light sample could have found what it meets, negated if light samples alone find
    // the lights (never under a sky).
    Plane3 from, from_normal;
    Plane pdf_bsdf;
    Indices pixel_key, sample_index;
    // What the ray met.
    Plane hit_u, hit_v;
    Plane3 hit_normal;
    Indices geometry, primitive, instance, shape, home;
    Plane hit_t;
    Indices alive;  // 1: goes on after this vertex
};

/// Light that waits for its shadow ray.
struct ShadowRays {
    Plane3 origin, direction, light;
    Plane t_far;
    Indices slot;
    Indices place;  // of its light among all of them: alike for neighbours
    int size = 0;
};

}  // namespace RAYKILN_WIDE_NAMESPACE
}  // namespace raykiln
