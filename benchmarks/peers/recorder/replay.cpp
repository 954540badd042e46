#include <dlfcn.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cstring>
#include <map>
#include <thread>

#include "tape.h"

namespace recorder {

namespace {

/// Rays side by side; the last one of a group is filled up with lanes that are off.
template <int width>
struct alignas(64) Bundle {
    float org[3][width], tnear[width], dir[3][width], tfar[width];
    int valid[width];
};

// Rays of a kind and depth are put side by side within so many rays of a thread, as a
// renderer that keeps its paths in batches could do.
constexpr std::size_t window = 1 << 15;

template <int width>
Bundle<width> bundle(const RecordedRay* const* rays, std::size_t count) {
    Bundle<width> b{};
    for (std::size_t lane = 0; lane < width; ++lane) {
        const RecordedRay& ray = *rays[lane < count ? lane : 0];
        for (int axis = 0; axis < 3; ++axis) {
            b.org[axis][lane] = ray.org[axis];
            b.dir[axis][lane] = ray.dir[axis];
        }
        b.tnear[lane] = ray.tnear;
        b.tfar[lane] = ray.tfar;
        b.valid[lane] = lane < count ? -1 : 0;
    }
    return b;
}

/// All rays of a kind; single ones in the renderer's own order.
template <int width>
std::vector<Bundle<width>> bundles(Kind kind) {
    std::vector<Bundle<width>> packed;
    for (const auto& tape : recording().tapes) {
        for (std::size_t begin = 0; begin < tape->rays.size(); begin += window) {
            std::map<std::uint32_t, std::vector<const RecordedRay*>> groups;
            const std::size_t end = std::min(begin + window, tape->rays.size());
            for (std::size_t i = begin; i < end; ++i) {
                const RecordedRay& ray = tape->rays[i];
                if (ray.group % kinds == kind) {
                    groups[width == 1 ? 0 : ray.group].push_back(&ray);
                }
            }
            for (const auto& [group, rays] : groups) {
                for (std::size_t i = 0; i < rays.size(); i += width) {
                    packed.push_back(bundle<width>(&rays[i], rays.size() - i));
                }
            }
        }
    }
    return packed;
}

// Straight to the ray tracer, past the hooks of this library.
template <class Function>
Function* real(const char* name) {
    return reinterpret_cast<Function*>(dlsym(RTLD_NEXT, name));
}

/// One call of Embree 3 or 4.
class Tracer {
  public:
    Tracer(RTCScene scene, bool coherent) : scene_(scene) {
#if RTC_VERSION_MAJOR >= 4
        rtcInitIntersectArguments(&intersect_);
        rtcInitOccludedArguments(&occluded_);
        const RTCRayQueryFlags flags =
            coherent ? RTC_RAY_QUERY_FLAG_COHERENT : RTC_RAY_QUERY_FLAG_INCOHERENT;
        intersect_.flags = flags;
        occluded_.flags = flags;
#else
        rtcInitIntersectContext(&context_);
        context_.flags = coherent ? RTC_INTERSECT_CONTEXT_FLAG_COHERENT
                                  : RTC_INTERSECT_CONTEXT_FLAG_INCOHERENT;
#endif
    }

    void trace(const int*, RTCRayHit& r) { one(intersect1, r); }
    void trace(const int*, RTCRay& r) { one(occluded1, r); }
    void trace(const int* v, RTCRayHit8& r) { many(intersect8, v, r); }
    void trace(const int* v, RTCRay8& r) { many(occluded8, v, r); }
    void trace(const int* v, RTCRayHit16& r) { many(intersect16, v, r); }
    void trace(const int* v, RTCRay16& r) { many(occluded16, v, r); }

  private:
#if RTC_VERSION_MAJOR >= 4
    template <class Rays>
    auto* arguments() {
        if constexpr (requires(Rays r) { r.hit; }) {
            return &intersect_;
        } else {
            return &occluded_;
        }
    }
    template <class Function, class Rays>
    void one(Function* function, Rays& rays) {
        function(scene_, &rays, arguments<Rays>());
    }
    template <class Function, class Rays>
    void many(Function* function, const int* valid, Rays& rays) {
        function(valid, scene_, &rays, arguments<Rays>());
    }
    RTCIntersectArguments intersect_;
    RTCOccludedArguments occluded_;
#else
    template <class Function, class Rays>
    void one(Function* function, Rays& rays) {
        function(scene_, &context_, &rays);
    }
    template <class Function, class Rays>
    void many(Function* function, const int* valid, Rays& rays) {
        function(valid, scene_, &context_, &rays);
    }
    RTCIntersectContext context_;
#endif
    RTCScene scene_;

