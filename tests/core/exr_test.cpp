// OpenEXR files of kinds that raykiln does not write, made by the library itself.
#include "image/exr.h"

#include <ImfChannelList.h>
#include <ImfFrameBuffer.h>
#include <ImfHeader.h>
#include <ImfMultiPartOutputFile.h>
#include <ImfOutputFile.h>
#include <ImfOutputPart.h>
#include <ImfPartType.h>
#include <ImfTiledOutputFile.h>
#include <gtest/gtest.h>

#include <string>
#include <thread>
#include <vector>

#include "error.h"
#include "image/exr_seam.h"
#include "image/write_image.h"

namespace raykiln {
namespace {

constexpr int width = 70, height = 45;

std::vector<float> ramp(float first) {
    std::vector<float> values(std::size_t{width} * height);
    for (float& v : values) {
        v = first;
        first += 0.25f;
    }
    return values;
}

std::span<const std::byte> bytes_of(const std::vector<unsigned char>& file) {
    return std::as_bytes(std::span(file));
}

Imf::Slice slice_of(const std::vector<float>& plane) {
    return {Imf::FLOAT, reinterpret_cast<char*>(const_cast<float*>(plane.data())),
            sizeof(float), sizeof(float) * width};
}

Imf::Header header_of(const std::vector<std::string>& channels) {
    Imf::Header header(width, height);
    for (const std::string& name : channels) {
        header.channels().insert(name, Imf::Channel(Imf::FLOAT));
    }
    return header;
}

std::vector<float> values_of(const Image& image) {
    const auto values = image.values<float>();
    return {values.begin(), values.end()};
}

std::string error_of(const std::vector<unsigned char>& file) {
    try {
        read_exr(bytes_of(file), ChannelChoice::colour);
    } catch (const ImageError& e) {
        return e.what();
    }
    return "no error";
}

std::vector<unsigned char> tiled(Imf::LevelMode mode, unsigned tile) {
    const auto plane = ramp(1);
    Imf::Header header = header_of({"Y"});
    header.setTileDescription({tile, tile, mode});
    ExrMemoryOutput memory;
    {
        Imf::TiledOutputFile file(memory, header, 0);
        Imf::FrameBuffer frame;
        frame.insert("Y", slice_of(plane));
        file.setFrameBuffer(frame);
        for (int y = 0; y < file.numYLevels(); ++y) {
            for (int x = 0; x < file.numXLevels(); ++x) {
                if (file.isValidLevel(x, y)) {
                    file.writeTiles(0, file.numXTiles(x) - 1, 0, file.numYTiles(y) - 1, x,
                                    y);
                }
            }
        }
    }
    return memory.bytes;
}

TEST(ExrReader, TakesTheFinestOfTiledLevels) {
    for (const auto mode : {Imf::ONE_LEVEL, Imf::MIPMAP_LEVELS, Imf::RIPMAP_LEVELS}) {
        const auto file = tiled(mode, 16);
        const Image image = read_exr(bytes_of(file), ChannelChoice::colour);
        ASSERT_EQ(image.width, width);
        ASSERT_EQ(image.height, height);
        EXPECT_EQ(values_of(image), ramp(1));
    }
}

TEST(ExrReader, RefusesTilesFarLargerThanTheImage) {
    // 8192 x 8192 pixels of one channel; the writer allocates them, the reader does not.
    EXPECT_EQ(error_of(tiled(Imf::ONE_LEVEL, 8192)),
              "tiles of 8192 x 8192 pixels are too large for an image of 70 x 45");
}

TEST(ExrReader, TakesTheFirstPart) {
    const auto colour = ramp(3), other = ramp(500);
    std::vector<Imf::Header> headers{header_of({"Y"}), header_of({"Z"})};
    headers[0].setName("colour");
    headers[1].setName("other");
    for (Imf::Header& header : headers) {
        header.setType(Imf::SCANLINEIMAGE);
    }
    ExrMemoryOutput memory;
    {
        Imf::MultiPartOutputFile file(memory, headers.data(), 2, false, 0);
        for (int i = 0; i < 2; ++i) {
            Imf::OutputPart part(file, i);
            Imf::FrameBuffer frame;
            frame.insert(i == 0 ? "Y" : "Z", slice_of(i == 0 ? colour : other));
            part.setFrameBuffer(frame);
            part.writePixels(height);
        }
    }
    const Image image = read_exr(bytes_of(memory.bytes), ChannelChoice::all);
    EXPECT_EQ(image.channel_names, std::vector<std::string>{"Y"});
    EXPECT_EQ(values_of(image), colour);
}

TEST(ExrReader, KeepsTheNumbersOfIntegerChannels) {
    std::vector<unsigned> ids(std::size_t{width} * height, 7);
    Imf::Header header(width, height);
    header.channels().insert("Y", Imf::Channel(Imf::UINT));
    ExrMemoryOutput memory;
    {
        Imf::OutputFile file(memory, header, 0);
        Imf::FrameBuffer frame;
        frame.insert("Y", Imf::Slice(Imf::UINT, reinterpret_cast<char*>(ids.data()), 4,
                                     std::size_t{4} * width));
        file.setFrameBuffer(frame);
        file.writePixels(height);
    }
    const Image image = read_exr(bytes_of(memory.bytes), ChannelChoice::colour);
    EXPECT_EQ(image.values<float>()[5], 7.0f);
}

TEST(ExrReader, RefusesChannelsOfLowerResolution) {
    const auto plane = ramp(0);
    Imf::Header header(width, height);
    header.channels().insert("Y", Imf::Channel(Imf::FLOAT));
    header.channels().insert("RY", Imf::Channel(Imf::FLOAT, 5, 5));
    ExrMemoryOutput memory;
    {
        Imf::OutputFile file(memory, header, 0);
        Imf::FrameBuffer frame;
        frame.insert("Y", slice_of(plane));
        Imf::Slice coarse = slice_of(plane);
        coarse.xSampling = coarse.ySampling = 5;
        frame.insert("RY", coarse);
        file.setFrameBuffer(frame);
        file.writePixels(height);
    }
    EXPECT_EQ(error_of(memory.bytes),
              "damaged or unsupported OpenEXR image: its channel RY is stored at a lower "
              "resolution");
}

TEST(ExrReader, OrdersChannelsAsPeopleReadThem) {
    const float value = 1;
    std::vector<ExrChannel> channels;
    for (const char* name : {"z.B", "z.G", "z.R", "B", "A", "G", "R", "depth"}) {
        channels.push_back({name, &value, 1, 1, false});
    }
    const auto file = encode_exr(1, 1, channels, {}, {});
    const Image image = read_exr(bytes_of(file), ChannelChoice::all);
    EXPECT_EQ(image.channel_names, (std::vector<std::string>{"R", "G", "B", "A", "depth",
                                                             "z.R", "z.G", "z.B"}));
}

// Large enough for threads, which come and go with the images that need them.
TEST(ExrThreads, ManyAtOnceGiveTheSameBytes) {
    constexpr int side = 512;
    const std::vector<float> plane = [] {
        std::vector<float> values(std::size_t{side} * side);
        for (std::size_t i = 0; i < values.size(); ++i) {
            values[i] = static_cast<float>(i % 1013) * 0.5f;
        }
        return values;
    }();
    const std::vector<ExrChannel> channels{{"Y", plane.data(), 1, side, false}};
    const auto expected = encode_exr(side, side, channels, {}, {});
    std::vector<int> good(4);
    std::vector<std::thread> users;
    for (int& result : good) {
        users.emplace_back([&] {
            for (int i = 0; i < 4; ++i) {
                const auto file = encode_exr(side, side, channels, {}, {});
                const Image back = read_exr(bytes_of(file), ChannelChoice::colour);
                result += file == expected && values_of(back) == plane;
            }
        });
    }
    for (std::thread& user : users) {
        user.join();
    }
    EXPECT_EQ(good, std::vector(4, 4));
}

}  // namespace
}  // namespace raykiln
