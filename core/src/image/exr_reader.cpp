#include <ImfChannelList.h>
#include <ImfDoubleAttribute.h>
#include <ImfFloatAttribute.h>
#include <ImfFrameBuffer.h>
#include <ImfHeader.h>
#include <ImfInputPart.h>
#include <ImfIntAttribute.h>
#include <ImfMultiPartInputFile.h>
#include <ImfPartType.h>
#include <ImfStringAttribute.h>

#include <algorithm>
#include <array>
#include <new>
#include <string>
#include <tuple>

#include "error.h"
#include "image/channels.h"
#include "image/exr.h"
#include "image/exr_seam.h"
#include "image/limits.h"
#include "image/message.h"

namespace raykiln {

namespace {

constexpr const char* title = "OpenEXR";

struct Size {
    std::int64_t width, height;
};

// In 64 bits: the corners of a damaged file may be any numbers.
Size size_of(const Imath::Box2i& box) {
    return {std::int64_t{box.max.x} - box.min.x + 1,
            std::int64_t{box.max.y} - box.min.y + 1};
}

std::size_t channel_count(const Imf::Header& header) {
    std::size_t count = 0;
    for (auto c = header.channels().begin(); c != header.channels().end(); ++c) {
        ++count;
    }
    return count;
}

// All that a header claims and that would cost memory or time, before either is spent.
void check_claims(const Imf::Header& header, std::size_t chosen,
                  std::uint64_t file_bytes) {
    const Size size = size_of(header.dataWindow());
    const std::size_t all = channel_count(header);
    check_image_size(size.width, size.height, static_cast<std::int64_t>(4 * chosen));
    if (header.hasTileDescription()) {
        const auto& tiles = header.tileDescription();
        check_tile_size(tiles.xSize, tiles.ySize, size.width, size.height,
                        static_cast<std::int64_t>(all));
    }
    // Half of the bytes that we make may be all that the file has of a channel.
    const auto pixels = static_cast<std::uint64_t>(size.width * size.height);
    check_plausible(pixels * 4 * chosen, file_bytes);
    check_plausible(pixels * 2 * all, file_bytes);
}

void check_kind(const Imf::Header& header) {
    if (header.hasType() && Imf::isDeepData(header.type())) {
        fail_to_read(title, "it is deep");
    }
    const Imf::ChannelList& channels = header.channels();
    if (channel_count(header) > static_cast<std::size_t>(max_image_channels)) {
        fail_to_read(title, "it has more than " + std::to_string(max_image_channels) +
                                " channels");
    }
    for (auto c = channels.begin(); c != channels.end(); ++c) {
        if (c.channel().xSampling != 1 || c.channel().ySampling != 1) {
            fail_to_read(title, one_line("its channel " + std::string(c.name()) +
                                             " is stored at a lower resolution",
                                         ""));
        }
    }
}

// The file has its channels by alphabet; people expect R, G, B(, A) of each layer.
std::vector<std::string> ordered_names(const Imf::Header& header) {
    constexpr std::array order{"R", "G", "B", "A", "X", "Y", "Z"};
    const auto key = [&](const std::string& name) {
        const std::size_t dot = name.rfind('.');
        const bool plain = dot == std::string::npos;
        const std::string last = plain ? name : name.substr(dot + 1);
        const auto place = std::ranges::find(order, last) - order.begin();
        return std::tuple(plain ? std::string() : name.substr(0, dot), place, last);
    };
    std::vector<std::string> names;
    for (auto c = header.channels().begin(); c != header.channels().end(); ++c) {
        names.emplace_back(c.name());
    }
    std::ranges::sort(names, {}, key);
    return names;
}

std::vector<std::string> chosen_names(const Imf::Header& header, ChannelChoice choice) {
    auto names = ordered_names(header);
    if (choice == ChannelChoice::all) {
        return names;
    }
    std::vector<std::string> chosen;
    for (int i : require_colour_channels(names)) {
        chosen.push_back(names[static_cast<std::size_t>(i)]);
    }
    return chosen;
}

// What only describes how the file is coded.
bool is_coding(const std::string& name) {
    constexpr std::array names{"chunkCount", "version", "type", "pixelAspectRatio",
                               "screenWindowWidth"};
    return std::ranges::find(names, name) != names.end();
}

Metadata metadata_of(const Imf::Header& header) {
    Metadata metadata;
    for (auto a = header.begin(); a != header.end(); ++a) {
        const std::string name = a.name();
        const Imf::Attribute* value = &a.attribute();
        if (is_coding(name)) {
            continue;
        }
        if (const auto* text = dynamic_cast<const Imf::StringAttribute*>(value)) {
            metadata.emplace_back(name, text->value());
        } else if (const auto* whole = dynamic_cast<const Imf::IntAttribute*>(value)) {
            metadata.emplace_back(name, whole->value());
        } else if (const auto* real = dynamic_cast<const Imf::FloatAttribute*>(value)) {
            metadata.emplace_back(name, double{real->value()});
        } else if (const auto* exact = dynamic_cast<const Imf::DoubleAttribute*>(value)) {
            metadata.emplace_back(name, exact->value());
        }
    }
    return metadata;
}

// OpenEXR converts each channel to f32 and puts it into its place among the others.
Imf::FrameBuffer frame_of(Image& image, const Imath::Box2i& window) {
    Imf::FrameBuffer frame;
    const std::size_t pixel = sizeof(float) * static_cast<std::size_t>(image.channels);
    for (std::size_t i = 0; i < image.channel_names.size(); ++i) {
        frame.insert(
            image.channel_names[i],
            Imf::Slice::Make(Imf::FLOAT, image.pixels.get() + i * sizeof(float), window,
                             pixel, pixel * static_cast<std::size_t>(image.width)));
    }
    return frame;
}

Image image_of(Imf::MultiPartInputFile& file, std::uint64_t file_bytes,
               ChannelChoice choice) {
    const Imf::Header& header = file.header(0);
    check_kind(header);
    Image image;
    image.channel_names = chosen_names(header, choice);
    check_claims(header, image.channel_names.size(), file_bytes);
    const Imath::Box2i box = header.dataWindow();
    image.format = PixelFormat::f32;
    image.width = static_cast<int>(size_of(box).width);
    image.height = static_cast<int>(size_of(box).height);
    image.channels = static_cast<int>(image.channel_names.size());
    if (choice == ChannelChoice::all) {
        const Size full = size_of(header.displayWindow());
        image.window = {box.min.x, box.min.y, static_cast<int>(full.width),
                        static_cast<int>(full.height)};
        image.metadata = metadata_of(header);
    }
    image.pixels = zeroed_pixels(image.size_bytes());
    const ExrThreads threads(image.size_bytes());
    Imf::InputPart part(file, 0);
    part.setFrameBuffer(frame_of(image, box));
    part.readPixels(box.min.y, box.max.y);
    return image;
}

Image read(Imf::IStream& stream, std::uint64_t file_bytes, ChannelChoice choice) {
    try {
        // Buffers for as many threads as there may be: whether they pay, the header
        // tells.
        Imf::MultiPartInputFile file(stream, ExrThreads::most());
        return image_of(file, file_bytes, choice);
    } catch (const ImageError&) {
        throw;
    } catch (const std::bad_alloc&) {
        fail_to_read(title, "not enough memory to decode it");
    } catch (const std::exception& e) {
        const std::string message = without_name(e.what(), stream.fileName());
        fail_to_read(title, one_line(message, "it cannot be decoded"));
    }
}

}  // namespace

Image read_exr(std::span<const std::byte> file, ChannelChoice choice) {
    ExrMemoryInput stream(file);
    return read(stream, file.size(), choice);
}

Image read_exr(const std::filesystem::path& path, ChannelChoice choice) {
    ExrFileInput stream(path);
    return read(stream, std::filesystem::file_size(path), choice);
}

}  // namespace raykiln
