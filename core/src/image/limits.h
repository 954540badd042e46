#pragma once

#include <cstddef>
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

/// The same for an image to be written as `kind`, with 1 to `max_image_channels`
/// channels.
void check_size_to_write(const char* kind, int width, int height, std::size_t channels);

/// Throws ImageError unless tiles of `tile_width` x `tile_height` pixels suit such an
/// image: a decoder allocates whole tiles, which a hostile file makes far larger than it.
void check_tile_size(std::int64_t tile_width, std::int64_t tile_height,
                     std::int64_t width, std::int64_t height, std::int64_t channels);

/// Throws ImageError if no accepted coding could hold `image_bytes` of pixels in
/// `file_bytes`: a broken or hostile header, which would cost memory and time to
/// disprove.
void check_plausible(std::uint64_t image_bytes, std::uint64_t file_bytes);

}  // namespace raykiln
