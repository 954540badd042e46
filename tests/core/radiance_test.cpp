#include "image/radiance.h"

#include <gtest/gtest.h>

#include <string>
#include <string_view>
#include <vector>

#include "error.h"

namespace raykiln {
namespace {

using namespace std::string_view_literals;

std::string file_of(std::string_view sizes, std::string_view pixels) {
    return "#?RADIANCE\nEXPOSURE=2\nFORMAT=32-bit_rle_rgbe\n\n" + std::string(sizes) +
           "\n" + std::string(pixels);
}

std::vector<float> decoded(const std::string& file) {
    const Image image = decode_radiance(std::as_bytes(std::span(file)));
    const auto values = image.values<float>();
    return {values.begin(), values.end()};
}

std::string error_of(const std::string& file) {
    try {
        decoded(file);
    } catch (const ImageError& e) {
        return e.what();
    }
    return "no error";
}

TEST(Radiance, PlainPixels) {
    EXPECT_EQ(decoded(file_of("-Y 1 +X 2", "\x80\x40\x20\x81\xff\xff\xff\0"sv)),
              (std::vector{1.0f, 0.5f, 0.25f, 0.0f, 0.0f, 0.0f}));
}

TEST(Radiance, OldRunsRepeatThePixelBefore) {
    const auto values =
        decoded(file_of("-Y 1 +X 260", "\x80\x40\x20\x81\1\1\1\3\1\1\1\1"sv));
    ASSERT_EQ(values.size(), 780u);
    EXPECT_EQ(values[0], 1.0f);
    EXPECT_EQ(values[778], 0.5f);
    EXPECT_EQ(error_of(file_of("-Y 1 +X 2", "\1\1\1\1\1\1\1\1"sv)),
              "damaged or unsupported Radiance HDR image: a run does not fit its row");
}

TEST(Radiance, NewRunsAndStretches) {
    const auto values = decoded(
        file_of("-Y 1 +X 8", "\2\2\0\x8\x88\x80\x3\1\2\3\x85\x4\x88\x20\x88\x81"sv));
    ASSERT_EQ(values.size(), 24u);
    EXPECT_EQ(values[0], 1.0f);
    EXPECT_EQ(values[4], 2.0f / 128);
    EXPECT_EQ(values[22], 4.0f / 128);
    EXPECT_EQ(values[23], 0.25f);
}

TEST(Radiance, RefusesWhatItCannotRead) {
    const std::string whole = file_of("-Y 1 +X 8", "\2\2\0\x8\x88\1\x88\1\x88\1\x88\1"sv);
    EXPECT_EQ(error_of(whole), "no error");
    for (std::size_t size = 0; size < whole.size(); ++size) {
        EXPECT_NE(error_of(whole.substr(0, size)), "no error") << size;
    }
    for (const char* sizes :
         {"-Y 1", "Y 1 X 8", "-Z 1 +X 8", "-Y  +X 8", "-Y 99999999999999999999 +X 8",
          "-Y 0 +X 8", "-Y -1 +X 8", "-Y 70000 +X 8"}) {
        EXPECT_NE(error_of(file_of(sizes, "\2\2\0\x8\x88\1\x88\1\x88\1\x88\1"sv)),
                  "no error")
            << sizes;
    }
    EXPECT_NE(error_of("#?RADIANCE\nFORMAT=32-bit_rle_xyze\n\n-Y 1 +X 1\n\1\2\3\x80"),
              "no error");
    EXPECT_NE(error_of(file_of("-Y 1 +X 8", "\2\2\0\x8\x89\1\x88\1\x88\1\x88\1"sv)),
              "no error");
}

}  // namespace
}  // namespace raykiln
