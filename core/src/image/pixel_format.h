#pragma once

#include <cstddef>
#include <cstdint>

namespace raykiln {

/// How the values of an image are stored.
enum class PixelFormat : std::uint8_t { u8, u16, f32 };

/// Bytes of one value of `format`.
constexpr std::size_t value_bytes(PixelFormat format) {
    return format == PixelFormat::u8 ? 1 : format == PixelFormat::u16 ? 2 : 4;
}

}  // namespace raykiln