    inline static auto* const intersect1 = real<decltype(rtcIntersect1)>("rtcIntersect1");
    inline static auto* const occluded1 = real<decltype(rtcOccluded1)>("rtcOccluded1");
    inline static auto* const intersect8 = real<decltype(rtcIntersect8)>("rtcIntersect8");
    inline static auto* const occluded8 = real<decltype(rtcOccluded8)>("rtcOccluded8");
    inline static auto* const intersect16 =
        real<decltype(rtcIntersect16)>("rtcIntersect16");
    inline static auto* const occluded16 = real<decltype(rtcOccluded16)>("rtcOccluded16");
};

template <class Rays, int width>
void load(Rays& r, const Bundle<width>& b) {
    std::memcpy(&r.org_x, b.org[0], sizeof b.org[0]);
    std::memcpy(&r.org_y, b.org[1], sizeof b.org[1]);
    std::memcpy(&r.org_z, b.org[2], sizeof b.org[2]);
    std::memcpy(&r.tnear, b.tnear, sizeof b.tnear);
    std::memcpy(&r.dir_x, b.dir[0], sizeof b.dir[0]);
    std::memcpy(&r.dir_y, b.dir[1], sizeof b.dir[1]);
    std::memcpy(&r.dir_z, b.dir[2], sizeof b.dir[2]);
    std::memcpy(&r.tfar, b.tfar, sizeof b.tfar);
    std::memset(&r.time, 0, sizeof r.time);
    std::memset(&r.mask, 0xff, sizeof r.mask);
    std::memset(&r.flags, 0, sizeof r.flags);
}

/// How many lanes met something: an occluded ray has its end moved to minus infinity.
template <int width>
std::int64_t count_hits(const float* tfar, const Bundle<width>& b) {
    std::int64_t hits = 0;
    for (int i = 0; i < width; ++i) {
        hits += b.valid[i] != 0 && tfar[i] < b.tfar[i] ? 1 : 0;
    }
    return hits;
}

template <class Hits, class Rays, int width>
std::int64_t trace(Tracer& tracer, const Bundle<width>& b, bool occlusion) {
    if (occlusion) {
        alignas(64) Rays rays;
        load(rays, b);
        tracer.trace(b.valid, rays);
        return count_hits(reinterpret_cast<const float*>(&rays.tfar), b);
    }
    alignas(64) Hits hits;
    load(hits.ray, b);
    std::memset(&hits.hit.geomID, 0xff, sizeof hits.hit.geomID);
    std::memset(&hits.hit.instID, 0xff, sizeof hits.hit.instID);
    tracer.trace(b.valid, hits);
    return count_hits(reinterpret_cast<const float*>(&hits.ray.tfar), b);
}

/// Seconds to trace all rays of a kind with so many threads; the best of `repeats`.
template <class Hits, class Rays, int width>
double replay(Kind kind, bool coherent, int threads, int repeats, std::int64_t* hits) {
    const auto packed = bundles<width>(kind);
    constexpr std::size_t share = 4096 / width;
    double best = 1e30;
    for (int repeat = 0; repeat < repeats; ++repeat) {
        std::atomic<std::size_t> next{0};
        std::atomic<std::int64_t> met{0};
        const auto work = [&] {
            Tracer tracer(recording().scene, coherent);
            std::int64_t own = 0;
            for (std::size_t i; (i = next.fetch_add(share)) < packed.size();) {
                const std::size_t end = std::min(i + share, packed.size());
                for (; i < end; ++i) {
                    own += trace<Hits, Rays>(tracer, packed[i], kind == shadow);
                }
            }
            met += own;
        };
        const auto start = std::chrono::steady_clock::now();
        std::vector<std::thread> others;
        for (int i = 1; i < threads; ++i) {
            others.emplace_back(work);
        }
        work();
        for (std::thread& other : others) {
            other.join();
        }
        const std::chrono::duration<double> spent =
            std::chrono::steady_clock::now() - start;
        best = std::min(best, spent.count());
        *hits = met;
    }
    return best;
}

}  // namespace

}  // namespace recorder

/// Seconds to trace the recorded rays of a kind again, `width` (1, 8 or 16) at a time.
extern "C" double recorder_replay(int kind, int width, int coherent, int threads,
                                  int repeats, std::int64_t* hits) {
    using namespace recorder;
    const auto k = static_cast<Kind>(kind);
    const bool c = coherent != 0;
    switch (width) {
        case 1:
            return replay<RTCRayHit, RTCRay, 1>(k, c, threads, repeats, hits);
        case 8:
            return replay<RTCRayHit8, RTCRay8, 8>(k, c, threads, repeats, hits);
        default:
            return replay<RTCRayHit16, RTCRay16, 16>(k, c, threads, repeats, hits);
    }
}
