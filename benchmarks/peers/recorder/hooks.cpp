#include <dlfcn.h>

#include <atomic>
#include <cstring>
#include <mutex>

#include "tape.h"

namespace recorder {

namespace {

std::atomic<std::int64_t> room{0};  // rays that may still be kept
float camera_origin[3];
std::mutex mutex;
Recording kept;

Tape& own_tape() {
    thread_local Tape* tape = nullptr;
    if (tape == nullptr) {
        const std::lock_guard lock(mutex);
        kept.tapes.push_back(std::make_unique<Tape>());
        tape = kept.tapes.back().get();
    }
    return *tape;
}

bool is_from_camera(const RecordedRay& ray) {
    return std::memcmp(camera_origin, ray.org, sizeof camera_origin) == 0;
}

/// `alone`: a ray that was traced by itself is the next of its path. Packets hold rays of
/// many paths, in an order that is the renderer's own and is kept.
void keep(RTCScene scene, RecordedRay ray, bool occlusion, bool alone) {
    if (room.load(std::memory_order_relaxed) <= 0 || room.fetch_sub(1) <= 0) {
        return;
    }
    Tape& tape = own_tape();
    Kind kind = shadow;
    if (!occlusion) {
        kind = is_from_camera(ray) ? camera : bounce;
        tape.depth = kind == camera || !alone ? 0 : tape.depth + 1;
    }
    ray.group = kinds * tape.depth + kind;
    tape.rays.push_back(ray);
    if (kind == camera) {
        kept.scene = scene;
    }
}

void keep_one(RTCScene s, const RTCRay& r, bool occlusion) {
    keep(s,
         {{r.org_x, r.org_y, r.org_z}, r.tnear, {r.dir_x, r.dir_y, r.dir_z}, r.tfar, 0},
         occlusion, true);
}

template <class Packet>
void keep_lanes(RTCScene s, const int* valid, const Packet& r, bool occlusion) {
    constexpr std::size_t width = sizeof r.org_x / sizeof(float);
    for (std::size_t i = 0; i < width; ++i) {
        if (valid[i] != 0) {
            keep(s,
                 {{r.org_x[i], r.org_y[i], r.org_z[i]},
                  r.tnear[i],
                  {r.dir_x[i], r.dir_y[i], r.dir_z[i]},
                  r.tfar[i],
                  0},
                 occlusion, false);
        }
    }
}

template <class Function>
Function* real(const char* name) {
    return reinterpret_cast<Function*>(dlsym(RTLD_NEXT, name));
}

}  // namespace

const Recording& recording() {
    return kept;
}

}  // namespace recorder

/// Begins to record, up to a number of rays. `origin`: where those of the camera begin.
extern "C" void recorder_start(std::int64_t rays, const float* origin) {
    std::memcpy(recorder::camera_origin, origin, sizeof recorder::camera_origin);
    recorder::room = rays;
}

/// Stops, and says how many rays there are of each kind.
extern "C" void recorder_stop(std::int64_t* counts) {
    recorder::room = 0;
    for (const auto& tape : recorder::kept.tapes) {
        for (const recorder::RecordedRay& ray : tape->rays) {
            ++counts[ray.group % recorder::kinds];
        }
    }
}

#if RTC_VERSION_MAJOR >= 4
#define PARAMETERS(T, ARGUMENTS) RTCScene s, T *rays, ARGUMENTS *arguments
#define VALUES s, rays, arguments
#else
#define PARAMETERS(T, ARGUMENTS) RTCScene s, RTCIntersectContext *context, T *rays
#define VALUES s, context, rays
#endif

#define HOOK_ONE(NAME, T, ARGUMENTS, RAY, OCCLUSION)                       \
    extern "C" void NAME(PARAMETERS(T, ARGUMENTS)) {                       \
        static auto* const traced = recorder::real<decltype(NAME)>(#NAME); \
        recorder::keep_one(s, RAY, OCCLUSION);                             \
        traced(VALUES);                                                    \
    }
#define HOOK_MANY(NAME, T, ARGUMENTS, RAY, OCCLUSION)                      \
    extern "C" void NAME(const int* valid, PARAMETERS(T, ARGUMENTS)) {     \
        static auto* const traced = recorder::real<decltype(NAME)>(#NAME); \
        recorder::keep_lanes(s, valid, RAY, OCCLUSION);                    \
        traced(valid, VALUES);                                             \
    }

HOOK_ONE(rtcIntersect1, RTCRayHit, RTCIntersectArguments, rays->ray, false)
HOOK_MANY(rtcIntersect4, RTCRayHit4, RTCIntersectArguments, rays->ray, false)
HOOK_MANY(rtcIntersect8, RTCRayHit8, RTCIntersectArguments, rays->ray, false)
HOOK_MANY(rtcIntersect16, RTCRayHit16, RTCIntersectArguments, rays->ray, false)
HOOK_ONE(rtcOccluded1, RTCRay, RTCOccludedArguments, *rays, true)
HOOK_MANY(rtcOccluded4, RTCRay4, RTCOccludedArguments, *rays, true)
HOOK_MANY(rtcOccluded8, RTCRay8, RTCOccludedArguments, *rays, true)
HOOK_MANY(rtcOccluded16, RTCRay16, RTCOccludedArguments, *rays, true)
