#include "sampling/warp.h"

#include <gtest/gtest.h>

#include "directions.h"

// Maps from the unit square: chi-squared of 10^6 points against the density that each one
// states, over bins of equal probability.

namespace raykiln {
namespace {

using test::ChiSquared;
using test::Rng;
using test::UniformTally;

constexpr int samples = 1000000;
constexpr std::size_t side = 32;
constexpr std::size_t tests = 6;

std::size_t cell(double x, double y) {
    const auto index = [](double t) {
        return std::min(static_cast<std::size_t>(std::max(t, 0.0) * side), side - 1);
    };
    return index(y) * side + index(x);
}

double turn_of(double y, double x) {
    const double t = std::atan2(y, x) / test::tau;
    return t < 0 ? t + 1 : t;
}

/// `map(u, v)` gives the point's place in a unit square in which its density is 1.
template <class Map>
void expect_uniform(std::uint64_t seed, const Map& map) {
    Rng rng(seed);
    UniformTally tally(side * side);
    for (int i = 0; i < samples; ++i) {
        const float u = rng.unit(), v = rng.unit();
        const std::pair<double, double> at = map(u, v);
        tally.add_bin(cell(at.first, at.second));
    }
    const ChiSquared result = tally.test();
    EXPECT_GT(result.p_value, test::sidak(tests)) << result;
}

TEST(Warp, Disk) {
    expect_uniform(11, [](float u, float v) {
        const Vec2f p = sample_disk(u, v);
        const double r2 = double(p.x) * p.x + double(p.y) * p.y;
        EXPECT_LE(r2, 1 + 1e-6);
        return std::pair(r2, turn_of(p.y, p.x));
    });
}

TEST(Warp, CosineHemisphere) {
    expect_uniform(12, [](float u, float v) {
        const Vec3f d = sample_cosine_hemisphere(u, v);
        // The mass below a cosine c is c^2; 1 - z^2 is exact near the pole.
        return std::pair(double(d.x) * d.x + double(d.y) * d.y, turn_of(d.y, d.x));
    });
}

TEST(Warp, Sphere) {
    expect_uniform(13, [](float u, float v) {
        const Vec3f d = sample_sphere(u, v);
        return std::pair(0.5 * (1 - double(d.z)), turn_of(d.y, d.x));
    });
}

TEST(Warp, Cone) {
    for (const float width : {0.3f, 1.0f, 1.9f}) {
        expect_uniform(14, [width](float u, float v) {
            const Vec3f d = sample_cone(u, v, width);
            return std::pair((1 - double(d.z)) / width, turn_of(d.y, d.x));
        });
    }
}

TEST(Warp, Triangle) {
    expect_uniform(15, [](float u, float v) {
        const Vec2f b = sample_triangle(u, v);
        EXPECT_GE(b.x, 0.0f);
        EXPECT_GE(b.y, 0.0f);
        EXPECT_LE(b.x + b.y, 1.0f);
        // The share of the triangle with a smaller first coordinate, and within the line.
        const double x = b.x;
        return std::pair(1 - (1 - x) * (1 - x), x < 1 ? b.y / (1 - x) : 0.0);
    });
}

TEST(Warp, Tent) {
    constexpr float radius = 1.5f;
    expect_uniform(16, [](float u, float v) {
        const double x = sample_tent(u, radius) / radius;
        const double below =
            x < 0 ? 0.5 * (1 + x) * (1 + x) : 1 - 0.5 * (1 - x) * (1 - x);
        return std::pair(below, double(v));
    });
}

TEST(Warp, DirectionsAreUnitAndStayInTheirDomain) {
    Rng rng(17);
    for (int i = 0; i < 100000; ++i) {
        const float u = rng.unit(), v = rng.unit();
        // Rounding of sine, cosine (2e-7), root and products.
        constexpr float tolerance = 1e-6f;
        const Vec3f hemisphere = sample_cosine_hemisphere(u, v);
        ASSERT_NEAR(length(hemisphere), 1.0f, tolerance);
        ASSERT_GE(hemisphere.z, 0.0f);
        ASSERT_NEAR(length(sample_sphere(u, v)), 1.0f, tolerance);
        const Vec3f cone = sample_cone(u, v, 1e-4f);
        ASSERT_NEAR(length(cone), 1.0f, tolerance);
        ASSERT_GE(cone.z, 1.0f - 1e-4f - 1e-7f);
    }
}

TEST(Warp, CornersOfTheSquareAreFinite) {
    for (const float u : {0.0f, 0.5f, one_minus_epsilon}) {
        for (const float v : {0.0f, 0.5f, one_minus_epsilon}) {
            EXPECT_TRUE(is_finite(sample_cosine_hemisphere(u, v)));
            EXPECT_TRUE(is_finite(sample_sphere(u, v)));
            EXPECT_TRUE(is_finite(sample_cone(u, v, 0.5f)));
            EXPECT_TRUE(std::isfinite(sample_tent(u, 1.0f)));
        }
    }
}

TEST(Warp, NarrowConesKeepTheirShape) {
    // A sun, half a degree wide: cos rounds to 1 - 1e-5, the sine must not.
    const double half_angle = 0.00465;
    const auto width = static_cast<float>(2 * std::pow(std::sin(half_angle / 2), 2));
    Rng rng(18);
    UniformTally tally(64);
    for (int i = 0; i < samples; ++i) {
        const Vec3f d = sample_cone(rng.unit(), rng.unit(), width);
        const double sine2 = double(d.x) * d.x + double(d.y) * d.y;
        tally.add(sine2 / std::pow(std::sin(half_angle), 2));
    }
    // sin^2 is linear in 1 - cos up to a relative 1e-5 here.
    EXPECT_GT(tally.test().p_value, test::sidak(tests)) << tally.test();
}

TEST(Warp, AreaDensityToSolidAngle) {
    // A disk of radius 1 at height 2, from below its centre: its solid angle is
    // 2 pi (1 - cos), and the mean of 1 / density over its area is that solid angle.
    Rng rng(19);
    test::Moments inverse;
    for (int i = 0; i < 100000; ++i) {
        const Vec2f p = sample_disk(rng.unit(), rng.unit());
        const float distance2 = p.x * p.x + p.y * p.y + 4.0f;
        const float cosine = 2.0f / std::sqrt(distance2);
        inverse.add(1.0 / pdf_solid_angle_of_area(inv_pi, distance2, cosine));
    }
    const double exact = test::tau * (1 - 2 / std::sqrt(5.0));
    EXPECT_GT(inverse.p_value_of_mean(exact), 0.01);
}

TEST(Warp, MisWeightsOfTwoStrategiesAddToOne) {
    Rng rng(20);
    for (int i = 0; i < 10000; ++i) {
        const float a = std::exp2(rng.between(-60.0f, 60.0f));
        const float b = std::exp2(rng.between(-60.0f, 60.0f));
        ASSERT_NEAR(mis_weight(a, b) + mis_weight(b, a), 1.0f, 3e-7f);
    }
    EXPECT_EQ(mis_weight(1.0f, 0.0f), 1.0f);
    EXPECT_FLOAT_EQ(mis_weight(3.0f, 1.0f), 0.9f);
    EXPECT_FLOAT_EQ(mis_weight_of_light(3.0f, 1.0f) + mis_weight_of_bsdf(1.0f, 3.0f),
                    1.0f);
}

}  // namespace
}  // namespace raykiln
