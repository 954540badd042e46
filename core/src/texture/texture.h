#pragma once

#include "scene/scene.h"

namespace raykiln {

/// Four channels at a texture coordinate; colours linear, alpha 1 where the image has
/// none.
template <class F>
struct TexelOf {
    Vec3<F> rgb;
    F alpha;
};
using Texel = TexelOf<float>;

Texel lookup(const Texture& texture, Vec2f uv);

/// Texels of all lanes, one after the other.
template <class F>
inline TexelOf<F> lookup(const Texture& texture, const Vec2<F>& uv) {
    TexelOf<F> texels;
    for (int i = 0; i < NumberTraits<F>::width; ++i) {
        const Texel t = lookup(texture, Vec2f{uv.x.lane(i), uv.y.lane(i)});
        texels.rgb.x.set_lane(i, t.rgb.x);
        texels.rgb.y.set_lane(i, t.rgb.y);
        texels.rgb.z.set_lane(i, t.rgb.z);
        texels.alpha.set_lane(i, t.alpha);
    }
    return texels;
}

/// The part of a texel that a parameter reads.
template <class F>
inline F pick(const TexelOf<F>& texel, Channel channel) {
    switch (channel) {
        case Channel::r:
            return texel.rgb.x;
        case Channel::g:
            return texel.rgb.y;
        case Channel::b:
            return texel.rgb.z;
        case Channel::a:
            return texel.alpha;
        case Channel::rgb:
            break;
    }
    return mean(texel.rgb);
}

/// Value of a parameter at a texture coordinate.
template <class F>
inline Vec3<F> evaluate(const ColorSlot& slot, const std::vector<Texture>& textures,
                        const Vec2<F>& uv) {
    const Vec3<F> factor{F(slot.factor.x), F(slot.factor.y), F(slot.factor.z)};
    if (slot.texture == no_texture) {
        return factor;
    }
    const auto texel = lookup(textures[static_cast<std::size_t>(slot.texture)], uv);
    return factor * (slot.channel == Channel::rgb ? texel.rgb
                                                  : Vec3<F>(pick(texel, slot.channel)));
}
template <class F>
inline F evaluate(const FloatSlot& slot, const std::vector<Texture>& textures,
                  const Vec2<F>& uv) {
    if (slot.texture == no_texture) {
        return F(slot.factor);
    }
    const auto texel = lookup(textures[static_cast<std::size_t>(slot.texture)], uv);
    return F(slot.factor) * pick(texel, slot.channel);
}

/// Mean of a parameter over its texture (an estimate, for choosing lights by their
/// power).
Vec3f average(const ColorSlot& slot, const std::vector<Texture>& textures);

}  // namespace raykiln
