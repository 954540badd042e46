#pragma once

#include <cstddef>
#include <filesystem>
#include <span>

#include "image/image.h"
#include "image/read_image.h"

namespace raykiln {

/// The first part of an OpenEXR file as f32, its channels in the order of `read_image`.
/// Throws ImageError for one that is damaged, deep, subsampled or over the limits.
Image read_exr(std::span<const std::byte> file, ChannelChoice choice);
Image read_exr(const std::filesystem::path& path, ChannelChoice choice);

}  // namespace raykiln
