#include <benchmark/benchmark.h>

#include <string>

#include "isa/isa.h"
#include "render/film.h"
#include "scenes.h"
#include "shading_kernels.h"

// Shading, sampling and the film; items are lanes, or samples.

namespace raykiln::bench {

namespace {

using benchmark::State;

const ShadingInputs& inputs() {
    static const View view = many_lights(1000);
    static const ShadingInputs made(view.scene);
    return made;
}

void add(const std::string& isa, std::span<const ShadingKernel> kernels) {
    for (const ShadingKernel& kernel : kernels) {
        benchmark::RegisterBenchmark(
            (std::string(kernel.name) + "/" + isa).c_str(), [kernel](State& state) {
                const ShadingInputs& in = inputs();
                for ([[maybe_unused]] auto _ : state) {
                    benchmark::DoNotOptimize(kernel.run(in));
                }
                state.SetItemsProcessed(state.iterations() *
                                        static_cast<std::int64_t>(ShadingInputs::size));
            });
    }
}

void film(State& state) {
    Film film(256, 256, {});
    std::uint32_t count = 0;
    std::uint64_t nonfinite = 0;
    const Vec3f sample{0.5f, 0.25f, 0.125f};
    for ([[maybe_unused]] auto _ : state) {
        ++count;
        for (int y = 0; y < 256; ++y) {
            for (int x = 0; x < 256; ++x) {
                PixelSums sums;
                sums.add_radiance(sample, nonfinite);
                film.add(x, y, sums, count);
            }
        }
    }
    benchmark::DoNotOptimize(film.radiance().data());
    state.SetItemsProcessed(state.iterations() * 256 * 256);
}

[[maybe_unused]] const bool registered = [] {
    add("float", raykiln_micro_float());
    add("sse4.2", raykiln_micro_sse42());
    if (can_run(Isa::avx2)) {
        add("avx2", raykiln_micro_avx2());
    }
    if (can_run(Isa::avx512)) {
        add("avx512", raykiln_micro_avx512());
    }
    benchmark::RegisterBenchmark("film/add", film);
    return true;
}();

}  // namespace

}  // namespace raykiln::bench
