#include "light/environment.h"

#include <gtest/gtest.h>

#include <functional>

#include "shapes.h"

// Light from beyond the scene: directions drawn against their density, for surfaces that
// face all ways.

namespace raykiln {
namespace {

using test::Rng;

constexpr int samples = 400000;

/// Bins about +z are the map's own rows and columns when its y axis is turned there.
Vec3f z_of_y(const Vec3f& d) {
    return {-d.z, d.x, d.y};
}
Vec3f y_of_z(const Vec3f& d) {
    return {d.y, d.z, -d.x};
}

/// A map whose red is a function of the texel, and green and blue less.
std::vector<Texture> map_of(int width, int height,
                            const std::function<float(int, int)>& red) {
    auto pixels = std::make_shared<std::vector<float>>();
    for (int y = 0; y < height; ++y) {
        for (int x = 0; x < width; ++x) {
            const float value = red(x, y);
            pixels->insert(pixels->end(), {value, 0.5f * value, 0.25f * value});
        }
    }
    ImageTexture image;
    image.pixels = pixels->data();
    image.owner = pixels;
    image.width = width;
    image.height = height;
    image.channels = 3;
    image.format = PixelFormat::f32;
    image.wrap_v = TextureWrap::clamp;
    return {image};
}

/// A map of 16 x 8 with a hot texel, dark areas and a black half.
std::vector<Texture> spotted_map() {
    Rng rng(113);
    return map_of(16, 8, [&](int x, int y) {
        return x == 5 && y == 2 ? 50.0f : y > 4 ? 0.0f : rng.unit();
    });
}

std::vector<std::vector<Texture>> maps() {
    const auto gradient = [](int, int y) {
        return 1.0f / (1.0f + static_cast<float>(y));
    };
    const auto sun = [](int x, int y) { return x == 90 && y == 20 ? 2000.0f : 0.1f; };
    Rng rng(114);
    return {spotted_map(),
            map_of(128, 64, gradient),
            map_of(128, 64, sun),
            map_of(7, 3, [&](int, int) { return rng.unit(); }),
            map_of(1, 1, [](int, int) { return 1.0f; }),
            map_of(40, 18, [](int, int y) { return y % 7 < 3 ? 0.0f : 1.0f; }),
            map_of(11, 6, [&](int, int) { return rng.unit() - 0.3f; })};
}

EnvironmentLight sky(const std::vector<Texture>& textures) {
    EnvironmentLight light;
    light.map = 0;
    prepare_environment(light, textures);
    return light;
}

/// No normal, the axes, the folds of the octahedron, and others.
std::vector<Vec3f> normals() {
    std::vector<Vec3f> all{{0, 0, 0},  {0, 1, 0},  {0, -1, 0}, {1, 0, 0},
                           {-1, 0, 0}, {0, 0, -1}, {0, 0, 1}};
    all.push_back(normalize(Vec3f(1, 1, 1)));
    all.push_back(normalize(Vec3f(-1, -1e-7f, 1)));
    all.push_back(normalize(Vec3f(0.3f, -0.8f, -0.6f)));
    all.push_back(normalize(Vec3f(-0.9f, 0.1f, 0.7f)));
    return all;
}

void expect_density(const EnvironmentLight& light, const Vec3f& normal,
                    std::uint64_t seed, std::size_t tests) {
    const auto pdf = [&](const Vec3f& d) {
        return pdf_environment(light, normal, sky_point(light, y_of_z(d)));
    };
    auto expected = test::integrate_over_bins(pdf, 6);
    const double mass = std::accumulate(expected.begin(), expected.end(), 0.0);
    EXPECT_NEAR(mass, 1.0, 2e-3);
    std::vector<double> observed(expected.size());
    Rng rng(seed);
    for (int i = 0; i < samples; ++i) {
        float density;
        const Vec3f d =
            sample_environment(light, normal, rng.unit(), rng.unit(), rng.unit(), density)
                .direction;
        observed[test::bin_of(z_of_y(d))] += 1;
    }
    for (double& e : expected) {
        e *= samples / mass;
    }
    const auto result = test::chi_squared_test(observed, expected);
    EXPECT_GT(result.p_value, test::sidak(tests)) << result;
}

TEST(EnvironmentLight, DirectionsFollowTheDensity) {
    const Vec3f some[] = {{0, 0, 0},
                          {0, 1, 0},
                          normalize(Vec3f(-0.9f, 0.1f, 0.7f)),
                          normalize(Vec3f(0.3f, -0.8f, -0.6f))};
    std::size_t number = 0;
    for (const auto& textures : maps()) {
        SCOPED_TRACE(number++);
        const EnvironmentLight light = sky(textures);
        for (const Vec3f& normal : some) {
            expect_density(light, normal, 115, 28);
        }
    }
}

TEST(EnvironmentLight, ConstantFollowsTheCosine) {
    const EnvironmentLight light;
    for (const Vec3f& normal : normals()) {
        expect_density(light, normal, 116, normals().size());
    }
    EXPECT_EQ(pdf_environment(light, Vec3f{0, 0, 0}, sky_point(light, Vec3f{0, 1, 0})),
              0.25f * inv_pi);
    EXPECT_EQ(pdf_environment(light, Vec3f{0, 1, 0}, sky_point(light, Vec3f{0, 1, 0})),
              inv_pi);
    EXPECT_EQ(pdf_environment(light, Vec3f{0, -1, 0}, sky_point(light, Vec3f{0, 1, 0})),
              0.0f);
}

TEST(EnvironmentLight, SampledDensityIsTheDensityThere) {
    for (const auto& textures : {spotted_map(), maps()[1]}) {
        EnvironmentLight light = sky(textures);
        light.world_from_light = frame_of_normal(normalize(Vec3f(1, 2, 3)));
        Rng rng(116);
        int same = 0;
        for (int i = 0; i < 100000; ++i) {
            const Vec3f normal = i % 5 == 0 ? Vec3f(0.0f) : test::random_direction(rng);
            float density;
            const Vec3f d = sample_environment(light, normal, rng.unit(), rng.unit(),
                                               rng.unit(), density)
                                .direction;
            ASSERT_NEAR(length(d), 1.0f, 2e-6f);
            // Back through arc tangent and cosine a point may round into the next cell:
            // within 1e-6 of an edge, of cells 1/128 wide at least.
            same +=
                std::fabs(pdf_environment(light, normal, sky_point(light, d)) / density -
                          1.0f) < 1e-4f;
        }
        EXPECT_GT(same, 100000 - 150);
    }
}

TEST(EnvironmentLight, EveryLitDirectionOfASurfaceCanBeDrawn) {
    for (const auto& textures : maps()) {
        const EnvironmentLight light = sky(textures);
        Rng rng(117);
        int lit = 0;
        for (int i = 0; i < 100000; ++i) {
            const Vec3f d = test::random_direction(rng);
            const Vec3f normal = test::random_direction(rng);
            if (luminance(environment_radiance(light, textures, sky_point(light, d))) >
                    0.0f &&
                dot(d, normal) > 0.0f) {
                ++lit;
                ASSERT_GT(pdf_environment(light, normal, sky_point(light, d)), 0.0f);
                ASSERT_GT(pdf_environment(light, Vec3f(0.0f), sky_point(light, d)), 0.0f);
            }
        }
        EXPECT_GT(lit, 20000);
    }
}

/// The mean of what samples bring to a surface (or, without a normal, of radiance), and
/// the same by directions uniform over the sphere.
struct Estimates {
    test::Moments drawn, uniform;
};
Estimates estimates(const EnvironmentLight& light, const std::vector<Texture>& textures,
                    const Vec3f& normal) {
    Estimates e;
    Rng rng(118);
    const auto brings = [&](const Vec3f& d) {
        const float cosine = has_normal(normal) ? max(dot(d, normal), 0.0f) : 1.0f;
        return luminance(environment_radiance(light, textures, sky_point(light, d))) *
               cosine;
    };
    for (int i = 0; i < samples; ++i) {
        float density;
        const Vec3f d =
            sample_environment(light, normal, rng.unit(), rng.unit(), rng.unit(), density)
                .direction;
        e.drawn.add(density > 0.0f ? brings(d) / density : 0.0f);
        e.uniform.add(brings(test::random_direction(rng)) * 4 * pi);
    }
    return e;
}

TEST(EnvironmentLight, ImportanceSamplingKeepsTheIntegral) {
    const auto textures = spotted_map();
    EnvironmentLight light = sky(textures);
    light.world_from_light = frame_of_normal(normalize(Vec3f(2, -1, 3)));
    for (const Vec3f& normal : normals()) {
        const Estimates e = estimates(light, textures, normal);
        const double error =
            std::hypot(e.drawn.standard_error(), e.uniform.standard_error());
        EXPECT_GT(test::normal_two_sided((e.drawn.mean() - e.uniform.mean()) / error),
                  test::sidak(normals().size()));
    }
    // It is worth its cost: the hot texel no longer makes the noise.
    const Estimates e = estimates(sky(textures), textures, Vec3f(0.0f));
    EXPECT_LT(e.drawn.standard_error(), 0.25 * e.uniform.standard_error());
}

TEST(EnvironmentLight, SurfacesWasteLittleOnLightBehindThem) {
    // Nearly all light comes from one texel of a map; surfaces that face away from it
    // look elsewhere, and of an even sky they see the half above.
    const auto textures = maps()[2];
    const EnvironmentLight light = sky(textures);
    const Vec3f sun = direction_of_uv(Vec2f{90.5f / 128, 20.5f / 64});
    const auto share_above = [&](const Vec3f& normal) {
        Rng rng(119);
        int above = 0;
        for (int i = 0; i < 10000; ++i) {
            float density;
            const Vec3f d = sample_environment(light, normal, rng.unit(), rng.unit(),
                                               rng.unit(), density)
                                .direction;
            above += dot(d, normal) > 0.0f;
        }
        return above / 10000.0;
    };
    EXPECT_GT(share_above(sun), 0.98);
    EXPECT_GT(share_above(-sun), 0.6);
}

TEST(EnvironmentLight, MapIsLaidOutAsItsSceneSays) {
    // The middle of the map is at -z turned half round: u = atan2(x, -z) / 2 pi.
    const auto expect_uv = [](const Vec3f& d, float u, float v) {
        const Vec2f uv = uv_of_direction(d);
        EXPECT_NEAR(uv.x, u, 1e-6f);
        EXPECT_NEAR(uv.y, v, 1e-6f);
        EXPECT_LT(length(direction_of_uv(Vec2f{u, v}) - d), 2e-6f);
    };
    expect_uv({0, 0, -1}, 0.0f, 0.5f);
    expect_uv({1, 0, 0}, 0.25f, 0.5f);
    expect_uv({0, 0, 1}, 0.5f, 0.5f);
    expect_uv({-1, 0, 0}, 0.75f, 0.5f);
    EXPECT_NEAR(uv_of_direction(Vec3f(0, 1, 0)).y, 0.0f, 1e-6f);
    EXPECT_NEAR(uv_of_direction(Vec3f(0, -1, 0)).y, 1.0f, 1e-6f);
}

}  // namespace
}  // namespace raykiln
