#include "render/learn_caustics.h"

#include <tbb/parallel_for.h>

#include <algorithm>

#include "integrator/photons.h"

namespace raykiln {

namespace {

/// Rays from the lights, one for as many samples of the image, up to a limit; and the
/// share of them that is followed, in blocks.
constexpr std::uint64_t samples_a_ray = 32;
constexpr std::uint64_t most_rays = 1 << 19;
constexpr std::size_t rays_a_followed = 2;
constexpr std::size_t block_size = 2048;

std::size_t blocks_of(std::size_t count) {
    return (count + block_size - 1) / block_size;
}

/// Calls `take(block, begin, end)` for blocks of the numbers below `count`, several at
/// once.
template <class Take>
void for_blocks(std::size_t count, const Take& take) {
    tbb::parallel_for(std::size_t{0}, blocks_of(count), [&](std::size_t block) {
        const std::size_t begin = block * block_size;
        take(block, begin, std::min(begin + block_size, count));
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
    const auto seed_of = [&](std::uint32_t use) {
        return hash_combine(hash_bits(seed + 0x3c6ef372u), use);
    };
    const std::uint64_t wanted = std::min(samples / samples_a_ray, most_rays);
    std::vector<Emitted> rays(std::max<std::uint64_t>(wanted, block_size));
    for_blocks(rays.size(), [&](std::size_t, std::size_t begin, std::size_t end) {
        source.emit(seed_of(0), begin, rays.size(), {&rays[begin], end - begin});
    });
    const auto followed = equal_in_power(rays, rays.size() / rays_a_followed);
    // A list for each block: their order does not depend on the threads.
    std::vector<std::vector<Photon>> found(blocks_of(followed.size()));
    for_blocks(
        followed.size(), [&](std::size_t block, std::size_t begin, std::size_t end) {
            for (std::size_t i = begin; i < end; ++i) {
                RayCounts counts;
                const SampleKey<float> key{seed_of(1), static_cast<std::uint32_t>(i)};
                const Context c{scene, accel, estimator, key, counts};
                trace_photon(c, rays[followed[i]].ray, found[block]);
            }
        });
    std::vector<Photon> photons;
    for (const auto& block : found) {
        photons.insert(photons.end(), block.begin(), block.end());
    }
    if (photons.empty()) {
        return {};
    }
    double density = 0;
    for (const std::uint32_t i : followed) {
        density += rays[i].density;
    }
    const auto count = static_cast<float>(followed.size());
    return {std::move(photons), count / source.area(),
            static_cast<float>(density) / count};
}

}  // namespace raykiln
