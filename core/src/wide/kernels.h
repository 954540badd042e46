#pragma once

#include <cstddef>
#include <cstdint>

// What the wide part of the core offers, once for each instruction set. Its sources (all
// of this folder but dispatch.cpp) are compiled for each of them, and all but the entry
// point is local to the result: see core/cmake/wide.cmake.
//
// Code of one instruction set must not run where another was chosen. So no dynamic
// initialisation of globals here: it would run before the choice.

namespace raykiln {

struct WideKernels {
    std::size_t width;  ///< lanes
    const char* isa;    ///< as `isa_name` gives it

    /// Four dimensions of `count` samples, as `sobol_sample` makes them one by one: of
    /// sample i at out[4 i].
    void (*sobol_samples)(const std::uint32_t* pixel, const std::uint32_t* index,
                          std::size_t count, std::uint32_t group, float* out);
};

}  // namespace raykiln

extern "C" {
const raykiln::WideKernels* raykiln_wide_sse42();
const raykiln::WideKernels* raykiln_wide_avx2();
const raykiln::WideKernels* raykiln_wide_avx512();
}
