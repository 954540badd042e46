#include <ImfChannelList.h>
#include <ImfDoubleAttribute.h>
#include <ImfFrameBuffer.h>
#include <ImfHeader.h>
#include <ImfIntAttribute.h>
#include <ImfOutputFile.h>
#include <ImfStandardAttributes.h>
#include <ImfStringAttribute.h>

#include <algorithm>
#include <cmath>
#include <cstring>

#include "error.h"
#include "image/exr_seam.h"
#include "image/limits.h"
#include "image/message.h"
#include "image/write_image.h"

namespace raykiln {

namespace {

void add_metadata(Imf::Header& header, const Metadata& metadata) {
    for (const auto& [name, value] : metadata) {
        if (const auto* text = std::get_if<std::string>(&value)) {
            header.insert(name, Imf::StringAttribute(*text));
        } else if (const auto* whole = std::get_if<int>(&value)) {
            header.insert(name, Imf::IntAttribute(*whole));
        } else {
            header.insert(name, Imf::DoubleAttribute(std::get<double>(value)));
        }
    }
}

Imf::Header header_of(int width, int height, const std::vector<ExrChannel>& channels,
                      const Window& window, const Metadata& metadata) {
    const int full_width = window.full_width ? window.full_width : width;
    const int full_height = window.full_height ? window.full_height : height;
    const Imath::Box2i whole({0, 0}, {full_width - 1, full_height - 1});
    const Imath::Box2i stored({window.x, window.y},
                              {window.x + width - 1, window.y + height - 1});
    Imf::Header header(whole, stored, 1.0f, {0.0f, 0.0f}, 1.0f, Imf::INCREASING_Y,
                       Imf::ZIP_COMPRESSION);
    for (const ExrChannel& channel : channels) {
        header.channels().insert(channel.name,
                                 Imf::Channel(channel.half ? Imf::HALF : Imf::FLOAT));
    }
    add_metadata(header, metadata);
    // Those of Rec.709 are the default.
    Imf::addChromaticities(header, Imf::Chromaticities());
    return header;
}

float clamp_to_half(float value) {
    constexpr float largest_half = 65504.0f;
    return std::isfinite(value) ? std::clamp(value, -largest_half, largest_half) : value;
}

// A band of rows of all channels, one after the other, as they are stored.
class Band {
  public:
    Band(int width, int rows, const std::vector<ExrChannel>& channels) :
        width_(width),
        channels_(channels) {
        std::size_t size = 0;
        for (const ExrChannel& channel : channels) {
            starts_.push_back(size);
            size += value_size(channel) * static_cast<std::size_t>(width) *
                    static_cast<std::size_t>(rows);
        }
        bytes_.resize(size);
    }

    void gather(int y0, int y1) {
        for (std::size_t c = 0; c < channels_.size(); ++c) {
            const ExrChannel& channel = channels_[c];
            char* to = bytes_.data() + starts_[c];
            for (int y = y0; y < y1; ++y) {
                to = channel.half ? gather_row<Imath::half>(channel, y, to)
                                  : gather_row<float>(channel, y, to);
            }
        }
    }

    // The band as a part of the file whose first row and column are these.
    Imf::FrameBuffer frame(int first_x, int first_y, int rows) {
        Imf::FrameBuffer frame;
        const Imath::Box2i window({first_x, first_y},
                                  {first_x + width_ - 1, first_y + rows - 1});
        for (std::size_t c = 0; c < channels_.size(); ++c) {
            frame.insert(channels_[c].name,
                         Imf::Slice::Make(channels_[c].half ? Imf::HALF : Imf::FLOAT,
                                          bytes_.data() + starts_[c], window));
        }
        return frame;
    }

  private:
    static std::size_t value_size(const ExrChannel& channel) {
        return channel.half ? sizeof(Imath::half) : sizeof(float);
    }

    template <typename T>
    char* gather_row(const ExrChannel& channel, int y, char* to) const {
        const float* from = channel.values + y * channel.row_stride;
        for (int x = 0; x < width_; ++x, from += channel.pixel_stride, to += sizeof(T)) {
            if constexpr (sizeof(T) == sizeof(float)) {
                std::memcpy(to, from, sizeof(T));  // NaNs keep their bits
            } else {
                const T half(clamp_to_half(*from));
                std::memcpy(to, &half, sizeof(T));
            }
        }
        return to;
    }

    int width_;
    const std::vector<ExrChannel>& channels_;
    std::vector<std::size_t> starts_;
    std::vector<char> bytes_;
};

}  // namespace

std::vector<unsigned char> encode_exr(int width, int height,
                                      const std::vector<ExrChannel>& channels,
                                      const Window& window, const Metadata& metadata) {
    check_size_to_write("exr", width, height, channels.size());
    try {
        const std::uint64_t row_bytes = 4 * channels.size() * std::uint64_t(width);
        const ExrThreads threads(row_bytes * std::uint64_t(height));
        // A multiple of the 16 rows that one ZIP block holds.
        const int rows = std::min(height, row_bytes < (1 << 20) ? 64 : 16);
        Band band(width, rows, channels);
        ExrMemoryOutput memory;
        {
            Imf::OutputFile file(memory,
                                 header_of(width, height, channels, window, metadata),
                                 threads.count());
            for (int y0 = 0; y0 < height; y0 += rows) {
                const int y1 = std::min(y0 + rows, height);
                band.gather(y0, y1);
                file.setFrameBuffer(band.frame(window.x, window.y + y0, y1 - y0));
                file.writePixels(y1 - y0);
            }
        }
        return std::move(memory.bytes);
    } catch (const std::exception& e) {
        fail_to_write("exr", one_line(e.what(), "its writer failed"));
    }
}

}  // namespace raykiln
