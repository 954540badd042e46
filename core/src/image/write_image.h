#pragma once

#include <cstddef>
#include <string>
#include <vector>

#include "image/image.h"

namespace raykiln {

/// One channel of an OpenEXR file to be written.  `values` points at the top left value;
/// the strides count floats, so that channels may lie interleaved or apart.
struct ExrChannel {
    std::string name;
    const float* values = nullptr;
    std::ptrdiff_t pixel_stride = 1, row_stride = 0;
    bool half =
        false;  ///< store 16 bit floats; finite values beyond their range are clamped
};

/// An OpenEXR file: linear Rec.709, scanlines, ZIP compression.  The same input gives the
/// same bytes: no time or host is written.  Throws ImageError.
std::vector<unsigned char> encode_exr(int width, int height,
                                      const std::vector<ExrChannel>& channels,
                                      const Window& window, const Metadata& metadata);

/// Interleaved 8 or 16 bit values (1 to 4 channels: Y, YA, RGB, RGBA) to be written as
/// PNG.
struct PngPixels {
    int width = 0, height = 0, channels = 0;
    PixelFormat format = PixelFormat::u8;  ///< u8 or u16
    const void* values = nullptr;
};

/// A PNG file of display-encoded sRGB values with straight alpha; strings of `metadata`
/// become text chunks.  The same input gives the same bytes.  Throws ImageError.
std::vector<unsigned char> encode_png(const PngPixels& pixels, const Metadata& metadata);

}  // namespace raykiln
