#pragma once

#include <cstddef>
#include <span>

#include "image/image.h"

namespace raykiln {

/// Decode a Truevision Targa file: grey, grey with alpha, RGB (15, 16, 24 bits), RGBA or
/// colour-mapped, plain or run-length coded, any origin.  8 bits a channel, alpha
/// straight.
///
/// Written here because OpenImageIO's reader trusts palette indices and string lengths of
/// the file (CVE-2023-22845, CVE-2023-24473) in versions that distributions still ship.
/// Throws ImageError.
Image decode_targa(std::span<const std::byte> file);

}  // namespace raykiln
