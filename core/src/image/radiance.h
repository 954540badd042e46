#pragma once

#include <cstddef>
#include <span>

#include "image/image.h"

namespace raykiln {

/// A Radiance picture (RGBE, run-length coded in the new or the old way, or plain) as f32
/// RGB.  Rows and columns are as stored, and no exposure is undone.  Throws ImageError.
Image decode_radiance(std::span<const std::byte> file);

}  // namespace raykiln
