#include "image/read_by_oiio.h"

#include <algorithm>
#include <limits>
#include <new>
#include <string_view>

#include "error.h"
#include "image/channels.h"
#include "image/file_kind.h"
#include "image/limits.h"
#include "image/message.h"
#include "image/oiio_seam.h"

namespace raykiln {

namespace {

using Input = OIIO::ImageInput::unique_ptr;

[[noreturn]] void fail(const FileKind& kind, const std::string& what) {
    fail_to_read(kind.title, what);
}

// A file for an OpenImageIO reader: in `proxy` if there is one, else under `name`.
struct File {
    FileKind kind;
    std::string name;
    std::size_t size;
    OIIO::Filesystem::IOProxy* proxy;
};

// Bit depths for which readers are known to write past their rows.
void check_samples(const File& file, const OIIO::ImageSpec& spec) {
    const int bits = spec.get_int_attribute("oiio:BitsPerSample", 8);
    if (file.kind.oiio_reader == std::string_view("tiff") && bits < 8 &&
        spec.nchannels > 1 &&
        spec.get_int_attribute("tiff:PhotometricInterpretation") == 5) {
        fail(file.kind, "CMYK of fewer than 8 bits");
    }
}

void check_claims(const File& file, const OIIO::ImageSpec& spec, const Image& image) {
    if (spec.depth > 1 || spec.deep || spec.nchannels > max_image_channels) {
        fail(file.kind, "it is deep, has several slices or more than " +
                            std::to_string(max_image_channels) + " channels");
    }
    check_image_size(
        spec.width, spec.height,
        static_cast<std::int64_t>(value_bytes(image.format)) * image.channels);
    check_tile_size(spec.tile_width, spec.tile_height, spec.width, spec.height,
                    spec.nchannels);
    check_samples(file, spec);
    // A WebP of one colour is denser than any bound.
    if (file.kind.oiio_reader != std::string_view("webp")) {
        check_plausible(image.size_bytes(), file.size);
    }
}

PixelFormat format_of(const OIIO::ImageSpec& spec) {
    if (spec.format == OIIO::TypeDesc::UINT8) {
        return PixelFormat::u8;
    }
    return spec.format == OIIO::TypeDesc::UINT16 ? PixelFormat::u16 : PixelFormat::f32;
}

OIIO::TypeDesc type_of(PixelFormat format) {
    switch (format) {
        case PixelFormat::u8:
            return OIIO::TypeDesc::UINT8;
        case PixelFormat::u16:
            return OIIO::TypeDesc::UINT16;
        case PixelFormat::f32:
            break;
    }
    return OIIO::TypeDesc::FLOAT;
}

std::vector<int> chosen_channels(const OIIO::ImageSpec& spec, ChannelChoice choice) {
    std::vector<int> chosen(spec.nchannels);
    for (int i = 0; i < spec.nchannels; ++i) {
        chosen[i] = i;
    }
    if (choice == ChannelChoice::all) {
        return chosen;
    }
    return require_colour_channels(spec.channelnames);
}

bool consecutive(const std::vector<int>& channels) {
    return std::ranges::adjacent_find(
               channels, [](int a, int b) { return b != a + 1; }) == channels.end();
}

// One read for neighbouring channels (the usual case), else one a channel.
bool read_pixels(OIIO::ImageInput& in, const std::vector<int>& channels, Image& image) {
    const auto type = type_of(image.format);
    if (consecutive(channels)) {
        return in.read_image(0, 0, channels.front(), channels.back() + 1, type,
                             image.pixels.get());
    }
    const auto value = static_cast<OIIO::stride_t>(value_bytes(image.format));
    for (std::size_t i = 0; i < channels.size(); ++i) {
        if (!in.read_image(0, 0, channels[i], channels[i] + 1, type,
                           image.pixels.get() + i * value, value * image.channels)) {
            return false;
        }
    }
    return true;
}

// Colour that the file or its reader has multiplied by alpha, divided again.
template <typename T>
void straighten(Image& image) {
    constexpr std::uint32_t full = std::numeric_limits<T>::max();
    auto* values = reinterpret_cast<T*>(image.pixels.get());
    const std::size_t n = static_cast<std::size_t>(image.channels);
    for (std::size_t i = 0; i < image.size_values(); i += n) {
        const std::uint64_t alpha = values[i + n - 1];
        for (std::size_t c = 0; alpha != 0 && alpha != full && c + 1 < n; ++c) {
            const std::uint64_t straight = (values[i + c] * full + alpha / 2) / alpha;
            values[i + c] = static_cast<T>(std::min<std::uint64_t>(straight, full));
        }
    }
}

// Not every reader heeds the wish for straight alpha; each says whether it did.
void straighten_alpha(const OIIO::ImageSpec& spec, const std::vector<int>& channels,
                      Image& image) {
    const bool has_alpha = channels.size() > 1 && channels.back() == spec.alpha_channel;
    if (!has_alpha || spec.get_int_attribute("oiio:UnassociatedAlpha") != 0) {
        return;
    }
    if (image.format == PixelFormat::u8) {
        straighten<std::uint8_t>(image);
    } else if (image.format == PixelFormat::u16) {
        straighten<std::uint16_t>(image);
    }
}

Metadata metadata_of(const OIIO::ImageSpec& spec) {
    Metadata metadata;
    for (const auto& p : spec.extra_attribs) {
        if (p.type() == OIIO::TypeString) {
            metadata.emplace_back(p.name().string(), p.get_string());
        } else if (p.type() == OIIO::TypeInt) {
            metadata.emplace_back(p.name().string(), p.get_int());
        } else if (p.type() == OIIO::TypeFloat) {
            metadata.emplace_back(p.name().string(), double{p.get_float()});
        } else if (p.type() == OIIO::TypeDesc(OIIO::TypeDesc::DOUBLE)) {
            metadata.emplace_back(p.name().string(),
                                  *static_cast<const double*>(p.data()));
        }
    }
    return metadata;
}

// The reader's complaint, without the file's name.
std::string complaint(OIIO::ImageInput& in, const std::string& name,
                      const char* fallback) {
    return one_line(without_name(in.geterror(), name), fallback);
}

Image image_of(OIIO::ImageInput& in, const File& file, ChannelChoice choice) {
    const OIIO::ImageSpec& spec = in.spec();
    const auto channels = chosen_channels(spec, choice);
    Image image;
    image.format = format_of(spec);
    image.width = spec.width;
    image.height = spec.height;
    image.channels = static_cast<int>(channels.size());
    check_claims(file, spec, image);
    for (int c : channels) {
        image.channel_names.push_back(spec.channelnames[c]);
    }
    if (choice == ChannelChoice::all) {
        image.window = {spec.x, spec.y, spec.full_width, spec.full_height};
        image.metadata = metadata_of(spec);
    }
    image.pixels = zeroed_pixels(image.size_bytes());
    if (!read_pixels(in, channels, image)) {
        fail(file.kind, complaint(in, file.name, "its pixels cannot be decoded"));
    }
    straighten_alpha(spec, channels, image);
    return image;
}

Image decode(const File& file, ChannelChoice choice) {
    prepare_oiio();
    try {
        Input in = OIIO::ImageInput::create(file.kind.oiio_reader);
        if (!in) {
            fail(file.kind, one_line(OIIO::geterror(), "no reader for it is installed"));
        }
        OIIO::ImageSpec config, spec;
        config.attribute("oiio:UnassociatedAlpha", 1);
        if (file.proxy && !in->set_ioproxy(file.proxy)) {
            fail(file.kind, "its reader cannot read from memory");
        }
        if (!in->open(file.name, spec, config)) {
            fail(file.kind, complaint(*in, file.name, "its header cannot be read"));
        }
        return image_of(*in, file, choice);
    } catch (const ImageError&) {
        throw;
    } catch (const std::bad_alloc&) {
        fail(file.kind, "not enough memory to decode it");
    } catch (const std::exception& e) {
        fail(file.kind, one_line(e.what(), "it cannot be decoded"));
    }
}

// Only what no decoder of our own takes.
FileKind left_to_oiio(const FileKind& kind) {
    if (kind.oiio_reader == nullptr) {
        throw ImageError(std::string("files of the kind ") + kind.title +
                         " are not left to OpenImageIO");
    }
    return kind;
}

}  // namespace

Image read_by_oiio(const std::filesystem::path& path, ChannelChoice choice) {
    const FileKind kind = left_to_oiio(kind_of_file(path));
    return decode({kind, path.string(), std::filesystem::file_size(path), nullptr},
                  choice);
}

Image read_by_oiio(std::span<const std::byte> file, ChannelChoice choice) {
    const FileKind kind = left_to_oiio(kind_of_file(file));
    OIIO::Filesystem::IOMemReader memory(file.data(), file.size());
    return decode({kind, "<memory>", file.size(), &memory}, choice);
}

}  // namespace raykiln
