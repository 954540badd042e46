#include "math/elementary.h"

#include <gtest/gtest.h>

#include "math/frame.h"
#include "math/transform.h"
#include "statistics.h"

// The functions of math/ against the C library in double precision. The bounds are those
// that math/elementary.h states.

namespace raykiln {
namespace {

using test::Rng;

TEST(Elementary, SineAndCosineOfTurns) {
    Rng rng(1);
    double worst = 0;
    for (int i = 0; i < 1000000; ++i) {
        // Large arguments are exact in turns: only their fraction counts.
        const float x =
            i % 2 == 0 ? rng.between(-2.0f, 2.0f) : rng.between(-1000.0f, 1000.0f);
        float sine, cosine;
        sin_cos_turns(x, sine, cosine);
        const double turn = std::fmod(static_cast<double>(x), 1.0) * 6.283185307179586;
        worst = std::max({worst, std::fabs(sine - std::sin(turn)),
                          std::fabs(cosine - std::cos(turn))});
    }
    EXPECT_LT(worst, 2e-7);
}

TEST(Elementary, SineAndCosineAreExactAtQuarterTurns) {
    const float expected_sine[] = {0, 1, 0, -1}, expected_cosine[] = {1, 0, -1, 0};
    for (int quarter = -8; quarter <= 8; ++quarter) {
        float sine, cosine;
        sin_cos_turns(static_cast<float>(quarter) * 0.25f, sine, cosine);
        EXPECT_EQ(sine, expected_sine[quarter & 3]) << quarter;
        EXPECT_EQ(cosine, expected_cosine[quarter & 3]) << quarter;
    }
}

TEST(Elementary, ArcTangentOfTwo) {
    Rng rng(2);
    double worst = 0;
    for (int i = 0; i < 1000000; ++i) {
        const float scale = std::exp2(rng.between(-30.0f, 30.0f));
        const float y = rng.between(-1.0f, 1.0f) * scale;
        const float x = rng.between(-1.0f, 1.0f) * scale;
        const double exact = std::atan2(static_cast<double>(y), static_cast<double>(x));
        worst = std::max(worst, std::fabs(atan2(y, x) - exact));
    }
    EXPECT_LT(worst, 1e-6);
    EXPECT_EQ(atan2(0.0f, 0.0f), 0.0f);
    EXPECT_EQ(atan2(0.0f, 1.0f), 0.0f);
    EXPECT_EQ(atan2(0.0f, -1.0f), pi);
    EXPECT_EQ(atan2(1.0f, 0.0f), 0.5f * pi);
    EXPECT_EQ(atan2(-1.0f, 0.0f), -0.5f * pi);
}

TEST(Elementary, ArcCosine) {
    double worst = 0;
    for (int i = -1000000; i <= 1000000; ++i) {
        const float x = static_cast<float>(i) * 1e-6f;
        worst = std::max(worst, std::fabs(acos(x) - std::acos(static_cast<double>(x))));
    }
    // The error of atan2, and of pi in float.
    EXPECT_LT(worst, 1.2e-6);
    EXPECT_EQ(acos(1.0f), 0.0f);
    EXPECT_EQ(acos(1.5f), 0.0f);
    EXPECT_NEAR(acos(-1.5f), pi, 1e-6f);
}

TEST(Elementary, Logarithm) {
    Rng rng(3);
    double worst = 0;
    for (int i = 0; i < 1000000; ++i) {
        const float x = i % 2 == 0 ? std::exp2(rng.between(-120.0f, 120.0f))
                                   : rng.between(0.5f, 2.0f);
        const double exact = std::log(static_cast<double>(x));
        const double gap = std::fabs(log(x) - exact);
        worst = std::max(worst, exact == 0 ? gap : gap / std::fabs(exact));
    }
    EXPECT_LT(worst, 1e-6);
    EXPECT_EQ(log(1.0f), 0.0f);
}

TEST(Elementary, Exponential) {
    Rng rng(4);
    double worst = 0;
    for (int i = 0; i < 1000000; ++i) {
        const float x = rng.between(-86.5f, 87.5f);
        const double exact = std::exp(static_cast<double>(x));
        worst = std::max(worst, std::fabs(exp(x) - exact) / exact);
    }
    EXPECT_LT(worst, 1e-6);
    EXPECT_EQ(exp(0.0f), 1.0f);
    EXPECT_EQ(exp(-88.0f), 0.0f);
    EXPECT_EQ(exp(-infinity), 0.0f);
    EXPECT_TRUE(std::isfinite(exp(1000.0f)));
}

TEST(Elementary, NumberIsMantissaTimesPowerOfTwo) {
    Rng rng(5);
    for (int i = 0; i < 100000; ++i) {
        const float x = std::exp2(rng.between(-125.0f, 126.0f));
        float exponent;
        const float mantissa = split_exponent(x, exponent);
        ASSERT_GE(mantissa, 0.70710670f);
        ASSERT_LT(mantissa, 1.4142137f);
        ASSERT_EQ(exponent, std::floor(exponent));
        ASSERT_EQ(std::ldexp(mantissa, static_cast<int>(exponent)), x);
    }
    for (int n = -126; n <= 127; ++n) {
        EXPECT_EQ(exp2_integral(static_cast<float>(n)), std::ldexp(1.0f, n));
    }
}

TEST(Elementary, BitsBecomeNumbersBelowOne) {
    EXPECT_EQ(unit_from_bits(0u), 0.0f);
    EXPECT_EQ(unit_from_bits(0x80000000u), 0.5f);
    EXPECT_EQ(unit_from_bits(0xffffffffu), 1.0f - 0x1p-24f);
    EXPECT_LE(unit_from_bits(0xffffffffu), one_minus_epsilon);
}

Vec3f random_unit(Rng& rng) {
    Vec3f v;
    do {
        v = {rng.between(-1, 1), rng.between(-1, 1), rng.between(-1, 1)};
    } while (length_squared(v) > 1.0f || length_squared(v) < 1e-3f);
    return normalize(v);
}

// A product of two unit vectors' components has an error of half an ulp of 1 = 6e-8; a
// dot product adds three, of vectors that are themselves unit to 2 ulp.
constexpr float frame_tolerance = 1e-6f;

void expect_orthonormal(const Frame<float>& f) {
    EXPECT_NEAR(length(f.s), 1.0f, frame_tolerance);
    EXPECT_NEAR(length(f.t), 1.0f, frame_tolerance);
    EXPECT_NEAR(dot(f.s, f.t), 0.0f, frame_tolerance);
    EXPECT_NEAR(dot(f.s, f.n), 0.0f, frame_tolerance);
    EXPECT_NEAR(dot(f.t, f.n), 0.0f, frame_tolerance);
    EXPECT_GT(dot(cross(f.s, f.t), f.n), 0.0f);
}

TEST(Frame, OrthonormalForEveryNormal) {
    Rng rng(6);
    for (int i = 0; i < 20000; ++i) {
        expect_orthonormal(frame_of_normal(random_unit(rng)));
    }
    for (const float z : {1.0f, -1.0f}) {
        expect_orthonormal(frame_of_normal(Vec3f(0, 0, z)));
        expect_orthonormal(frame_of_normal(normalize(Vec3f(1e-6f, -1e-7f, z))));
        expect_orthonormal(frame_of_normal(normalize(Vec3f(1e-3f, 1e-3f, z))));
    }
}

TEST(Frame, FirstAxisFollowsTheTangent) {
    Rng rng(7);
    for (int i = 0; i < 20000; ++i) {
        const Vec3f n = random_unit(rng);
        const Vec3f tangent = random_unit(rng) * std::exp2(rng.between(-20.0f, 20.0f));
        if (std::fabs(dot(n, tangent)) > 0.9f * length(tangent)) {
            continue;  // taking a component away costs digits there
        }
        const Frame<float> f = frame_of_normal_and_tangent(n, tangent);
        expect_orthonormal(f);
        EXPECT_GT(dot(f.s, tangent), 0.0f);
        EXPECT_NEAR(dot(f.t, tangent) / length(tangent), 0.0f, 3 * frame_tolerance);
    }
    const Vec3f n(0, 1, 0);
    expect_orthonormal(frame_of_normal_and_tangent(n, Vec3f(0, 0, 0)));
    expect_orthonormal(frame_of_normal_and_tangent(n, Vec3f(0, 3, 0)));
}

TEST(Frame, LocalAndWorldAreInverse) {
    Rng rng(8);
    for (int i = 0; i < 20000; ++i) {
        const Frame<float> f = frame_of_normal(random_unit(rng));
        const Vec3f v = random_unit(rng);
        EXPECT_LT(length(f.to_world(f.to_local(v)) - v), 2 * frame_tolerance);
        EXPECT_LT(length(f.to_local(f.n) - Vec3f(0, 0, 1)), 2 * frame_tolerance);
    }
}

TEST(Transform, NormalsStayPerpendicularToTheirSurface) {
    Rng rng(9);
    for (int i = 0; i < 20000; ++i) {
        const Transform m{random_unit(rng) * rng.between(0.1f, 3.0f),
                          random_unit(rng) * rng.between(0.1f, 3.0f),
                          random_unit(rng) * rng.between(0.1f, 3.0f),
                          {1, 2, 3}};
        const Vec3f a = random_unit(rng), b = random_unit(rng);
        const Vec3f n = m.normal(cross(a, b));
        // A sum of products of numbers of size |n| |m a|, rounded a handful of times
        // each.
        const float tolerance = 1e-5f * (length(m.x) + length(m.y) + length(m.z)) *
                                (length(m.x) + length(m.y) + length(m.z)) *
                                (length(m.x) + length(m.y) + length(m.z));
        EXPECT_NEAR(dot(n, m.vector(a)), 0.0f, tolerance);
        EXPECT_NEAR(dot(n, m.vector(b)), 0.0f, tolerance);
        // On the side that points of the normal's side go to.
        const float side = dot(n, m.vector(cross(a, b)));
        EXPECT_GT(side, -tolerance);
    }
}

TEST(Transform, InverseOfTheLinearPart) {
    Rng rng(10);
    for (int i = 0; i < 20000; ++i) {
        const Transform m{
            random_unit(rng), random_unit(rng), random_unit(rng), {1, 2, 3}};
        if (std::fabs(m.determinant()) < 0.1f) {
            continue;
        }
        const Vec3f v = random_unit(rng);
        // The determinant of unit columns bounds the condition by about 1 / 0.1.
        EXPECT_LT(length(inverse_linear(m).vector(m.vector(v)) - v), 1e-5f);
    }
}

TEST(Transform, RowsOfAMatrix) {
    const float rows[] = {1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12};
    const Vec3f p = transform_of_rows(rows).point({1, 10, 100});
    EXPECT_EQ(p.x, 1 + 20 + 300 + 4);
    EXPECT_EQ(p.y, 5 + 60 + 700 + 8);
    EXPECT_EQ(p.z, 9 + 100 + 1100 + 12);
}

}  // namespace
}  // namespace raykiln
