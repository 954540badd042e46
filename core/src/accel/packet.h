#pragma once

#include <cstdint>

namespace raykiln {

/// N rays side by side and what they met, laid out as Embree's RTCRayHitN (accel.cpp
/// checks it). A lane takes part where `valid` is -1 and stays as it is where it is 0.
template <int N>
struct alignas(4 * N) RayPacket {
    float origin_x[N], origin_y[N], origin_z[N], t_near[N];
    float direction_x[N], direction_y[N], direction_z[N], time[N];
    float t_far[N];  ///< the distance of what was met; -infinity after `occluded` did
    std::uint32_t mask[N], id[N], flags[N];
    float normal_x[N], normal_y[N], normal_z[N];
    float u[N], v[N];
    std::uint32_t primitive[N], geometry[N], instance[N];
    std::uint32_t spare[N];  ///< Embree 4 may write one more index
    alignas(4 * N) std::int32_t valid[N];

    /// Sets what no lane differs in; `geometry` tells afterwards whether something was
    /// met.
    void prepare() {
        for (int i = 0; i < N; ++i) {
            time[i] = 0.0f;
            mask[i] = 0xffffffffu;
            id[i] = flags[i] = 0;
            geometry[i] = instance[i] = 0xffffffffu;
        }
    }
};

}  // namespace raykiln
