#pragma once

#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <memory>
#include <new>
#include <span>
#include <string>
#include <utility>
#include <variant>
#include <vector>

#include "image/pixel_format.h"

namespace raykiln {

/// Named values beside the pixels: what a file says about itself.
using MetadataValue = std::variant<int, double, std::string>;
using Metadata = std::vector<std::pair<std::string, MetadataValue>>;

/// Where the stored pixels lie in the whole frame, in pixels; y points down.
/// A full size of 0 stands for "the stored pixels are the whole frame".
struct Window {
    int x = 0, y = 0;
    int full_width = 0, full_height = 0;
};

/// Memory of `std::calloc`.
struct FreeMemory {
    void operator()(std::byte* memory) const { std::free(memory); }
};
using PixelMemory = std::unique_ptr<std::byte[], FreeMemory>;

/// Memory for pixels.  Zero, because some decoders leave out what a short file lacks; of
/// `calloc`, which does not touch its pages, so that a decoder that fails early costs
/// nothing.
inline PixelMemory zeroed_pixels(std::size_t bytes) {
    auto* memory = static_cast<std::byte*>(std::calloc(bytes, 1));
    if (!memory) {
        throw std::bad_alloc();
    }
    return PixelMemory(memory);
}

/// A pixel buffer: rows from the top, interleaved channels, no padding.
/// Move-only, because it may be large.
struct Image {
    int width = 0, height = 0, channels = 0;
    PixelFormat format = PixelFormat::f32;
    PixelMemory pixels;
    std::vector<std::string> channel_names;
    Window window;
    Metadata metadata;

    std::size_t size_values() const {
        return static_cast<std::size_t>(width) * height * channels;
    }
    std::size_t size_bytes() const { return size_values() * value_bytes(format); }

    /// The values as `T`, which must be the type that `format` names.
    template <typename T>
    std::span<const T> values() const {
        return {reinterpret_cast<const T*>(pixels.get()), size_values()};
    }
};

}  // namespace raykiln
