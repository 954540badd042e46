#pragma once

#include <cstdint>

namespace raykiln {

/// What an image file may claim; checked before a byte is allocated for it.
inline constexpr int max_image_side = 65536;
inline constexpr std::int64_t max_image_pixels = std::int64_t{1} << 28;
inline constexpr std::int64_t max_image_bytes = std::int64_t{4} << 30;
inline constexpr int max_image_channels = 1024;

}  // namespace raykiln
