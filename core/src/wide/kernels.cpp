#include "wide/kernels.h"

#include "math/wide.h"
#include "sampling/sampler.h"
#include "wide/path_tracer.h"

namespace raykiln {

namespace {

constexpr std::size_t width = NumberTraits<Wide>::width;

void sobol_samples(const std::uint32_t* pixel, const std::uint32_t* index,
                   std::size_t count, std::uint32_t group, float* out) {
    for (std::size_t begin = 0; begin < count; begin += width) {
        const auto lanes =
            static_cast<int>(count - begin < width ? count - begin : width);
        const WideMask used = WideMask::first(lanes);
        const WideUint lane = iota<WideUint>();
        const SampleKey<Wide> key{gather(used, pixel + begin, lane, lane),
                                  gather(used, index + begin, lane, lane)};
        const Sample4<Wide> x = sobol_sample(key, group);
        for (std::uint32_t d = 0; d < 4; ++d) {
            scatter(used, out + 4 * begin, lane * WideUint(4u) + WideUint(d), x[d]);
        }
    }
}

}  // namespace

}  // namespace raykiln

extern "C" const raykiln::WideKernels* RAYKILN_WIDE_ENTRY() {
    using namespace raykiln;
    static constexpr WideKernels kernels{width, WideIsa::name, sobol_samples,
                                         make_path_tracer};
    return &kernels;
}
