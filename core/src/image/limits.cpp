#include "image/limits.h"

#include <string>

#include "error.h"

namespace raykiln {

void check_image_size(std::int64_t width, std::int64_t height,
                      std::int64_t bytes_per_pixel) {
    const std::string size = std::to_string(width) + " x " + std::to_string(height);
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

void check_plausible(std::uint64_t image_bytes, std::uint64_t file_bytes) {
    constexpr std::uint64_t always_allowed = 16 << 20, densest = 1 << 16;
    if (image_bytes > always_allowed && image_bytes / densest > file_bytes) {
        throw ImageError("the file is damaged: its " + std::to_string(file_bytes) +
                         " bytes are too few for " + std::to_string(image_bytes) +
                         " bytes of pixels");
    }
}

}  // namespace raykiln
