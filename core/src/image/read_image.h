#pragma once

#include <cstddef>
#include <filesystem>
#include <span>

#include "image/image.h"

namespace raykiln {

/// Which channels to read: the colour (one to four, see `colour_channels`), or every one.
enum class ChannelChoice { colour, all };

/// Read the first image of a file, which is recognised by its first bytes, not by its
/// name, and must be of a kind that has a decoder here (`FileKind::decode`).
///
/// 8 and 16 bit integers stay what they are; every other type becomes f32.  Values and
/// orientation are as stored: no transfer function is undone; 8 and 16 bit colour is not
/// multiplied by alpha, that of OpenEXR is.  Palettes and CMYK become RGB.  Metadata and
/// window are filled for `ChannelChoice::all` only.  Throws ImageError, whose message
/// does not name the file.
Image read_image(const std::filesystem::path& path,
                 ChannelChoice choice = ChannelChoice::colour);
Image read_image(std::span<const std::byte> file,
                 ChannelChoice choice = ChannelChoice::colour);

}  // namespace raykiln
