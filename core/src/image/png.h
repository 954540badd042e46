#pragma once

#include <cstddef>
#include <span>

#include "image/image.h"
#include "image/read_image.h"

namespace raykiln {

/// A PNG file as 8 or 16 bits: Y, YA, RGB or RGBA, with palettes and transparent colours
/// resolved.  Its text chunks are the metadata.  Throws ImageError.
Image read_png(std::span<const std::byte> file, ChannelChoice choice);

}  // namespace raykiln
