#pragma once

#include <cstdint>

namespace raykiln {

/// What an image file may claim; checked before a byte is allocated for it.
inline constexpr int max_image_side = 65536;
inline constexpr std::int64_t max_image_pixels = std::int64_t{1} << 28;
inline constexpr std::int64_t max_image_bytes = std::int64_t{4} << 30;
inline constexpr int max_image_channels = 1024;

/// Throws ImageError unless a flat image of `width` x `height` pixels is within the
/// limits.
void check_image_size(std::int64_t width, std::int64_t height,
                      std::int64_t bytes_per_pixel);

/// Throws ImageError if no accepted coding could hold `image_bytes` of pixels in
/// `file_bytes`: a broken or hostile header, which would cost memory and time to
/// disprove.
void check_plausible(std::uint64_t image_bytes, std::uint64_t file_bytes);

}  // namespace raykiln
