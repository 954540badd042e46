#pragma once

#include <cstddef>

#include "light/light.h"
#include "math/gather.h"
#include "texture/texture.h"

// What the samplers of all kinds of light share.

namespace raykiln {

template <class F>
inline LightSampleOf<F> select(Mask<F> mask, const LightSampleOf<F>& a,
                               const LightSampleOf<F>& b) {
    return {select(mask, a.direction, b.direction),
            select(mask, a.point, b.point),
            select(mask, a.infinite, b.infinite),
            select(mask, a.radiance, b.radiance),
            select(mask, a.pdf_solid_angle, b.pdf_solid_angle),
            select(mask, a.delta, b.delta)};
}

/// No light: radiance and density 0.
template <class F>
inline LightSampleOf<F> no_light_sample() {
    const Vec3<F> zero(F(0.0f));
    return {
        {F(0.0f), F(0.0f), F(1.0f)}, zero, Mask<F>(false), zero, F(0.0f), Mask<F>(false)};
}

/// Radiance of a surface emission at a texture coordinate; `front`: seen from its
/// normal's side.
template <class F>
inline Vec3<F> emitted_radiance(const Scene& scene, Uint<F> emission, const Vec2<F>& uv,
                                Mask<F> front) {
    if constexpr (std::is_same_v<F, float>) {
        const Emission& e = scene.emissions[emission];
        return front || e.two_sided != 0 ? evaluate(e.radiance, scene.textures, uv)
                                         : Vec3f(0.0f);
    } else {
        using U = Uint<F>;
        const Emission* table = scene.emissions.data();
        static_assert(offsetof(Emission, radiance.texture) == 3 * sizeof(float));
        const auto row = gather_row<F, 4>(table, emission);
        const auto seen =
            front | (gather_member<F>(table, &Emission::two_sided, emission) != U(0u));
        Vec3<F> radiance{row[0], row[1], row[2]};
        // A few textures at most: each in turn, for the lanes that have it.
        auto left = seen & (as_uint(row[3]) != U(static_cast<std::uint32_t>(no_texture)));
        while (any(left)) {
            const std::uint32_t index = emission.lane(std::countr_zero(bits(left)));
            const auto same = left & (emission == U(index));
            radiance = select(same, evaluate(table[index].radiance, scene.textures, uv),
                              radiance);
            left = left & !same;
        }
        return select(seen, radiance, Vec3<F>(F(0.0f)));
    }
}

}  // namespace raykiln
