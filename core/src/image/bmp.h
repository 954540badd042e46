#pragma once

#include <cstddef>
#include <span>

#include "image/image.h"

namespace raykiln {

/// Decode a Windows bitmap: 1, 4 or 8 bits with a palette, 16, 24 or 32 bits, with bit
/// fields or without; RGB, or RGBA (straight) where the file has a mask for alpha.
/// Run-length coded bitmaps are refused.
///
/// Written here because OpenImageIO's reader writes past its rows for some hostile files
/// in versions that distributions still ship.  Throws ImageError.
Image decode_bmp(std::span<const std::byte> file);

}  // namespace raykiln
