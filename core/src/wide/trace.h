#pragma once

#include "integrator/context.h"
#include "wide/planes.h"

// Rays of a batch through Embree. Packets hold samples of one pixel and pass only, and
// the others of its rays go one by one: so what a path meets never depends on which other
// pixels are in the batch. (Two surfaces at exactly one distance are told apart by the
// order in which they are met, and that differs from packet to packet.)

namespace raykiln {
inline namespace RAYKILN_WIDE_NAMESPACE {

// Fewer rays than this are faster one by one.
constexpr int least_packet = lanes >= 16 ? 6 : lanes >= 8 ? 4 : 3;
// Rays that go alike, as through a smooth surface, are traced as camera
// rays are if they are at least as many as this.
constexpr int least_alike = lanes >= 8 ? 4 : 3;
constexpr float alike_cosine = 0.997f;

/// The lanes of `which` whose directions are near the first one's; `lengths2`: squared
/// lengths of the directions.
inline std::uint32_t alike_lanes(const Vec3<F>& direction, F lengths2,
                                 std::uint32_t which) {
    const int first = std::countr_zero(which);
    const Vec3<F> lead{F(direction.x.lane(first)), F(direction.y.lane(first)),
                       F(direction.z.lane(first))};
    const F cosine = dot(direction, lead);
    const F most = lengths2 * F(lengths2.lane(first)) * F(alike_cosine * alike_cosine);
    return which & bits((cosine > F(0.0f)) & (cosine * cosine > most));
}

/// Calls `take(lanes)` for up to two groups of rays that go alike, and returns the rest.
template <class Take>
inline std::uint32_t take_alike(const Vec3<F>& direction, std::uint32_t which,
                                const Take& take) {
    const F lengths2 = length_squared(direction);
    std::uint32_t left = which;
    for (int i = 0; i < 2 && std::popcount(left) >= least_alike; ++i) {
        const std::uint32_t group = alike_lanes(direction, lengths2, left);
        if (std::popcount(group) >= least_alike) {
            take(group);
            which &= ~group;
        }
        left &= ~group;
    }
    return which;
}

inline Context lane_context(const BatchScene& b, const Paths& paths, std::uint32_t slot,
                            RayCounts& counts) {
    return {b.scene,     b.accel,
            b.estimator, {paths.pixel_key.at[slot], paths.sample_index.at[slot]},
            counts,      b.guide};
}

inline void set_hit(Paths& paths, std::uint32_t slot, const Hit& hit) {
    paths.hit_t.at[slot] = hit.t;
    paths.hit_u.at[slot] = hit.u;
    paths.hit_v.at[slot] = hit.v;
    paths.hit_normal.x.at[slot] = hit.normal.x;
    paths.hit_normal.y.at[slot] = hit.normal.y;
    paths.hit_normal.z.at[slot] = hit.normal.z;
    paths.geometry.at[slot] = hit.geometry;
    paths.primitive.at[slot] = hit.primitive;
    paths.instance.at[slot] = hit.instance;
}

/// Rays in the slots from `begin` on, those of the bits of `which`.
inline void trace_packet(const BatchScene& b, Paths& paths, std::uint32_t begin,
                         std::uint32_t which, bool camera_rays, bool coherent) {
    RayPacket<lanes> p;
    p.prepare();
    const auto copy = [&](float* to, const Plane& plane) {
        store(to, load(plane.at + begin));
    };
    copy(p.origin_x, paths.origin.x);
    copy(p.origin_y, paths.origin.y);
    copy(p.origin_z, paths.origin.z);
    copy(p.direction_x, paths.direction.x);
    copy(p.direction_y, paths.direction.y);
    copy(p.direction_z, paths.direction.z);
    if (camera_rays) {
        copy(p.t_near, paths.t_near);
        copy(p.t_far, paths.t_far);
    } else {
        store(p.t_near, F(0.0f));
        store(p.t_far, F(infinity));
    }
    const M mask = M::of_bits(which);
    store(reinterpret_cast<std::uint32_t*>(p.valid), select(mask, U(0xffffffffu), U(0u)));
    b.accel.intersect(p, coherent);
    const auto put = [&](Plane& plane, const float* from) {
        store(mask, plane.at + begin, load(from));
    };
    put(paths.hit_t, p.t_far);
    put(paths.hit_u, p.u);
    put(paths.hit_v, p.v);
    put(paths.hit_normal.x, p.normal_x);
    put(paths.hit_normal.y, p.normal_y);
    put(paths.hit_normal.z, p.normal_z);
    store(mask, paths.geometry.at + begin, load(p.geometry));
    store(mask, paths.primitive.at + begin, load(p.primitive));
    store(mask, paths.instance.at + begin, load(p.instance));
}

/// Rays of the slots against all triangles of a scene that has only a few.
inline void trace_few(const BatchScene& b, Paths& paths, const Indices& active, int count,
                      bool camera_rays) {
    for (int i = 0; i < count; i += lanes) {
        const M valid = M::first(std::min(lanes, count - i));
        const U slots = select(valid, load(active.at + i), U(active.at[i]));
        const F t_near = camera_rays ? paths.t_near[slots] : F(0.0f);
        const F t_far = camera_rays ? paths.t_far[slots] : F(infinity);
        const FewTrianglesHit<F> hit = intersect(b.few_triangles, paths.origin[slots],
                                                 paths.direction[slots], t_near, t_far);
        const M met = valid & hit.met;
        const auto id = [&](const std::vector<std::uint32_t>& of_triangle) {
            return gather(met, of_triangle.data(), hit.triangle, U(no_index));
        };
        paths.hit_t.put(valid, slots, hit.t);
        paths.hit_u.put(valid, slots, hit.u);
        paths.hit_v.put(valid, slots, hit.v);
        scatter(valid, paths.geometry.at, slots, id(b.few_triangles.geometry));
        scatter(valid, paths.primitive.at, slots, id(b.few_triangles.primitive));
        scatter(valid, paths.instance.at, slots, U(no_index));
    }
}

inline Ray lane_ray(const Paths& paths, std::uint32_t slot, bool camera_rays) {
    Ray ray{paths.origin.one(slot), paths.direction.one(slot)};
    if (camera_rays) {
        ray.t_near = paths.t_near.at[slot];
        ray.t_far = paths.t_far.at[slot];
    }
    return ray;
}

/// Finds what the rays of the `active` slots (ascending) meet.
inline void trace_paths(const BatchScene& b, Paths& paths, const Indices& active,
                        int count, int depth, RayCounts& counts) {
    const bool camera_rays = depth == 1;
    if (b.scene.has_opacity) {
        for (int i = 0; i < count; ++i) {
            const std::uint32_t slot = active.at[i];
            const Context c = lane_context(b, paths, slot, counts);
            set_hit(paths, slot,
                    trace(c, lane_ray(paths, slot, camera_rays), bsdf_group(depth)));
        }
        return;
    }
    if (!b.few_triangles.empty()) {
        trace_few(b, paths, active, count, camera_rays);
        return;
    }
    for (int i = 0; i < count;) {
        const std::uint32_t home = paths.home.at[active.at[i]];
        std::uint32_t which = 0;
        int end = i;
        while (end < count && paths.home.at[active.at[end]] == home) {
            which |= 1u << (active.at[end] - home);
            ++end;
        }
        if (camera_rays) {
            if (std::popcount(which) >= least_packet) {
                trace_packet(b, paths, home, which, true, true);
                which = 0;
            }
        } else {
            which = take_alike(paths.direction.load_at(static_cast<int>(home)), which,
                               [&](std::uint32_t alike) {
                                   trace_packet(b, paths, home, alike, false, true);
                               });
            if (std::popcount(which) >= least_packet) {
                trace_packet(b, paths, home, which, false, false);
                which = 0;
            }
        }
        for (; which != 0; which &= which - 1) {
            const auto slot = home + static_cast<std::uint32_t>(std::countr_zero(which));
            set_hit(paths, slot, b.accel.intersect(lane_ray(paths, slot, camera_rays)));
        }
        i = end;
    }
}

/// Shadow rays in the order that they are traced in: as they are, or by their lights'
/// places.
class ShadowOrder {
  public:
    ShadowOrder(const ShadowRays& rays, bool sorted) : sorted_(sorted) {
        if (!sorted) {
            return;
        }
        std::uint16_t end[LightTree::places + 1] = {};
        for (int i = 0; i < rays.size; ++i) {
            ++end[rays.place.at[i] + 1];
        }
        for (std::size_t k = 1; k < std::size(end); ++k) {
            end[k] = static_cast<std::uint16_t>(end[k] + end[k - 1]);
        }
        for (int i = 0; i < rays.size; ++i) {
            at_[end[rays.place.at[i]]++] = static_cast<std::uint32_t>(i);
        }
        std::fill_n(at_ + rays.size, lanes, 0u);
    }
    /// What the rays from the `i`th on have; those past the end anything.
    Vec3<F> of(const Plane3& plane, int i) const {
        return sorted_ ? plane[load(at_ + i)] : plane.load_at(i);
    }
    F of(const Plane& plane, int i) const {
        return sorted_ ? plane[load(at_ + i)] : load(plane.at + i);
    }
    U of(const Indices& indices, int i) const {
        return sorted_ ? indices[load(at_ + i)] : load(indices.at + i);
    }
    /// The number of the `i`th ray.
    std::uint32_t operator[](int i) const {
        return sorted_ ? at_[i] : static_cast<std::uint32_t>(i);
    }

  private:
    std::uint32_t at_[Batch::padded];
    bool sorted_;
};

/// Whether something is between: any packet will do, as only that counts.
inline M shadowed(const BatchScene& b, const ShadowRays& rays, const ShadowOrder& order,
                  int begin, M wanted) {
    const Vec3<F> origin = order.of(rays.origin, begin);
    const Vec3<F> direction = order.of(rays.direction, begin);
    const F t_far = order.of(rays.t_far, begin);
    if (!b.few_triangles.empty()) {
        return occluded(b.few_triangles, origin, direction, t_far, wanted);
    }
    RayPacket<lanes> p;
    p.prepare();
    store(p.origin_x, origin.x);
    store(p.origin_y, origin.y);
    store(p.origin_z, origin.z);
    store(p.direction_x, direction.x);
    store(p.direction_y, direction.y);
    store(p.direction_z, direction.z);
    store(p.t_near, F(0.0f));
    store(p.t_far, t_far);
    store(reinterpret_cast<std::uint32_t*>(p.valid),
          select(wanted, U(0xffffffffu), U(0u)));
    b.accel.occluded(p);
    return load(p.t_far) < F(0.0f);
}

/// The same where surfaces may let rays through: one by one.
inline M shadowed_through_opacity(const BatchScene& b, const Paths& paths,
                                  const ShadowRays& rays, const ShadowOrder& order,
                                  int begin, M wanted, int depth, RayCounts& counts) {
    std::uint32_t blocked = 0;
    for (int i = 0; i < lanes; ++i) {
        if (!wanted.lane(i)) {
            continue;
        }
        const std::uint32_t k = order[begin + i];
        const Context c = lane_context(b, paths, rays.slot.at[k], counts);
        const Ray ray{rays.origin.one(k), rays.direction.one(k), 0.0f, rays.t_far.at[k]};
        blocked |= (trace(c, ray, light_group(depth)).valid() ? 1u : 0u) << i;
    }
    return M::of_bits(blocked);
}

/// Adds the light of those shadow rays that nothing stops.
inline void trace_shadows(const BatchScene& b, Paths& paths, ShadowRays& rays, int depth,
                          RayCounts& counts) {
    counts.shadow += static_cast<std::uint64_t>(rays.size);
    const ShadowOrder order(rays, b.sorts_shadows());
    for (int i = 0; i < rays.size; i += lanes) {
        const M wanted = M::first(std::min(lanes, rays.size - i));
        const M blocked = b.scene.has_opacity
                              ? shadowed_through_opacity(b, paths, rays, order, i, wanted,
                                                         depth, counts)
                              : shadowed(b, rays, order, i, wanted);
        const U slots = select(wanted, order.of(rays.slot, i), U(0u));
        paths.radiance.add(wanted & !blocked, slots, order.of(rays.light, i));
    }
    rays.size = 0;
}

}  // namespace RAYKILN_WIDE_NAMESPACE
}  // namespace raykiln
