#pragma once

#include <cstddef>

// The seam between Embree 3.13 (Debian 12) and Embree 4 (Debian 13).

#if __has_include(<embree4/rtcore.h>)
#include <embree4/rtcore.h>
#else
#include <embree3/rtcore.h>
#endif

#include "accel/packet.h"

namespace raykiln {

static_assert(offsetof(RayPacket<16>, t_far) == offsetof(RTCRayHit16, ray.tfar));
static_assert(offsetof(RayPacket<16>, direction_x) == offsetof(RTCRayHit16, ray.dir_x));
static_assert(offsetof(RayPacket<16>, normal_x) == offsetof(RTCRayHit16, hit.Ng_x));
static_assert(offsetof(RayPacket<16>, instance) == offsetof(RTCRayHit16, hit.instID));
static_assert(sizeof(RayPacket<16>) >= sizeof(RTCRayHit16) + sizeof(std::int32_t[16]));

#if RTC_VERSION_MAJOR >= 4

inline void embree_intersect(RTCScene scene, RTCRayHit& ray_hit) {
    RTCIntersectArguments arguments;
    rtcInitIntersectArguments(&arguments);
    rtcIntersect1(scene, &ray_hit, &arguments);
}
inline void embree_occluded(RTCScene scene, RTCRay& ray) {
    RTCOccludedArguments arguments;
    rtcInitOccludedArguments(&arguments);
    rtcOccluded1(scene, &ray, &arguments);
}
template <int N>
inline void embree_intersect(RTCScene scene, RayPacket<N>& p, bool coherent) {
    RTCIntersectArguments arguments;
    rtcInitIntersectArguments(&arguments);
    arguments.flags =
        coherent ? RTC_RAY_QUERY_FLAG_COHERENT : RTC_RAY_QUERY_FLAG_INCOHERENT;
    if constexpr (N == 4) {
        rtcIntersect4(p.valid, scene, reinterpret_cast<RTCRayHit4*>(&p), &arguments);
    } else if constexpr (N == 8) {
        rtcIntersect8(p.valid, scene, reinterpret_cast<RTCRayHit8*>(&p), &arguments);
    } else {
        rtcIntersect16(p.valid, scene, reinterpret_cast<RTCRayHit16*>(&p), &arguments);
    }
}
template <int N>
inline void embree_occluded(RTCScene scene, RayPacket<N>& p) {
    RTCOccludedArguments arguments;
    rtcInitOccludedArguments(&arguments);
    if constexpr (N == 4) {
        rtcOccluded4(p.valid, scene, reinterpret_cast<RTCRay4*>(&p), &arguments);
    } else if constexpr (N == 8) {
        rtcOccluded8(p.valid, scene, reinterpret_cast<RTCRay8*>(&p), &arguments);
    } else {
        rtcOccluded16(p.valid, scene, reinterpret_cast<RTCRay16*>(&p), &arguments);
    }
}

#else

inline void embree_intersect(RTCScene scene, RTCRayHit& ray_hit) {
    RTCIntersectContext context;
    rtcInitIntersectContext(&context);
    rtcIntersect1(scene, &context, &ray_hit);
}
inline void embree_occluded(RTCScene scene, RTCRay& ray) {
    RTCIntersectContext context;
    rtcInitIntersectContext(&context);
    rtcOccluded1(scene, &context, &ray);
}
template <int N>
inline void embree_intersect(RTCScene scene, RayPacket<N>& p, bool coherent) {
    RTCIntersectContext context;
    rtcInitIntersectContext(&context);
    context.flags = coherent ? RTC_INTERSECT_CONTEXT_FLAG_COHERENT
                             : RTC_INTERSECT_CONTEXT_FLAG_INCOHERENT;
    if constexpr (N == 4) {
        rtcIntersect4(p.valid, scene, &context, reinterpret_cast<RTCRayHit4*>(&p));
    } else if constexpr (N == 8) {
        rtcIntersect8(p.valid, scene, &context, reinterpret_cast<RTCRayHit8*>(&p));
    } else {
        rtcIntersect16(p.valid, scene, &context, reinterpret_cast<RTCRayHit16*>(&p));
    }
}
template <int N>
inline void embree_occluded(RTCScene scene, RayPacket<N>& p) {
    RTCIntersectContext context;
    rtcInitIntersectContext(&context);
    if constexpr (N == 4) {
        rtcOccluded4(p.valid, scene, &context, reinterpret_cast<RTCRay4*>(&p));
    } else if constexpr (N == 8) {
        rtcOccluded8(p.valid, scene, &context, reinterpret_cast<RTCRay8*>(&p));
    } else {
        rtcOccluded16(p.valid, scene, &context, reinterpret_cast<RTCRay16*>(&p));
    }
}

#endif

}  // namespace raykiln
