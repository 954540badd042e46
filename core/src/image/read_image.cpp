#include "image/read_image.h"

#include <algorithm>
#include <array>
#include <fstream>
#include <functional>
#include <new>

#include "error.h"
#include "image/channels.h"
#include "image/file_kind.h"
#include "image/limits.h"
#include "image/oiio_seam.h"

namespace raykiln {

namespace {

using Input = OIIO::ImageInput::unique_ptr;

[[noreturn]] void fail(const FileKind& kind, const std::string& what) {
    throw ImageError(std::string("damaged or unsupported ") + kind.title +
                     " image: " + what);
}

FileKind kind_of(std::span<const std::byte> head) {
    if (head.empty()) {
        throw ImageError(std::string("the file is empty; accepted: ") +
                         accepted_file_kinds());
    }
    const auto kind = file_kind(head);
    if (!kind) {
        throw ImageError(std::string("not an image of an accepted kind; accepted: ") +
                         accepted_file_kinds());
    }
    return *kind;
}

std::string times(std::int64_t a, std::int64_t b) {
    return std::to_string(a) + " x " + std::to_string(b);
}

// What the header claims, before anything of that size is allocated.
void check_size(const OIIO::ImageSpec& spec, std::int64_t bytes_per_pixel) {
    const std::int64_t w = spec.width, h = spec.height;
    if (w < 1 || h < 1 || spec.depth > 1 || spec.deep) {
        throw ImageError("not a flat image of at least 1 x 1 pixels (found " +
                         times(w, h) + (spec.deep ? ", deep)" : ")"));
    }
    if (w > max_image_side || h > max_image_side || w * h > max_image_pixels) {
        throw ImageError("an image of " + times(w, h) + " pixels is over the limit of " +
                         std::to_string(max_image_side) + " a side and " +
                         std::to_string(max_image_pixels) + " in all");
    }
    const std::int64_t tile = std::int64_t{spec.tile_width} * spec.tile_height;
    if (spec.nchannels > max_image_channels || tile > max_image_pixels ||
        w * h * bytes_per_pixel > max_image_bytes) {
        throw ImageError("an image of " + times(w, h) + " pixels with " +
                         std::to_string(spec.nchannels) +
                         " channels is over the limit of " +
                         std::to_string(max_image_bytes) + " bytes");
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
    chosen = colour_channels(spec.channelnames);
    if (chosen.empty()) {
        throw ImageError("none of its " + std::to_string(spec.nchannels) +
                         " channels is named R, G, B or Y");
    }
    return chosen;
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
std::string complaint(OIIO::ImageInput& in, const std::string& name, const char* fallback) {
    return one_line(without_name(in.geterror(), name), fallback);
}

Image image_of(OIIO::ImageInput& in, const FileKind& kind, ChannelChoice choice,
               const std::string& name) {
    const OIIO::ImageSpec& spec = in.spec();
    const auto channels = chosen_channels(spec, choice);
    Image image;
    image.format = format_of(spec);
    check_size(spec, static_cast<std::int64_t>(channels.size()) *
                         static_cast<std::int64_t>(value_bytes(image.format)));
    image.width = spec.width;
    image.height = spec.height;
    image.channels = static_cast<int>(channels.size());
    for (int c : channels) {
        image.channel_names.push_back(spec.channelnames[c]);
    }
    if (choice == ChannelChoice::all) {
        image.window = {spec.x, spec.y, spec.full_width, spec.full_height};
        image.metadata = metadata_of(spec);
    }
    // Left unwritten on purpose: a short file fails before it has touched the pages that
    // a large claim would cost.
    image.pixels.reset(new std::byte[image.size_bytes()]);
    if (!read_pixels(in, channels, image)) {
        fail(kind, complaint(in, name, "its pixels cannot be decoded"));
    }
    return image;
}

Image read_with(const FileKind& kind, ChannelChoice choice, const std::string& name,
                OIIO::Filesystem::IOProxy* proxy) {
    prepare_oiio();
    try {
        Input in = OIIO::ImageInput::create(kind.reader);
        if (!in) {
            fail(kind, one_line(OIIO::geterror(), "no reader for it is installed"));
        }
        OIIO::ImageSpec config, spec;
        config.attribute("oiio:UnassociatedAlpha", 1);
        if (proxy && !in->set_ioproxy(proxy)) {
            fail(kind, "its reader cannot read from memory");
        }
        if (!in->open(name, spec, config)) {
            fail(kind, complaint(*in, name, "its header cannot be read"));
        }
        return image_of(*in, kind, choice, name);
    } catch (const ImageError&) {
        throw;
    } catch (const std::bad_alloc&) {
        fail(kind, "not enough memory to decode it");
    } catch (const std::exception& e) {
        fail(kind, one_line(e.what(), "it cannot be decoded"));
    }
}

std::vector<std::byte> head_of(const std::filesystem::path& path) {
    std::error_code error;
    const auto status = std::filesystem::status(path, error);
    if (!std::filesystem::exists(status)) {
        throw ImageError("no such file");
    }
    if (!std::filesystem::is_regular_file(status)) {
        throw ImageError("not a regular file");
    }
    std::ifstream file(path, std::ios::binary);
    if (!file) {
        throw ImageError("the file cannot be opened");
    }
    std::vector<std::byte> head(magic_bytes);
    file.read(reinterpret_cast<char*>(head.data()), magic_bytes);
    head.resize(static_cast<std::size_t>(file.gcount()));
    return head;
}

}  // namespace

Image read_image(const std::filesystem::path& path, ChannelChoice choice) {
    return read_with(kind_of(head_of(path)), choice, path.string(), nullptr);
}

Image read_image(std::span<const std::byte> file, ChannelChoice choice) {
    const FileKind kind = kind_of(file.first(std::min(file.size(), magic_bytes)));
    OIIO::Filesystem::IOMemReader memory(file.data(), file.size());
    return read_with(kind, choice, "<memory>", &memory);
}

}  // namespace raykiln
