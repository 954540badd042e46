#include "camera/camera.h"

#include <gtest/gtest.h>

#include "directions.h"
#include "sampling/filter.h"

namespace raykiln {
namespace {

using test::Rng;

constexpr int samples = 1000000;

Camera wide_camera() {
    Camera c;
    c.origin = {1, 2, 3};
    c.tan_half_x = 0.8f;
    c.tan_half_y = 0.6f;
    return c;
}

TEST(Camera, LooksAlongItsAxes) {
    const Camera c = wide_camera();
    const Ray middle = camera_ray(c, 0.5f, 0.5f);
    EXPECT_EQ(middle.direction.z, -1.0f);
    EXPECT_EQ(middle.origin.y, 2.0f);
    // Left is -x, the top is +y.
    const Vec3f corner = camera_ray(c, 0.0f, 0.0f).direction;
    EXPECT_NEAR(corner.x / corner.z, 0.8f, 1e-6f);
    EXPECT_NEAR(corner.y / -corner.z, 0.6f, 1e-6f);
    EXPECT_NEAR(length(corner), 1.0f, 1e-6f);
    EXPECT_GT(camera_ray(c, 1.0f, 0.5f).direction.x, 0.0f);
}

TEST(Camera, TurnsWithItsFrame) {
    Camera c = wide_camera();
    c.world_from_camera = {{0, 0, 1}, {0, 1, 0}, {-1, 0, 0}};
    EXPECT_EQ(camera_ray(c, 0.5f, 0.5f).direction.x, 1.0f);
    EXPECT_GT(camera_ray(c, 1.0f, 0.5f).direction.z, 0.0f);
    EXPECT_FLOAT_EQ(view_depth(c, {6, 9, 9}), 5.0f);
}

TEST(Camera, PrincipalPointMovesTheImage) {
    Camera c = wide_camera();
    c.offset_x = 0.25f;
    c.offset_y = -0.125f;
    const Vec3f d = camera_ray(c, 0.75f, 0.375f).direction;
    EXPECT_NEAR(d.x, 0.0f, 1e-7f);
    EXPECT_NEAR(d.y, 0.0f, 1e-7f);
}

TEST(Camera, ClipPlanesArePlanes) {
    Camera c = wide_camera();
    c.near = 0.5f;
    c.far = 20.0f;
    Rng rng(141);
    for (int i = 0; i < 1000; ++i) {
        const Ray ray = camera_ray(c, rng.unit(), rng.unit());
        EXPECT_NEAR(view_depth(c, ray.origin + ray.direction * ray.t_near), 0.5f, 1e-5f);
        EXPECT_NEAR(view_depth(c, ray.origin + ray.direction * ray.t_far), 20.0f, 1e-4f);
    }
}

TEST(Camera, DirectionsOfAUniformImage) {
    // Even over the image is 1 / (A cos^3) over solid angle, A the image's area at
    // depth 1.
    const Camera c = wide_camera();
    const auto pdf = [&](const Vec3f& d) {
        // Bins are about +z: the camera looks along -z.
        const double depth = d.z;
        if (depth <= 0 || std::fabs(d.x / depth) > 0.8 || std::fabs(d.y / depth) > 0.6) {
            return 0.0;
        }
        return 1 / (4 * 0.8 * 0.6 * depth * depth * depth);
    };
    auto expected = test::integrate_over_bins(pdf, 8);
    const double mass = std::accumulate(expected.begin(), expected.end(), 0.0);
    EXPECT_NEAR(mass, 1.0, 2e-3);
    std::vector<double> observed(expected.size());
    Rng rng(142);
    for (int i = 0; i < samples; ++i) {
        const Vec3f d = camera_ray(c, rng.unit(), rng.unit()).direction;
        observed[test::bin_of({d.x, d.y, -d.z})] += 1;
    }
    for (double& e : expected) {
        e *= samples / mass;
    }
    const auto result = test::chi_squared_test(observed, expected);
    EXPECT_GT(result.p_value, 0.01) << result;
}

class EachFilter : public testing::TestWithParam<FilterKind> {};

INSTANTIATE_TEST_SUITE_P(Filter, EachFilter,
                         testing::Values(FilterKind::box, FilterKind::tent,
                                         FilterKind::gaussian,
                                         FilterKind::blackman_harris));

constexpr int filter_bins = 200;

/// The filter's mass in each bin, by the midpoint rule.
std::vector<double> filter_masses(const Filter& filter) {
    constexpr int steps = 64;
    std::vector<double> masses(filter_bins);
    const double width = 2.0 * filter.radius() / filter_bins;
    for (int b = 0; b < filter_bins; ++b) {
        for (int i = 0; i < steps; ++i) {
            const double x = -filter.radius() + width * (b + (i + 0.5) / steps);
            masses[static_cast<std::size_t>(b)] +=
                filter.density(static_cast<float>(x)) * width / steps;
        }
    }
    return masses;
}

TEST_P(EachFilter, DensityIntegratesToOne) {
    const auto masses = filter_masses(Filter(GetParam()));
    EXPECT_NEAR(std::accumulate(masses.begin(), masses.end(), 0.0), 1.0, 1e-5);
}

TEST_P(EachFilter, OffsetsFollowTheDensity) {
    const Filter filter(GetParam());
    auto expected = filter_masses(filter);
    for (double& e : expected) {
        e *= samples;
    }
    std::vector<double> observed(filter_bins);
    Rng rng(143);
    for (int i = 0; i < samples; ++i) {
        const float x = filter.offset(rng.unit());
        ASSERT_LE(std::fabs(x), filter.radius());
        const double place = (x / filter.radius() + 1) / 2;
        observed[std::min(static_cast<std::size_t>(place * filter_bins),
                          observed.size() - 1)] += 1;
    }
    const auto result = test::chi_squared_test(observed, expected);
    EXPECT_GT(result.p_value, test::sidak(4)) << result;
}

TEST_P(EachFilter, OffsetsGrowWithTheNumberDrawn) {
    const Filter filter(GetParam());
    float last = -filter.radius();
    for (int i = 0; i < 4096; ++i) {
        const float x = filter.offset((static_cast<float>(i) + 0.5f) / 4096);
        ASSERT_GE(x, last);
        // And the other way round on the other side.
        const float mirrored = filter.offset((4095.5f - static_cast<float>(i)) / 4096);
        ASSERT_NEAR(x, -mirrored, 2e-4f * filter.radius());
        last = x;
    }
    EXPECT_TRUE(std::isfinite(filter.offset(one_minus_epsilon)));
    EXPECT_EQ(filter.density(filter.radius() * 1.01f), 0.0f);
}

}  // namespace
}  // namespace raykiln
