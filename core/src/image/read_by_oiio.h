#pragma once

#include <cstddef>
#include <filesystem>
#include <span>

#include "image/image.h"
#include "image/read_image.h"

namespace raykiln {

/// `read_image` for the kinds of files that are left to OpenImageIO
/// (`FileKind::oiio_reader`).
Image read_by_oiio(const std::filesystem::path& path,
                   ChannelChoice choice = ChannelChoice::colour);
Image read_by_oiio(std::span<const std::byte> file,
                   ChannelChoice choice = ChannelChoice::colour);

}  // namespace raykiln
