#pragma once

#include <cstdint>
#include <memory>
#include <variant>

#include "image/pixel_format.h"
#include "math/vec.h"

namespace raykiln {

enum class TextureFilter : std::uint8_t { bilinear, nearest };
enum class TextureWrap : std::uint8_t { repeat, clamp, mirror };

/// (u, v) -> (a u + b v + c, d u + e v + f).
struct UvTransform {
    float a = 1, b = 0, c = 0, d = 0, e = 1, f = 0;
};

/// Pixels row by row from the top, 1 to 4 channels each; `owner` keeps them alive.
struct ImageTexture {
    const void* pixels = nullptr;
    std::shared_ptr<const void> owner;
    int width = 0, height = 0, channels = 0;
    PixelFormat format = PixelFormat::u8;
    bool srgb = false;  ///< u8 only: decode the colour channels with the sRGB curve
    TextureFilter filter = TextureFilter::bilinear;
    TextureWrap wrap_u = TextureWrap::repeat, wrap_v = TextureWrap::repeat;
    UvTransform uv_transform;

    std::size_t bytes() const {
        return static_cast<std::size_t>(width) * static_cast<std::size_t>(height) *
               static_cast<std::size_t>(channels) * value_bytes(format);
    }
};

/// 2 x 2 squares a unit of uv; color0 at (0.25, 0.25).
struct CheckerTexture {
    Vec3f color0, color1;
    UvTransform uv_transform;
};

// To add a kind: a struct here, its look-up in texture/texture.cpp, its binding in
// bind_scene.cpp, its field in raykiln/scene.py.
using Texture = std::variant<ImageTexture, CheckerTexture>;

enum class Channel : std::uint8_t { rgb, r, g, b, a };

constexpr std::int32_t no_texture = -1;

/// A colour parameter: factor, times a texture if there is one.
struct ColorSlot {
    Vec3f factor{1, 1, 1};
    std::int32_t texture = no_texture;
    Channel channel = Channel::rgb;
};

/// A number parameter: factor, times a texture if there is one.
struct FloatSlot {
    float factor = 1.0f;
    std::int32_t texture = no_texture;
    Channel channel = Channel::rgb;
};

}  // namespace raykiln
