#include "render/learn_caustics.h"

#include <tbb/parallel_for.h>

#include <algorithm>

#include "integrator/photons.h"

namespace raykiln {

namespace {

/// A ray from a light for as many samples of the image, up to a limit; rays are followed
/// in blocks.
constexpr std::uint64_t samples_a_ray = 32;
constexpr std::uint64_t most_rays = 1 << 18;
constexpr std::uint64_t rays_a_block = 2048;

/// Calls `follow(block, ray)` for all rays, blocks at once.
template <class Follow>
void for_rays(std::size_t blocks, const Follow& follow) {
    tbb::parallel_for(std::size_t{0}, blocks, [&](std::size_t block) {
        for (std::size_t i = block * rays_a_block; i < (block + 1) * rays_a_block; ++i) {
            follow(block, i);
        }
    });
}

}  // namespace

CausticGuide learn_caustics(const Scene& scene, const Accel& accel,
                            const EstimatorSettings& estimator, std::uint32_t seed,
                            std::uint64_t samples) {
    // The shortest path by way of another surface has three segments.
    if (estimator.max_depth < 3) {
        return {};
    }
    const PhotonSource source(scene);
    if (source.empty()) {
        return {};
    }
    const std::uint64_t wanted = std::min(samples / samples_a_ray, most_rays);
    const std::size_t blocks = std::max<std::size_t>(wanted / rays_a_block, 1);
    const auto key = [&](std::uint32_t use, std::size_t i) {
        return SampleKey<float>{hash_combine(hash_bits(seed + 0x3c6ef372u), use),
                                static_cast<std::uint32_t>(i)};
    };
    std::vector<Emitted> rays(blocks * rays_a_block);
    for_rays(blocks,
             [&](std::size_t, std::size_t i) { rays[i] = source.emit(key(0, i)); });
    const std::vector<std::uint32_t> chosen = equal_in_power(rays);
    if (chosen.empty()) {
        return {};
    }
    // A list for each block: their order does not depend on the threads.
    std::vector<std::vector<Photon>> found(blocks);
    for_rays(blocks, [&](std::size_t block, std::size_t i) {
        RayCounts counts;
        const Context c{scene, accel, estimator, key(1, i), counts};
        trace_photon(c, rays[chosen[i]].ray, found[block]);
    });
    std::vector<Photon> photons;
    for (const auto& block : found) {
        photons.insert(photons.end(), block.begin(), block.end());
    }
    double density = 0;
    for (const std::uint32_t i : chosen) {
        density += rays[i].density;
    }
    const auto count = static_cast<float>(rays.size());
    return {std::move(photons), count / source.area(),
            static_cast<float>(density) / count};
}

}  // namespace raykiln
