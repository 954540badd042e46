#include <gtest/gtest.h>
#include <unistd.h>

#include <algorithm>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <initializer_list>
#include <limits>
#include <string>
#include <string_view>

#include "error.h"
#include "image/bmp.h"
#include "image/channels.h"
#include "image/file_kind.h"
#include "image/limits.h"
#include "image/read_image.h"
#include "image/targa.h"
#include "image/write_image.h"

namespace raykiln {
namespace {

using Names = std::vector<std::string>;

std::span<const std::byte> bytes_of(std::string_view text) {
    return {reinterpret_cast<const std::byte*>(text.data()), text.size()};
}

std::span<const std::byte> bytes_of(const std::vector<unsigned char>& file) {
    return {reinterpret_cast<const std::byte*>(file.data()), file.size()};
}

std::string little_endian(std::initializer_list<std::pair<std::uint32_t, int>> numbers) {
    std::string text;
    for (auto [value, size] : numbers) {
        for (; size > 0; --size, value >>= 8) {
            text.push_back(static_cast<char>(value & 0xff));
        }
    }
    return text;
}

std::string targa_header(int image_type, int width, int height, int bits,
                         int descriptor = 0x20) {
    return little_endian({{0, 2},
                          {static_cast<std::uint32_t>(image_type), 1},
                          {0, 4},
                          {0, 1},
                          {0, 4},
                          {static_cast<std::uint32_t>(width), 2},
                          {static_cast<std::uint32_t>(height), 2},
                          {static_cast<std::uint32_t>(bits), 1},
                          {static_cast<std::uint32_t>(descriptor), 1}});
}

std::string bmp_file(std::uint32_t width, std::uint32_t height, std::uint32_t bits,
                     std::string_view behind_header, std::uint32_t compression = 0,
                     std::uint32_t colours = 0) {
    const std::uint32_t pixels_at =
        54 + (bits <= 8 ? 4 * colours : 0) + (compression == 3 ? 12 : 0);
    return "BM" +
           little_endian({{0, 4},
                          {0, 4},
                          {pixels_at, 4},
                          {40, 4},
                          {width, 4},
                          {height, 4},
                          {1, 2},
                          {bits, 2},
                          {compression, 4},
                          {0, 4},
                          {0, 4},
                          {0, 4},
                          {colours, 4},
                          {0, 4}}) +
           std::string(behind_header);
}

std::vector<int> values_of(const Image& image) {
    const auto values = image.values<std::uint8_t>();
    return {values.begin(), values.end()};
}

std::string error_of(const auto& action) {
    try {
        action();
    } catch (const ImageError& e) {
        return e.what();
    }
    return "no error";
}

TEST(FileKind, IsToldByTheFirstBytes) {
    using namespace std::string_view_literals;
    EXPECT_STREQ(file_kind(bytes_of("\x76\x2f\x31\x01..."sv))->title, "OpenEXR");
    EXPECT_STREQ(file_kind(bytes_of("\x89PNG\r\n\x1a\n...."sv))->title, "PNG");
    EXPECT_STREQ(file_kind(bytes_of("RIFF\0\0\0\0WEBPVP8L"sv))->title, "WebP");
    EXPECT_STREQ(file_kind(bytes_of("MM\0*\0\0\0\x8"sv))->title, "TIFF");
    EXPECT_STREQ(file_kind(bytes_of("#?RGBE\n"sv))->title, "Radiance HDR");
    EXPECT_STREQ(file_kind(bytes_of(targa_header(10, 3, 2, 24)))->title, "Targa");
}

TEST(FileKind, RefusesEverythingElse) {
    using namespace std::string_view_literals;
    for (auto text :
         {""sv, "\x76\x2f\x31"sv, "GIF89a............"sv, "P6 1 1 255 ......."sv,
          "RIFF\0\0\0\0WAVEfmt 12"sv, "only text, nothing more"sv}) {
        EXPECT_FALSE(file_kind(bytes_of(text))) << text;
    }
    EXPECT_FALSE(file_kind(bytes_of(targa_header(2, 0, 2, 24))));
    EXPECT_FALSE(file_kind(bytes_of(targa_header(2, 3, 2, 23))));
}

TEST(ColourChannels, AreChosenByName) {
    EXPECT_EQ(colour_channels({"R", "G", "B"}), (std::vector{0, 1, 2}));
    EXPECT_EQ(colour_channels({"A", "B", "G", "R", "Z"}), (std::vector{3, 2, 1, 0}));
    EXPECT_EQ(colour_channels({"depth.Z", "r", "g", "b", "N.X"}), (std::vector{1, 2, 3}));
    EXPECT_EQ(colour_channels({"Z", "Y", "A"}), (std::vector{1, 2}));
    EXPECT_EQ(colour_channels({"d.Z", "a.R", "a.G", "a.B", "b.R"}),
              (std::vector{1, 2, 3}));
    EXPECT_EQ(colour_channels({"N.X", "N.Y", "N.Z"}), (std::vector{0, 1, 2}));
    EXPECT_EQ(colour_channels({"c0", "c1", "c2", "c3", "c4"}), std::vector<int>{});
}

TEST(Limits, AreCheckedBeforeAllocation) {
    EXPECT_NO_THROW(check_image_size(max_image_side, 4096, 4));
    EXPECT_THROW(check_image_size(0, 1, 1), ImageError);
    EXPECT_THROW(check_image_size(max_image_side + 1, 1, 1), ImageError);
    EXPECT_THROW(check_image_size(1 << 15, (1 << 13) + 1, 1), ImageError);
    EXPECT_THROW(check_image_size(1 << 14, 1 << 14, 17), ImageError);
    EXPECT_THROW(check_plausible(std::uint64_t{1} << 30, 100), ImageError);
    EXPECT_NO_THROW(check_plausible(std::uint64_t{1} << 30, 1 << 14));
}

TEST(Exr, KeepsBitsOfPlanesThatLieInterleaved) {
    const float inf = std::numeric_limits<float>::infinity();
    const std::vector<float> pixels{0.0f, -0.0f, 1e-42f, 3e38f, inf,  -1.5f,
                                    7.0f, 8.0f,  9.0f,   10.0f, 11.f, 12.0f};
    std::vector<ExrChannel> channels;
    for (const char* name : {"R", "G", "B"}) {
        const std::size_t c = channels.size();
        channels.push_back({name, pixels.data() + c, 3, 6, false});
    }
    const auto file = encode_exr(2, 2, channels, {}, {});
    const Image back = read_image(bytes_of(file));
    ASSERT_EQ(back.size_values(), pixels.size());
    EXPECT_EQ(std::memcmp(back.pixels.get(), pixels.data(), back.size_bytes()), 0);
    EXPECT_EQ(back.channel_names, (Names{"R", "G", "B"}));
}

TEST(Exr, KeepsWindowAndMetadata) {
    const float value = 2.0f;
    const Metadata metadata{
        {"raykiln:seed", 5}, {"raykiln:x", 0.1}, {"raykiln:name", "box"}};
    const auto file =
        encode_exr(1, 1, {{"Y", &value, 1, 1, true}}, {3, 4, 20, 30}, metadata);
    const Image back = read_image(bytes_of(file), ChannelChoice::all);
    EXPECT_EQ(back.window.x, 3);
    EXPECT_EQ(back.window.y, 4);
    EXPECT_EQ(back.window.full_width, 20);
    EXPECT_EQ(back.window.full_height, 30);
    for (const auto& entry : metadata) {
        EXPECT_NE(std::ranges::find(back.metadata, entry), back.metadata.end())
            << entry.first;
    }
}

TEST(Exr, ClampsHalves) {
    const std::vector<float> row{1e9f, -1e9f, 1.0f + 1.0f / 1024};
    const auto file = encode_exr(3, 1, {{"Y", row.data(), 1, 3, true}}, {}, {});
    const Image back = read_image(bytes_of(file));
    const auto values = back.values<float>();
    EXPECT_EQ(values[0], 65504.0f);
    EXPECT_EQ(values[1], -65504.0f);
    EXPECT_EQ(values[2], row[2]);
}

TEST(Png, KeepsValuesOfBothDepths) {
    const std::vector<std::uint8_t> eight{0, 1, 2, 0, 254, 255, 7, 128};
    const auto small =
        encode_png({1, 2, 4, PixelFormat::u8, eight.data()}, {{"view", "srgb"}});
    const Image a = read_image(bytes_of(small));
    EXPECT_EQ(values_of(a), (std::vector<int>{eight.begin(), eight.end()}));

    const std::vector<std::uint16_t> sixteen{0, 1, 256, 65535};
    const auto large = encode_png({2, 1, 2, PixelFormat::u16, sixteen.data()}, {});
    const Image b = read_image(bytes_of(large));
    ASSERT_EQ(b.format, PixelFormat::u16);
    EXPECT_EQ(std::memcmp(b.pixels.get(), sixteen.data(), b.size_bytes()), 0);
}

TEST(Files, AreReadByPathAndRefusedWithAReason) {
    namespace fs = std::filesystem;
    const fs::path folder =
        fs::temp_directory_path() / ("raykiln-image-test-" + std::to_string(::getpid()));
    fs::create_directory(folder);
    const std::uint8_t grey = 9;
    const auto png = encode_png({1, 1, 1, PixelFormat::u8, &grey}, {});
    std::ofstream(folder / "a.tga", std::ios::binary)
        .write(reinterpret_cast<const char*>(png.data()), std::ssize(png));
    std::ofstream(folder / "empty.png");
    EXPECT_EQ(values_of(read_image(folder / "a.tga")), std::vector{9});
    EXPECT_EQ(error_of([&] { read_image(folder / "b.png"); }), "no such file");
    EXPECT_EQ(error_of([&] { read_image(folder); }), "not a regular file");
    EXPECT_TRUE(error_of([&] {
                    read_image(folder / "empty.png");
                }).starts_with("the file is empty; accepted: OpenEXR"));
    fs::remove_all(folder);
}

TEST(Targa, RunsMayCrossRows) {
    // Three pixels a row: a run of four, then two plain ones; stored B, G, R.
    const std::string file = targa_header(10, 3, 2, 24) +
                             "\x83"
                             "abc"
                             "\x01"
                             "defghi";
    EXPECT_EQ(values_of(decode_targa(bytes_of(file))),
              (std::vector<int>{'c', 'b', 'a', 'c', 'b', 'a', 'c', 'b', 'a',  //
                                'c', 'b', 'a', 'f', 'e', 'd', 'i', 'h', 'g'}));
}

TEST(Targa, FiveBitColoursSpanTheRange) {
    const std::string file =
        targa_header(2, 2, 1, 16) + little_endian({{0x7fff, 2}, {0x0400, 2}});
    EXPECT_EQ(values_of(decode_targa(bytes_of(file))),
              (std::vector{255, 255, 255, 8, 0, 0}));
}

TEST(Targa, OriginMayBeAnyCorner) {
    const std::string pixels = little_endian({{1, 1}, {2, 1}, {3, 1}, {4, 1}});
    const auto decoded = [&](int descriptor) {
        return values_of(
            decode_targa(bytes_of(targa_header(3, 2, 2, 8, descriptor) + pixels)));
    };
    EXPECT_EQ(decoded(0x20), (std::vector{1, 2, 3, 4}));
    EXPECT_EQ(decoded(0x00), (std::vector{3, 4, 1, 2}));
    EXPECT_EQ(decoded(0x30), (std::vector{2, 1, 4, 3}));
    EXPECT_EQ(decoded(0x10), (std::vector{4, 3, 2, 1}));
}

TEST(Targa, ShortFilesAreRefused) {
    const std::string whole = targa_header(2, 2, 2, 24) + std::string(12, 'x');
    EXPECT_NO_THROW(decode_targa(bytes_of(whole)));
    for (std::size_t size = 0; size < whole.size(); ++size) {
        EXPECT_THROW(decode_targa(bytes_of(std::string_view(whole).substr(0, size))),
                     ImageError)
            << size;
    }
}

TEST(Bmp, RowsArePaddedAndRunUpwards) {
    const std::string pixels = little_endian(
        {{0x030201, 3}, {0, 1}, {0x060504, 3}, {0, 1}});  // 0xRRGGBB, bottom row first
    EXPECT_EQ(values_of(decode_bmp(bytes_of(bmp_file(1, 2, 24, pixels)))),
              (std::vector{6, 5, 4, 3, 2, 1}));
    const auto from_top = static_cast<std::uint32_t>(-2);
    EXPECT_EQ(values_of(decode_bmp(bytes_of(bmp_file(1, from_top, 24, pixels)))),
              (std::vector{3, 2, 1, 6, 5, 4}));
}

TEST(Bmp, PaletteIndicesAreChecked) {
    const std::string palette = little_endian({{0x112233, 4}, {0x445566, 4}});
    const auto with = [&](std::uint32_t row) {
        return bmp_file(3, 1, 4, palette + little_endian({{row, 4}}), 0, 2);
    };
    EXPECT_EQ(values_of(decode_bmp(bytes_of(with(0x1001)))),
              (std::vector{0x11, 0x22, 0x33, 0x44, 0x55, 0x66, 0x44, 0x55, 0x66}));
    EXPECT_EQ(error_of([&] { decode_bmp(bytes_of(with(0x2001))); }),
              "the file is damaged: colour 2 is not in its palette");
}

TEST(Bmp, BitFieldsAreScaled) {
    const std::string fields = little_endian({{0xf800, 4}, {0x07e0, 4}, {0x001f, 4}});
    const std::string file =
        bmp_file(2, 1, 16, fields + little_endian({{0xffff, 2}, {0x0820, 2}}), 3);
    EXPECT_EQ(values_of(decode_bmp(bytes_of(file))),
              (std::vector{255, 255, 255, 8, 4, 0}));
}

TEST(Bmp, RefusesWhatItCannotHold) {
    EXPECT_THROW(decode_bmp(bytes_of(bmp_file(4, 4, 8, "", 1))), ImageError);
    EXPECT_THROW(decode_bmp(bytes_of(bmp_file(4, 4, 7, ""))), ImageError);
    EXPECT_THROW(decode_bmp(bytes_of(bmp_file(0x7fffffff, 4, 24, ""))), ImageError);
    EXPECT_THROW(decode_bmp(bytes_of(bmp_file(4, 0x80000000, 24, ""))), ImageError);
}

}  // namespace
}  // namespace raykiln
