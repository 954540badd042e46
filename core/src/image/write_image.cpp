#include "image/write_image.h"

#include <algorithm>
#include <cmath>

#include "error.h"
#include "image/limits.h"
#include "image/oiio_seam.h"

namespace raykiln {

namespace {

using Bytes = std::vector<unsigned char>;

// ITU-R BT.709 primaries and D65, as x, y pairs of red, green, blue and white.
constexpr float rec709_chromaticities[8] = {0.64f, 0.33f, 0.30f,   0.60f,
                                            0.15f, 0.06f, 0.3127f, 0.3290f};

[[noreturn]] void fail(const char* kind, const std::string& what) {
    throw ImageError(std::string("cannot encode the ") + kind + " image: " + what);
}

void check_size(const char* kind, int width, int height, std::size_t channels) {
    if (width < 1 || height < 1 || width > max_image_side || height > max_image_side ||
        std::int64_t{width} * height > max_image_pixels) {
        fail(kind, std::to_string(width) + " x " + std::to_string(height) +
                       " pixels are outside 1 to " + std::to_string(max_image_side) +
                       " a side and " + std::to_string(max_image_pixels) + " in all");
    }
    if (channels < 1 || channels > static_cast<std::size_t>(max_image_channels)) {
        fail(kind, std::to_string(channels) + " channels are outside 1 to " +
                       std::to_string(max_image_channels));
    }
}

void add_metadata(OIIO::ImageSpec& spec, const Metadata& metadata) {
    for (const auto& [name, value] : metadata) {
        if (const auto* text = std::get_if<std::string>(&value)) {
            spec.attribute(name, *text);
        } else if (const auto* whole = std::get_if<int>(&value)) {
            spec.attribute(name, *whole);
        } else {
            spec.attribute(name, OIIO::TypeDesc(OIIO::TypeDesc::DOUBLE),
                           std::get_if<double>(&value));
        }
    }
}

// Open a writer into memory, let `write` fill it, and hand over the bytes.
template <typename Write>
Bytes encode(const char* kind, const char* writer, const OIIO::ImageSpec& spec,
             Write write) {
    prepare_oiio();
    try {
        Bytes bytes;
        OIIO::Filesystem::IOVecOutput memory(bytes);
        auto out = OIIO::ImageOutput::create(writer);
        if (!out || !out->set_ioproxy(&memory)) {
            fail(kind, one_line(OIIO::geterror(), "no writer for it is installed"));
        }
        if (!out->open(std::string("memory.") + kind, spec) || !write(*out) ||
            !out->close()) {
            fail(kind, one_line(out->geterror(), "its writer failed"));
        }
        out.reset();
        return bytes;
    } catch (const ImageError&) {
        throw;
    } catch (const std::exception& e) {
        fail(kind, one_line(e.what(), "its writer failed"));
    }
}

OIIO::ImageSpec exr_spec(int width, int height, const std::vector<ExrChannel>& channels,
                         const Window& window, const Metadata& metadata) {
    const auto half = OIIO::TypeDesc(OIIO::TypeDesc::HALF);
    const auto full = OIIO::TypeDesc(OIIO::TypeDesc::FLOAT);
    OIIO::ImageSpec spec(width, height, static_cast<int>(channels.size()), full);
    spec.channelnames.clear();
    for (const ExrChannel& channel : channels) {
        spec.channelnames.push_back(channel.name);
        spec.channelformats.push_back(channel.half ? half : full);
    }
    spec.x = window.x;
    spec.y = window.y;
    spec.full_width = window.full_width ? window.full_width : width;
    spec.full_height = window.full_height ? window.full_height : height;
    add_metadata(spec, metadata);
    spec.attribute("compression", "zip");
    spec.attribute("chromaticities", OIIO::TypeDesc(OIIO::TypeDesc::FLOAT, 8),
                   rec709_chromaticities);
    // The writer adds the time of day unless it finds a DateTime; one of a type that
    // OpenEXR cannot hold for it is found, and then left out of the file.
    const float no_time[2] = {0, 0};
    spec.attribute("DateTime", OIIO::TypeDesc(OIIO::TypeDesc::FLOAT, 2), no_time);
    return spec;
}

float clamp_to_half(float value) {
    constexpr float largest_half = 65504.0f;
    return std::isfinite(value) ? std::clamp(value, -largest_half, largest_half) : value;
}

// Rows [y0, y1) of all channels, interleaved.
void gather_rows(const std::vector<ExrChannel>& channels, int width, int y0, int y1,
                 float* out) {
    const std::size_t n = channels.size();
    for (std::size_t c = 0; c < n; ++c) {
        const ExrChannel& channel = channels[c];
        float* to = out + c;
        for (int y = y0; y < y1; ++y) {
            const float* from = channel.values + y * channel.row_stride;
            for (int x = 0; x < width; ++x, to += n, from += channel.pixel_stride) {
                *to = channel.half ? clamp_to_half(*from) : *from;
            }
        }
    }
}

}  // namespace

std::vector<unsigned char> encode_exr(int width, int height,
                                      const std::vector<ExrChannel>& channels,
                                      const Window& window, const Metadata& metadata) {
    check_size("exr", width, height, channels.size());
    const auto spec = exr_spec(width, height, channels, window, metadata);
    // A multiple of the 16 rows that one ZIP block holds.
    constexpr int band = 64;
    std::vector<float> rows(static_cast<std::size_t>(width) * std::min(band, height) *
                            channels.size());
    return encode("exr", "openexr", spec, [&](OIIO::ImageOutput& out) {
        for (int y0 = 0; y0 < height; y0 += band) {
            const int y1 = std::min(y0 + band, height);
            gather_rows(channels, width, y0, y1, rows.data());
            if (!out.write_scanlines(spec.y + y0, spec.y + y1, 0, OIIO::TypeDesc::FLOAT,
                                     rows.data())) {
                return false;
            }
        }
        return true;
    });
}

std::vector<unsigned char> encode_png(const PngPixels& pixels, const Metadata& metadata) {
    check_size("png", pixels.width, pixels.height, pixels.channels);
    if (pixels.channels > 4 || pixels.format == PixelFormat::f32) {
        fail("png", "it holds 1 to 4 channels of 8 or 16 bits");
    }
    const OIIO::TypeDesc type = pixels.format == PixelFormat::u8
                                    ? OIIO::TypeDesc(OIIO::TypeDesc::UINT8)
                                    : OIIO::TypeDesc(OIIO::TypeDesc::UINT16);
    OIIO::ImageSpec spec(pixels.width, pixels.height, pixels.channels, type);
    if (pixels.channels <= 2) {
        spec.channelnames = {"Y"};
        spec.alpha_channel = -1;
        if (pixels.channels == 2) {
            spec.channelnames.emplace_back("A");
            spec.alpha_channel = 1;
        }
    }
    add_metadata(spec, metadata);
    spec.attribute("oiio:ColorSpace", "sRGB");
    spec.attribute("oiio:UnassociatedAlpha", 1);
    return encode("png", "png", spec, [&](OIIO::ImageOutput& out) {
        return out.write_image(type, pixels.values);
    });
}

}  // namespace raykiln
