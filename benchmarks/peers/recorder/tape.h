#pragma once

#include <cstdint>
#include <memory>
#include <vector>

#if __has_include(<embree4/rtcore.h>)
#include <embree4/rtcore.h>
#else
#include <embree3/rtcore.h>
#endif

// Every ray that a renderer gives to Embree, so that the same rays can be traced again
// with nothing around them. The library is preloaded into an unchanged renderer, whose
// calls of the shared libembree resolve here first.

namespace recorder {

/// What a ray is for. A camera ray begins in the camera's pinhole.
enum Kind : std::uint32_t { camera, bounce, shadow, kinds };

struct RecordedRay {
    float org[3], tnear, dir[3], tfar;
    std::uint32_t group;  ///< kinds * (segments of its path before it) + kind
};

/// The rays of one thread of the renderer, in its order.
struct Tape {
    std::vector<RecordedRay> rays;
    std::uint32_t depth = 0;
};

/// All tapes, and the scene that the rays were traced in (null: none were).
struct Recording {
    std::vector<std::unique_ptr<Tape>> tapes;
    RTCScene scene = nullptr;
};

const Recording& recording();

}  // namespace recorder
