#include "wide/dispatch.h"

namespace raykiln {

const WideKernels& wide_kernels([[maybe_unused]] Isa isa) {
#ifndef RAYKILN_BASELINE_ONLY
    if (isa == Isa::avx512) {
        return *raykiln_wide_avx512();
    }
    if (isa == Isa::avx2) {
        return *raykiln_wide_avx2();
    }
#endif
    return *raykiln_wide_sse42();
}

}  // namespace raykiln
