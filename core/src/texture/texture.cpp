#include "texture/texture.h"

#include <algorithm>
#include <array>
#include <cmath>

namespace raykiln {

namespace {

/// sRGB decoding (IEC 61966-2-1) of the 256 8-bit codes, for speed.
const std::array<float, 256>& srgb_table() {
    static const std::array<float, 256> table = [] {
        std::array<float, 256> t{};
        for (std::size_t i = 0; i < t.size(); ++i) {
            const double x = static_cast<double>(i) / 255.0;
            t[i] = static_cast<float>(x <= 0.04045 ? x / 12.92
                                                   : std::pow((x + 0.055) / 1.055, 2.4));
        }
        return t;
    }();
    return table;
}

float channel_value(const ImageTexture& t, std::size_t pixel, int channel) {
    const std::size_t i =
        pixel * static_cast<std::size_t>(t.channels) + static_cast<std::size_t>(channel);
    const bool color = t.channels >= 3 ? channel < 3 : channel == 0;
    switch (t.format) {
        case PixelFormat::u8: {
            const auto code = static_cast<const std::uint8_t*>(t.pixels)[i];
            return t.srgb && color ? srgb_table()[code]
                                   : static_cast<float>(code) * (1.0f / 255.0f);
        }
        case PixelFormat::u16:
            return static_cast<float>(static_cast<const std::uint16_t*>(t.pixels)[i]) *
                   (1.0f / 65535.0f);
        case PixelFormat::f32:
            break;
    }
    return static_cast<const float*>(t.pixels)[i];
}

int wrapped(int i, int size, TextureWrap mode) {
    if (i >= 0 && i < size) {
        return i;
    }
    switch (mode) {
        case TextureWrap::clamp:
            return i < 0 ? 0 : size - 1;
        case TextureWrap::mirror: {
            const int period = 2 * size;
            const int j = ((i % period) + period) % period;
            return j < size ? j : period - 1 - j;
        }
        case TextureWrap::repeat:
            break;
    }
    return ((i % size) + size) % size;
}

}  // namespace

Texel texel(const ImageTexture& t, int x, int y) {
    const std::size_t pixel = static_cast<std::size_t>(wrapped(y, t.height, t.wrap_v)) *
                                  static_cast<std::size_t>(t.width) +
                              static_cast<std::size_t>(wrapped(x, t.width, t.wrap_u));
    const float first = channel_value(t, pixel, 0);
    if (t.channels <= 2) {
        return {Vec3f(first), t.channels == 2 ? channel_value(t, pixel, 1) : 1.0f};
    }
    return {{first, channel_value(t, pixel, 1), channel_value(t, pixel, 2)},
            t.channels == 4 ? channel_value(t, pixel, 3) : 1.0f};
}

namespace {

Texel mix(const Texel& a, const Texel& b, float t) {
    return {lerp(a.rgb, b.rgb, t), lerp(a.alpha, b.alpha, t)};
}

Vec2f transformed(const UvTransform& m, Vec2f uv) {
    return {m.a * uv.x + m.b * uv.y + m.c, m.d * uv.x + m.e * uv.y + m.f};
}

/// Keeps texel coordinates in the range of int whatever the uv (images are at most 32768
/// wide).
float bounded(float x) {
    return std::isfinite(x) ? clamp(x, -3e4f, 3e4f) : 0.0f;
}

Texel lookup_image(const ImageTexture& t, Vec2f uv) {
    const Vec2f at = transformed(t.uv_transform, uv);
    const float x = bounded(at.x) * static_cast<float>(t.width);
    const float y = bounded(at.y) * static_cast<float>(t.height);
    if (t.filter == TextureFilter::nearest) {
        return texel(t, static_cast<int>(floor(x)), static_cast<int>(floor(y)));
    }
    const float left = floor(x - 0.5f), top = floor(y - 0.5f);
    const int ix = static_cast<int>(left), iy = static_cast<int>(top);
    const float fx = x - 0.5f - left, fy = y - 0.5f - top;
    return mix(mix(texel(t, ix, iy), texel(t, ix + 1, iy), fx),
               mix(texel(t, ix, iy + 1), texel(t, ix + 1, iy + 1), fx), fy);
}

Texel lookup_checker(const CheckerTexture& t, Vec2f uv) {
    const Vec2f at = transformed(t.uv_transform, uv);
    const bool right = at.x - floor(at.x) > 0.5f;
    const bool lower = at.y - floor(at.y) > 0.5f;
    return {right == lower ? t.color0 : t.color1, 1.0f};
}

}  // namespace

Texel lookup(const Texture& texture, Vec2f uv) {
    if (const auto* image = std::get_if<ImageTexture>(&texture)) {
        return lookup_image(*image, uv);
    }
    return lookup_checker(std::get<CheckerTexture>(texture), uv);
}

Vec3f average(const ColorSlot& slot, const std::vector<Texture>& textures) {
    if (slot.texture == no_texture) {
        return slot.factor;
    }
    // Small images texel by texel, large ones finely enough to find what is lit of them.
    int across = 16;
    if (const auto* image = std::get_if<ImageTexture>(
            &textures[static_cast<std::size_t>(slot.texture)])) {
        across = std::clamp(std::max(image->width, image->height), 16, 256);
    }
    const auto n = static_cast<float>(across);
    Vec3f sum;
    for (int y = 0; y < across; ++y) {
        Vec3f row;
        for (int x = 0; x < across; ++x) {
            const Vec2f uv{(static_cast<float>(x) + 0.5f) / n,
                           (static_cast<float>(y) + 0.5f) / n};
            row += evaluate(slot, textures, uv);
        }
        sum += row;
    }
    return sum / (n * n);
}

}  // namespace raykiln
