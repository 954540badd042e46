#pragma once

#include <algorithm>

#include "rays.h"

// Tracing recorded rays, one by one and in packets. Each returns how many met something.

namespace raykiln::bench {

inline std::size_t trace_single(const Accel& accel, const std::vector<Ray>& rays) {
    std::size_t met = 0;
    for (const Ray& ray : rays) {
        met += accel.intersect(ray).valid();
    }
    return met;
}
inline std::size_t occlude_single(const Accel& accel, const std::vector<Ray>& rays) {
    std::size_t met = 0;
    for (const Ray& ray : rays) {
        met += accel.occluded(ray);
    }
    return met;
}

template <int N>
void fill_packet(RayPacket<N>& p, const std::vector<Ray>& rays, std::size_t begin) {
    p.prepare();
    for (std::size_t i = 0; i < N; ++i) {
        const Ray& ray = rays[std::min(begin + i, rays.size() - 1)];
        p.origin_x[i] = ray.origin.x, p.origin_y[i] = ray.origin.y;
        p.origin_z[i] = ray.origin.z, p.t_near[i] = ray.t_near;
        p.direction_x[i] = ray.direction.x, p.direction_y[i] = ray.direction.y;
        p.direction_z[i] = ray.direction.z, p.t_far[i] = ray.t_far;
        p.valid[i] = begin + i < rays.size() ? -1 : 0;
    }
}

/// The packets are filled beforehand: what is measured is tracing, as of a batch that
/// lies ready in memory.
template <int N>
std::vector<RayPacket<N>> make_packets(const std::vector<Ray>& rays) {
    std::vector<RayPacket<N>> packets((rays.size() + N - 1) / N);
    for (std::size_t i = 0; i < packets.size(); ++i) {
        fill_packet(packets[i], rays, i * N);
    }
    return packets;
}

template <int N>
std::size_t trace_packets(const Accel& accel, const std::vector<RayPacket<N>>& packets,
                          bool coherent) {
    std::size_t met = 0;
    for (const RayPacket<N>& ready : packets) {
        RayPacket<N> p = ready;
        accel.intersect(p, coherent);
        for (int i = 0; i < N; ++i) {
            met += p.geometry[i] != no_index;
        }
    }
    return met;
}
template <int N>
std::size_t occlude_packets(const Accel& accel,
                            const std::vector<RayPacket<N>>& packets) {
    std::size_t met = 0;
    for (const RayPacket<N>& ready : packets) {
        RayPacket<N> p = ready;
        accel.occluded(p);
        for (int i = 0; i < N; ++i) {
            met += p.t_far[i] < 0.0f;
        }
    }
    return met;
}

}  // namespace raykiln::bench
