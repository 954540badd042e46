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
/// One texel of an image, before its uv_transform and filter; x and y may lie beyond it.
Texel texel(const ImageTexture& image, int x, int y);

namespace detail {

/// A texel coordinate brought into an image of `size` texels.
template <class F>
inline Uint<F> wrapped(F i, int size, TextureWrap mode) {
    const F n(static_cast<float>(size));
    const F last(static_cast<float>(size - 1));
    if (mode == TextureWrap::repeat) {
        i = i - floor(i / n) * n;
    } else if (mode == TextureWrap::mirror) {
        const F period = n + n;
        i = i - floor(i / period) * period;
        i = select(i < n, i, period - F(1.0f) - i);
    }
    return to_uint(clamp(i, F(0.0f), last));
}

template <class F>
inline TexelOf<F> lookup_float_image(const ImageTexture& t, const Vec2<F>& uv) {
    const auto* pixels = static_cast<const float*>(t.pixels);
    const UvTransform& m = t.uv_transform;
    // Keeps texel coordinates in range whatever the uv.
    const auto bounded = [](F x) {
        return select(is_finite(x), clamp(x, F(-3e4f), F(3e4f)), F(0.0f));
    };
    const F u = bounded(F(m.a) * uv.x + F(m.b) * uv.y + F(m.c));
    const F v = bounded(F(m.d) * uv.x + F(m.e) * uv.y + F(m.f));
    const F x = u * F(static_cast<float>(t.width));
    const F y = v * F(static_cast<float>(t.height));
    const auto words = static_cast<std::uint32_t>(t.width * t.height * t.channels);
    const auto fetch = [&](F ix, F iy) -> TexelOf<F> {
        const Uint<F> at = (wrapped(iy, t.height, t.wrap_v) *
                                Uint<F>(static_cast<std::uint32_t>(t.width)) +
                            wrapped(ix, t.width, t.wrap_u)) *
                           Uint<F>(static_cast<std::uint32_t>(t.channels));
        if (t.channels == 4) {
            const auto four = gather4(pixels, at);
            return {{four[0], four[1], four[2]}, four[3]};
        }
        if (t.channels == 3 && words >= 4) {
            const auto three = gather3<F>(pixels, words, at);
            return {{three[0], three[1], three[2]}, F(1.0f)};
        }
        const F first = gather(pixels, at);
        if (t.channels <= 2) {
            return {Vec3<F>(first), t.channels == 2 ? gather(pixels + 1, at) : F(1.0f)};
        }
        return {{first, gather(pixels + 1, at), gather(pixels + 2, at)}, F(1.0f)};
    };
    if (t.filter == TextureFilter::nearest) {
        return fetch(floor(x), floor(y));
    }
    const auto mix = [](const TexelOf<F>& a, const TexelOf<F>& b, F s) -> TexelOf<F> {
        return {lerp(a.rgb, b.rgb, s), lerp(a.alpha, b.alpha, s)};
    };
    const F left = floor(x - F(0.5f)), top = floor(y - F(0.5f));
    const F fx = x - F(0.5f) - left, fy = y - F(0.5f) - top;
    const F right = left + F(1.0f), bottom = top + F(1.0f);
    return mix(mix(fetch(left, top), fetch(right, top), fx),
               mix(fetch(left, bottom), fetch(right, bottom), fx), fy);
}

}  // namespace detail

/// Texels of all lanes: of float images at once, of others one after the other.
template <class F>
inline TexelOf<F> lookup(const Texture& texture, const Vec2<F>& uv) {
    const auto* image = std::get_if<ImageTexture>(&texture);
    if (image != nullptr && image->format == PixelFormat::f32 &&
        std::int64_t{image->width} * image->height * image->channels < 1LL << 31) {
        return detail::lookup_float_image(*image, uv);
    }
    TexelOf<F> texels;
    for (int i = 0; i < NumberTraits<F>::width; ++i) {
        const Texel t = lookup(texture, Vec2f{uv.x.lane(i), uv.y.lane(i)});
        set_lane(texels.rgb, i, t.rgb);
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
