#include "../../tests/core/statistics.h"
#include "sampling/warp.h"
#include "shading_kernels.h"

namespace raykiln::bench {

ShadingInputs::ShadingInputs(const Scene& scene) : lights(&scene) {
    test::Rng rng(1);
    const auto put = [](float (&planes)[3][size], std::size_t i, const Vec3f& v) {
        planes[0][i] = v.x, planes[1][i] = v.y, planes[2][i] = v.z;
    };
    for (std::size_t i = 0; i < size; ++i) {
        pixel[i] = static_cast<std::uint32_t>(rng.bits());
        index[i] = rng.below(256);
        put(out, i, sample_cosine_hemisphere(rng.unit(), rng.unit()));
        put(in, i, sample_cosine_hemisphere(rng.unit(), rng.unit()));
        put(u, i, {rng.unit(), rng.unit(), rng.unit()});
        put(point, i, {rng.between(-1, 1), rng.between(-1, 1), rng.between(-1, 1)});
    }
}

}  // namespace raykiln::bench
