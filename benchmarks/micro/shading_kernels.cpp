#include "shading_kernels.h"

#include "bsdf/make_bsdf.h"
#include "light/sample_light.h"
#include "sampling/sampler.h"
#ifndef RAYKILN_MICRO_FLOAT
#include "math/wide.h"
#endif

// Compiled for each instruction set, and once for float, which is what the plain
// estimator runs.

namespace raykiln::bench {

namespace {

#ifdef RAYKILN_MICRO_FLOAT
using F = float;
#else
using F = Wide;
#endif
using U = Uint<F>;

constexpr std::size_t width = NumberTraits<F>::width;

Vec3<F> load3(const float (&planes)[3][ShadingInputs::size], std::size_t i) {
    return {load<F>(planes[0] + i), load<F>(planes[1] + i), load<F>(planes[2] + i)};
}

/// Adds what `step` makes of each run of lanes.
template <class Step>
float sum_over(const ShadingInputs& inputs, const Step& step) {
    F sum(0.0f);
    for (std::size_t i = 0; i < ShadingInputs::size; i += width) {
        const F x = step(inputs, i);
        sum = sum + select(is_finite(x), x, F(0.0f));
    }
    float lanes[width], total = 0;
    store(lanes, sum);
    for (const float lane : lanes) {
        total += lane;
    }
    return total;
}

template <SamplerKind kind>
float draw(const ShadingInputs& inputs) {
    return sum_over(inputs, [](const ShadingInputs& at, std::size_t i) {
        const SampleKey<F> key{load<U>(at.pixel + i), load<U>(at.index + i)};
        const Sample4<F> u = sample_4d(kind, key, 3);
        return (u[0] + u[1]) + (u[2] + u[3]);
    });
}

float warp(const ShadingInputs& inputs) {
    return sum_over(inputs, [](const ShadingInputs& at, std::size_t i) {
        const Vec3<F> v =
            sample_cosine_hemisphere(load<F>(at.u[0] + i), load<F>(at.u[1] + i));
        return v.x + v.y + v.z;
    });
}

// The materials, with numbers that no lane shares with a constant.

template <class MaterialType>
auto bsdf_of(const MaterialType& material) {
    static const std::vector<Texture> none;
    return make_bsdf(material, detail::Parameters<F>{none, {F(0.0f), F(0.0f)}});
}

struct DiffuseCase {
    static DiffuseMaterial make() { return {ColorSlot{{0.8f, 0.5f, 0.3f}}}; }
};
struct RoughConductorCase {
    static ConductorMaterial make() {
        return {{0.2f, 0.9f, 1.1f}, {3.9f, 2.4f, 2.2f}, {}, {{0.3f}, {0.2f}, false}};
    }
};
struct BeckmannConductorCase {
    static ConductorMaterial make() {
        return {{0.2f, 0.9f, 1.1f}, {3.9f, 2.4f, 2.2f}, {}, {{0.3f}, {0.2f}, true}};
    }
};
struct SmoothDielectricCase {
    static DielectricMaterial make() { return {1.5f, {}, {}, {}, false}; }
};
struct RoughDielectricCase {
    static DielectricMaterial make() {
        return {1.5f, {}, {}, {{0.2f}, {0.2f}, false}, false};
    }
};
struct PrincipledCase {
    static PrincipledMaterial make() {
        return {ColorSlot{{0.8f, 0.5f, 0.3f}}, {}, {0.3f}, {0.4f}, {1.0f}, {0.0f}, 1.5f};
    }
};

template <class Case>
float sample_bsdf(const ShadingInputs& inputs) {
    const auto material = Case::make();
    const auto bsdf = bsdf_of(material);
    return sum_over(inputs, [&](const ShadingInputs& at, std::size_t i) {
        const Vec3<F> u = load3(at.u, i);
        const BsdfSample<F> s = sample(bsdf, load3(at.out, i), {u.x, u.y, u.z});
        return s.dir_in.x + s.weight.x + s.weight.y + s.weight.z;
    });
}
template <class Case>
float evaluate_bsdf(const ShadingInputs& inputs) {
    const auto material = Case::make();
    const auto bsdf = bsdf_of(material);
    return sum_over(inputs, [&](const ShadingInputs& at, std::size_t i) {
        const BsdfValue<F> v = evaluate(bsdf, load3(at.out, i), load3(at.in, i));
        return v.value.x + v.value.y + v.value.z + v.pdf_solid_angle;
    });
}

float pick_light(const ShadingInputs& inputs) {
    return sum_over(inputs, [](const ShadingInputs& at, std::size_t i) {
        const LightReceiverOf<F> receiver{load3(at.point, i), load3(at.out, i)};
        return choose_light(*at.lights, receiver, load<F>(at.u[0] + i)).pmf;
    });
}

constexpr ShadingKernel kernels[] = {
    {"sampler/sobol", draw<SamplerKind::sobol>},
    {"sampler/independent", draw<SamplerKind::independent>},
    {"warp/cosine", warp},
    {"sample/diffuse", sample_bsdf<DiffuseCase>},
    {"sample/conductor", sample_bsdf<RoughConductorCase>},
    {"sample/conductor_beckmann", sample_bsdf<BeckmannConductorCase>},
    {"sample/dielectric_smooth", sample_bsdf<SmoothDielectricCase>},
    {"sample/dielectric", sample_bsdf<RoughDielectricCase>},
    {"sample/principled", sample_bsdf<PrincipledCase>},
    {"evaluate/diffuse", evaluate_bsdf<DiffuseCase>},
    {"evaluate/conductor", evaluate_bsdf<RoughConductorCase>},
    {"evaluate/dielectric", evaluate_bsdf<RoughDielectricCase>},
    {"evaluate/principled", evaluate_bsdf<PrincipledCase>},
    {"light/choose_of_1000", pick_light},
};

}  // namespace

}  // namespace raykiln::bench

extern "C" std::span<const raykiln::bench::ShadingKernel> RAYKILN_WIDE_ENTRY() {
    return raykiln::bench::kernels;
}
