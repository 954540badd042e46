#include "texture/texture.h"

#include <gtest/gtest.h>

#include "statistics.h"

namespace raykiln {
namespace {

constexpr int width = 4, height = 3;

/// 4 x 3 pixels, pixel (x, y) is 10 y + x in every channel.
template <class Code>
ImageTexture numbered(int channels, PixelFormat format) {
    auto pixels = std::make_shared<std::vector<Code>>();
    for (int y = 0; y < height; ++y) {
        for (int x = 0; x < width; ++x) {
            pixels->insert(pixels->end(), static_cast<std::size_t>(channels),
                           static_cast<Code>(10 * y + x));
        }
    }
    ImageTexture t;
    t.pixels = pixels->data();
    t.owner = pixels;
    t.width = width;
    t.height = height;
    t.channels = channels;
    t.format = format;
    return t;
}

Vec2f center(int x, int y) {
    return {(static_cast<float>(x) + 0.5f) / width,
            (static_cast<float>(y) + 0.5f) / height};
}

float value_at(const ImageTexture& t, Vec2f uv) {
    return lookup(t, uv).rgb.x;
}

TEST(ImageTexture, CentresGiveThePixels) {
    for (const TextureFilter filter : {TextureFilter::bilinear, TextureFilter::nearest}) {
        ImageTexture t = numbered<float>(3, PixelFormat::f32);
        t.filter = filter;
        for (int y = 0; y < height; ++y) {
            for (int x = 0; x < width; ++x) {
                // Products and differences of numbers to 23, a few ulp.
                EXPECT_NEAR(value_at(t, center(x, y)), 10 * y + x, 2e-5);
            }
        }
    }
}

TEST(ImageTexture, BilinearIsLinearBetweenCentres) {
    // The numbering is linear in x and y, so that the look-up is exact between the
    // centres.
    const ImageTexture t = numbered<float>(1, PixelFormat::f32);
    test::Rng rng(161);
    for (int i = 0; i < 10000; ++i) {
        const float x = rng.between(0.5f, 3.5f), y = rng.between(0.5f, 2.5f);
        EXPECT_NEAR(value_at(t, {x / width, y / height}), 10 * (y - 0.5f) + x - 0.5f,
                    4e-5);
    }
}

TEST(ImageTexture, NearestTakesThePixelThatHoldsThePoint) {
    ImageTexture t = numbered<float>(1, PixelFormat::f32);
    t.filter = TextureFilter::nearest;
    EXPECT_EQ(value_at(t, {0.0f, 0.0f}), 0.0f);
    EXPECT_EQ(value_at(t, {0.249f, 0.33f}), 0.0f);
    EXPECT_EQ(value_at(t, {0.251f, 0.34f}), 11.0f);
    EXPECT_EQ(value_at(t, {0.999f, 0.999f}), 23.0f);
}

TEST(ImageTexture, WrapsAsItSays) {
    struct Case {
        TextureWrap wrap;
        int beyond[6];  // pixels found at x = -5, -4, -1, 4, 7, 8
    };
    const int at[6] = {-5, -4, -1, 4, 7, 8};
    const Case cases[] = {{TextureWrap::repeat, {3, 0, 3, 0, 3, 0}},
                          {TextureWrap::clamp, {0, 0, 0, 3, 3, 3}},
                          {TextureWrap::mirror, {3, 3, 0, 3, 0, 0}}};
    for (const Case& c : cases) {
        ImageTexture t = numbered<float>(1, PixelFormat::f32);
        t.filter = TextureFilter::nearest;
        t.wrap_u = c.wrap;
        for (int i = 0; i < 6; ++i) {
            EXPECT_EQ(value_at(t, center(at[i], 0)), static_cast<float>(c.beyond[i]))
                << "wrap " << static_cast<int>(c.wrap) << " at " << at[i];
        }
        t.wrap_u = TextureWrap::repeat;
        t.wrap_v = c.wrap;
        // Down the rows: 3 of them. Row -1 and row 3.
        const int above = c.wrap == TextureWrap::repeat ? 2 : 0;
        const int below = c.wrap == TextureWrap::repeat ? 0 : 2;
        EXPECT_EQ(value_at(t, center(0, -1)), static_cast<float>(10 * above));
        EXPECT_EQ(value_at(t, center(0, 3)), static_cast<float>(10 * below));
    }
}

TEST(ImageTexture, BilinearMeetsAtTheSeam) {
    ImageTexture t = numbered<float>(1, PixelFormat::f32);
    // Half-way between the last and the first column.
    EXPECT_NEAR(value_at(t, {1.0f, center(0, 0).y}), 1.5f, 1e-5f);
    t.wrap_u = TextureWrap::clamp;
    EXPECT_NEAR(value_at(t, {1.0f, center(0, 0).y}), 3.0f, 1e-5f);
    t.wrap_u = TextureWrap::mirror;
    EXPECT_NEAR(value_at(t, {1.0f, center(0, 0).y}), 3.0f, 1e-5f);
}

TEST(ImageTexture, TransformsItsCoordinates) {
    ImageTexture t = numbered<float>(1, PixelFormat::f32);
    t.filter = TextureFilter::nearest;
    t.uv_transform = {0, 0.75f, 0.125f, 2.0f / 3, 0, 1.0f / 6};
    // (u, v) -> (0.75 v + 0.125, 2/3 u + 1/6): pixel (3 v, 2 u) to its centre.
    EXPECT_EQ(value_at(t, {0.0f, 0.0f}), 0.0f);
    EXPECT_EQ(value_at(t, {1.0f, 0.0f}), 20.0f);
    EXPECT_EQ(value_at(t, {0.0f, 1.0f}), 3.0f);
    EXPECT_EQ(value_at(t, {0.5f, 1.0f}), 13.0f);
}

TEST(ImageTexture, StrangeCoordinatesAreSafe) {
    const ImageTexture t = numbered<float>(1, PixelFormat::f32);
    for (const float u : {std::nanf(""), infinity, -infinity, 3e38f, -3e38f, 1e9f}) {
        for (const float v : {0.5f, u}) {
            const float value = value_at(t, {u, v});
            EXPECT_GE(value, 0.0f);
            EXPECT_LE(value, 23.0f);
        }
    }
}

TEST(ImageTexture, DecodesItsCodes) {
    EXPECT_FLOAT_EQ(value_at(numbered<std::uint8_t>(1, PixelFormat::u8), center(3, 2)),
                    23.0f / 255);
    EXPECT_FLOAT_EQ(value_at(numbered<std::uint16_t>(1, PixelFormat::u16), center(3, 2)),
                    23.0f / 65535);
}

TEST(ImageTexture, DecodesSrgbColoursAndNoAlpha) {
    for (int code = 0; code < 256; ++code) {
        auto pixel = std::make_shared<std::vector<std::uint8_t>>(
            4, static_cast<std::uint8_t>(code));
        ImageTexture t;
        t.pixels = pixel->data();
        t.owner = pixel;
        t.width = t.height = 1;
        t.channels = 4;
        t.srgb = true;
        const double x = code / 255.0;
        const double linear =
            x <= 0.04045 ? x / 12.92 : std::pow((x + 0.055) / 1.055, 2.4);
        const Texel texel = lookup(t, {0.5f, 0.5f});
        EXPECT_NEAR(texel.rgb.x, linear, 1e-6);
        EXPECT_NEAR(texel.rgb.z, linear, 1e-6);
        EXPECT_NEAR(texel.alpha, x, 1e-6);
    }
}

TEST(ImageTexture, ChannelsFillTexels) {
    const Texel grey = lookup(numbered<float>(1, PixelFormat::f32), center(1, 1));
    EXPECT_FLOAT_EQ(grey.rgb.z, 11.0f);
    EXPECT_EQ(grey.alpha, 1.0f);
    EXPECT_FLOAT_EQ(lookup(numbered<float>(2, PixelFormat::f32), center(1, 1)).alpha,
                    11.0f);
    EXPECT_EQ(lookup(numbered<float>(3, PixelFormat::f32), center(1, 1)).alpha, 1.0f);
    EXPECT_FLOAT_EQ(lookup(numbered<float>(4, PixelFormat::f32), center(1, 1)).alpha,
                    11.0f);
}

TEST(Slots, AverageFindsOneTexelThatIsLit) {
    constexpr int size = 200;
    auto pixels = std::make_shared<std::vector<float>>(size * size);
    (*pixels)[70 * size + 33] = 8.0f;
    ImageTexture image;
    image.pixels = pixels->data();
    image.owner = pixels;
    image.width = image.height = size;
    image.channels = 1;
    image.format = PixelFormat::f32;
    const ColorSlot color{Vec3f(1.0f), 0, Channel::rgb};
    EXPECT_FLOAT_EQ(average(color, {image}).x, 8.0f / (size * size));
}

TEST(Slots, MultiplyTheirTexture) {
    auto pixel = std::make_shared<std::vector<float>>(
        std::initializer_list<float>{0.1f, 0.2f, 0.3f, 0.4f});
    ImageTexture image;
    image.pixels = pixel->data();
    image.owner = pixel;
    image.width = image.height = 1;
    image.channels = 4;
    image.format = PixelFormat::f32;
    const std::vector<Texture> textures{image};
    const Vec2f uv{0.5f, 0.5f};
    const ColorSlot color{{2, 4, 8}, 0, Channel::rgb};
    EXPECT_FLOAT_EQ(evaluate(color, textures, uv).x, 0.2f);
    EXPECT_FLOAT_EQ(evaluate(color, textures, uv).z, 2.4f);
    EXPECT_NEAR(average(color, textures).y, 0.8f, 256 * 0x1p-24f);  // a sum of 256
    const struct {
        Channel channel;
        float value;
    } picks[] = {{Channel::r, 0.1f},
                 {Channel::g, 0.2f},
                 {Channel::b, 0.3f},
                 {Channel::a, 0.4f},
                 {Channel::rgb, 0.2f}};
    for (const auto& pick : picks) {
        EXPECT_FLOAT_EQ(evaluate(FloatSlot{3, 0, pick.channel}, textures, uv),
                        3 * pick.value);
    }
    EXPECT_EQ(evaluate(FloatSlot{3}, textures, uv), 3.0f);
    EXPECT_EQ(evaluate(ColorSlot{{1, 2, 3}}, textures, uv).y, 2.0f);
}

TEST(CheckerTexture, SquaresAlternate) {
    CheckerTexture checker{{1, 1, 1}, {0, 0, 0}, {}};
    for (int y = -3; y < 4; ++y) {
        for (int x = -3; x < 4; ++x) {
            const Vec2f uv{(static_cast<float>(x) + 0.5f) / 2,
                           (static_cast<float>(y) + 0.5f) / 2};
            EXPECT_EQ(lookup(checker, uv).rgb.x, (x + y) % 2 == 0 ? 1.0f : 0.0f);
        }
    }
    checker.uv_transform = {2, 0, 0, 0, 2, 0};
    EXPECT_EQ(lookup(checker, {0.125f, 0.125f}).rgb.x, 1.0f);
    EXPECT_EQ(lookup(checker, {0.375f, 0.125f}).rgb.x, 0.0f);
    EXPECT_EQ(lookup(checker, {0.625f, 0.125f}).rgb.x, 1.0f);
}

}  // namespace
}  // namespace raykiln
