#include "image/limits.h"

#include <algorithm>
#include <string>

#include "error.h"
#include "image/message.h"

namespace raykiln {

static std::string times(std::int64_t a, std::int64_t b) {
    return std::to_string(a) + " x " + std::to_string(b);
}

void check_image_size(std::int64_t width, std::int64_t height,
                      std::int64_t bytes_per_pixel) {
    const std::string size = times(width, height);
    if (width < 1 || height < 1) {
        throw ImageError("not an image of at least 1 x 1 pixels (found " + size + ")");
    }
    if (width > max_image_side || height > max_image_side ||
        width * height > max_image_pixels) {
        throw ImageError("an image of " + size + " pixels is over the limit of " +
                         std::to_string(max_image_side) + " a side and " +
                         std::to_string(max_image_pixels) + " in all");
    }
    if (width * height * bytes_per_pixel > max_image_bytes) {
        throw ImageError(
            "an image of " + size + " pixels of " + std::to_string(bytes_per_pixel) +
            " bytes is over the limit of " + std::to_string(max_image_bytes) + " bytes");
    }
}

void check_size_to_write(const char* kind, int width, int height, std::size_t channels) {
    if (width < 1 || height < 1 || width > max_image_side || height > max_image_side ||
        std::int64_t{width} * height > max_image_pixels) {
        fail_to_write(kind, times(width, height) + " pixels are outside 1 to " +
                                std::to_string(max_image_side) + " a side and " +
                                std::to_string(max_image_pixels) + " in all");
    }
    if (channels < 1 || channels > static_cast<std::size_t>(max_image_channels)) {
        fail_to_write(kind, std::to_string(channels) + " channels are outside 1 to " +
                                std::to_string(max_image_channels));
    }
}

void check_tile_size(std::int64_t tile_width, std::int64_t tile_height,
                     std::int64_t width, std::int64_t height, std::int64_t channels) {
    constexpr std::int64_t always_allowed = 16 << 20;
    // Each side first, so that their product cannot overflow.
    const bool fits = tile_width <= max_image_pixels && tile_height <= max_image_pixels &&
                      tile_width * tile_height <= max_image_pixels &&
                      tile_width * tile_height * channels <=
                          std::max(always_allowed, 2 * width * height * channels);
    if (!fits) {
        throw ImageError("tiles of " + times(tile_width, tile_height) +
                         " pixels are too large for an image of " + times(width, height));
    }
}

void check_plausible(std::uint64_t image_bytes, std::uint64_t file_bytes) {
    constexpr std::uint64_t always_allowed = 16 << 20, densest = 1 << 16;
    if (image_bytes > always_allowed && image_bytes / densest > file_bytes) {
        throw ImageError("the file is damaged: its " + std::to_string(file_bytes) +
                         " bytes are too few for " + std::to_string(image_bytes) +
                         " bytes of pixels");
    }
}

}  // namespace raykiln
