#pragma once

#include <cstddef>
#include <span>

#include "scene/scene.h"

// Small kernels of shading, at the width of one instruction set or for float.

namespace raykiln::bench {

/// What the kernels read; arrays of `size` numbers, a multiple of 16.
struct ShadingInputs {
    static constexpr std::size_t size = 1024;

    const Scene* lights;  ///< with many lights
    std::uint32_t pixel[size], index[size];
    float out[3][size];    ///< unit directions above the surface
    float in[3][size];     ///< the same, others
    float u[3][size];      ///< in [0, 1)
    float point[3][size];  ///< within the scene

    explicit ShadingInputs(const Scene& scene);
};

/// Runs once over the inputs; the sum of the results, so that none is left out.
struct ShadingKernel {
    const char* name;
    float (*run)(const ShadingInputs& inputs);
};

}  // namespace raykiln::bench

extern "C" {
std::span<const raykiln::bench::ShadingKernel> raykiln_micro_float();
std::span<const raykiln::bench::ShadingKernel> raykiln_micro_sse42();
std::span<const raykiln::bench::ShadingKernel> raykiln_micro_avx2();
std::span<const raykiln::bench::ShadingKernel> raykiln_micro_avx512();
}
