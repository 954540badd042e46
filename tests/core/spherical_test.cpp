#include "sampling/spherical.h"

#include <gtest/gtest.h>

#include <array>

#include "statistics.h"

// Light sampling by solid angle: closed forms of solid angle and irradiance, chi-squared
// of the maps over pieces whose solid angles are computed in double precision, and
// inverses.

namespace raykiln {
namespace {

using test::ChiSquared;
using test::Rng;

constexpr double pi_d = 3.14159265358979323846;

using Point = std::array<double, 3>;

Point point_of(const Vec3f& v) {
    return {v.x, v.y, v.z};
}
Point minus(const Point& a, const Point& b) {
    return {a[0] - b[0], a[1] - b[1], a[2] - b[2]};
}
double dot_d(const Point& a, const Point& b) {
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}
Point cross_d(const Point& a, const Point& b) {
    return {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2],
            a[0] * b[1] - a[1] * b[0]};
}
double length_d(const Point& a) {
    return std::sqrt(dot_d(a, a));
}

/// Girard's theorem: the excess of the angles between the planes. Not the formula that is
/// under test.
double solid_angle_d(const Point& a, const Point& b, const Point& c) {
    const auto angle = [](const Point& at, const Point& from, const Point& to) {
        const Point n = cross_d(at, from), m = cross_d(at, to);
        return std::acos(
            std::clamp(dot_d(n, m) / (length_d(n) * length_d(m)), -1.0, 1.0));
    };
    return angle(a, b, c) + angle(b, c, a) + angle(c, a, b) - pi_d;
}

/// A flat figure seen from the origin: corner p0, edges e1, e2.
struct Figure {
    const char* name;
    Vec3f p0, e1, e2;

    Point at(double x, double y) const {
        const Point p = point_of(p0), a = point_of(e1), b = point_of(e2);
        return {p[0] + x * a[0] + y * b[0], p[1] + x * a[1] + y * b[1],
                p[2] + x * a[2] + y * b[2]};
    }
    /// Coordinates along the edges of the point that a direction meets.
    std::pair<double, double> place(const Vec3f& direction) const {
        const Point a = point_of(e1), b = point_of(e2), n = cross_d(a, b);
        const Point d = point_of(direction), p = point_of(p0);
        const double t = dot_d(p, n) / dot_d(d, n);
        const Point q = minus({d[0] * t, d[1] * t, d[2] * t}, p);
        return {dot_d(cross_d(q, b), n) / dot_d(n, n),
                dot_d(cross_d(a, q), n) / dot_d(n, n)};
    }
};

const std::array<Figure, 5> figures{{
    {"facing", {-0.5f, -0.4f, 1.0f}, {1.2f, 0.1f, 0.2f}, {0.2f, 1.1f, -0.1f}},
    {"small", {0.3f, 0.2f, 2.0f}, {0.02f, 0, 0.01f}, {0, 0.03f, 0}},
    {"thin", {-3.0f, 0.1f, 0.5f}, {6.0f, 0.02f, 0.1f}, {0.1f, 0.05f, 0}},
    {"grazing", {-1.0f, -1.0f, 0.05f}, {3.0f, 0, 0.01f}, {0, 2.5f, 0.02f}},
    {"far corner", {0.1f, 0.1f, -0.2f}, {20.0f, 1.0f, 0}, {-1.0f, 30.0f, 2.0f}},
}};

constexpr int grid = 16;
constexpr std::size_t chi_tests = 2 * figures.size();

struct Grid {
    std::vector<double> observed = std::vector<double>(2 * grid * grid);
    std::vector<double> expected = std::vector<double>(2 * grid * grid);

    /// Two triangles a square of the grid over the edges' coordinates.
    static std::size_t bin(double x, double y) {
        const double gx = std::clamp(x * grid, 0.0, grid - 1e-9),
                     gy = std::clamp(y * grid, 0.0, grid - 1e-9);
        const int i = static_cast<int>(gx), j = static_cast<int>(gy);
        const bool upper = (gx - i) + (gy - j) > 1;
        return static_cast<std::size_t>(2 * (j * grid + i) + (upper ? 1 : 0));
    }
    void expect(const Figure& f, bool triangle, double samples) {
        double total = 0;
        for (int j = 0; j < grid; ++j) {
            for (int i = 0; i < grid; ++i) {
                const auto corner = [&](int dx, int dy) {
                    return f.at(double(i + dx) / grid, double(j + dy) / grid);
                };
                const auto cell = static_cast<std::size_t>(2 * (j * grid + i));
                const bool low = !triangle || i + j < grid;
                const bool high = !triangle || i + j < grid - 1;
                expected[cell] =
                    low ? solid_angle_d(corner(0, 0), corner(1, 0), corner(0, 1)) : 0;
                expected[cell + 1] =
                    high ? solid_angle_d(corner(1, 0), corner(1, 1), corner(0, 1)) : 0;
                total += expected[cell] + expected[cell + 1];
            }
        }
        for (double& e : expected) {
            e *= samples / total;
        }
    }
};

constexpr int samples = 300000;

TEST(Spherical, TrianglesAreCoveredEvenly) {
    for (const Figure& f : figures) {
        const auto t = make_spherical_triangle(f.p0, f.e1, f.e2);
        ASSERT_TRUE(can_sample(t)) << f.name;
        Rng rng(31);
        Grid g;
        g.expect(f, true, samples);
        for (int i = 0; i < samples; ++i) {
            const float u = rng.unit(), v = rng.unit();
            const Vec3f d = sample_spherical_triangle(t, u, v);
            ASSERT_NEAR(length(d), 1.0f, 1e-6f);
            const auto [x, y] = f.place(d);
            ASSERT_GE(std::min(x, y), -1e-3) << f.name;
            ASSERT_LE(x + y, 1 + 1e-3) << f.name;
            g.observed[Grid::bin(x, std::min(y, 1 - x))] += 1;
        }
        const ChiSquared result = test::chi_squared_test(g.observed, g.expected);
        EXPECT_GT(result.p_value, test::sidak(chi_tests)) << f.name << ": " << result;
    }
}

TEST(Spherical, ParallelogramsAreCoveredEvenly) {
    for (const Figure& f : figures) {
        const auto s = make_spherical_parallelogram(f.p0, f.e1, f.e2);
        ASSERT_TRUE(can_sample(s)) << f.name;
        Rng rng(32);
        Grid g;
        g.expect(f, false, samples);
        for (int i = 0; i < samples; ++i) {
            const float u = rng.unit(), v = rng.unit();
            const auto [x, y] = f.place(sample_spherical_parallelogram(s, u, v));
            ASSERT_GE(std::min(x, y), -1e-3) << f.name;
            ASSERT_LE(std::max(x, y), 1 + 1e-3) << f.name;
            g.observed[Grid::bin(x, y)] += 1;
        }
        const ChiSquared result = test::chi_squared_test(g.observed, g.expected);
        EXPECT_GT(result.p_value, test::sidak(chi_tests)) << f.name << ": " << result;
    }
}

TEST(Spherical, SolidAnglesOfKnownFigures) {
    // An eighth of the sphere; a face of a cube seen from its middle.
    const auto octant = make_spherical_triangle<float>({2, 0, 0}, {-2, 2, 0}, {-2, 0, 2});
    EXPECT_NEAR(octant.solid_angle, 0.5f * pi, 2e-6f);
    const auto face =
        make_spherical_parallelogram<float>({-3, -3, 3}, {6, 0, 0}, {0, 6, 0});
    EXPECT_NEAR(face.solid_angle, 4.0f * pi / 6.0f, 4e-6f);
    // From very near: half of all directions.
    const auto near =
        make_spherical_parallelogram<float>({-1, -1, 1e-4f}, {2, 0, 0}, {0, 2, 0});
    EXPECT_NEAR(near.solid_angle, 2.0f * pi, 2e-3f);
}

TEST(Spherical, SmallSolidAnglesKeepTheirPrecision) {
    // Area times cosine over distance squared, over eight powers of ten.
    for (float size = 1e-1f; size > 1e-6f; size *= 0.1f) {
        const Vec3f p0{0.6f, 0.1f, 0.8f}, e1{size, 0, 0}, e2{0, 0, size};
        const double expected =
            solid_angle_d(point_of(p0), point_of(p0 + e1), point_of(p0 + e2));
        const double far = 0.5 * size * size * 0.1 / std::pow(1.01, 1.5);
        const auto t = make_spherical_triangle(p0, e1, e2);
        if (size > 1e-3f) {
            EXPECT_NEAR(t.solid_angle / expected, 1.0, 1e-5) << size;
        } else {
            EXPECT_NEAR(t.solid_angle / far, 1.0, 3e-3) << size;
        }
    }
}

/// Lambert's formula for the integral of the cosine to +z over a polygon above the
/// horizon.
double projected_solid_angle(const std::vector<Point>& corners) {
    double sum = 0;
    for (std::size_t i = 0; i < corners.size(); ++i) {
        const Point& a = corners[i];
        const Point& b = corners[(i + 1) % corners.size()];
        const Point n = cross_d(a, b);
        const double angle = std::atan2(length_d(n), dot_d(a, b));
        sum += 0.5 * angle * n[2] / length_d(n);
    }
    return std::fabs(sum);
}

TEST(Spherical, IrradianceOfAPolygonIsLamberts) {
    const Figure& f = figures[0];
    const auto t = make_spherical_triangle(f.p0, f.e1, f.e2);
    const auto s = make_spherical_parallelogram(f.p0, f.e1, f.e2);
    Rng rng(33);
    test::Moments triangle, parallelogram;
    for (int i = 0; i < samples; ++i) {
        const float u = rng.unit(), v = rng.unit();
        triangle.add(double(t.solid_angle) * sample_spherical_triangle(t, u, v).z);
        parallelogram.add(double(s.solid_angle) *
                          sample_spherical_parallelogram(s, u, v).z);
    }
    EXPECT_GT(triangle.p_value_of_mean(
                  projected_solid_angle({f.at(0, 0), f.at(1, 0), f.at(0, 1)})),
              test::sidak(2));
    EXPECT_GT(parallelogram.p_value_of_mean(projected_solid_angle(
                  {f.at(0, 0), f.at(1, 0), f.at(1, 1), f.at(0, 1)})),
              test::sidak(2));
}

TEST(Spherical, TheInverseFindsTheSquareAgain) {
    for (const Figure& f : {figures[0], figures[3], figures[4]}) {
        const auto t = make_spherical_triangle(f.p0, f.e1, f.e2);
        Rng rng(34);
        for (int i = 0; i < 10000; ++i) {
            const float u = rng.between(0.01f, 0.99f), v = rng.between(0.01f, 0.99f);
            const Vec2f back =
                invert_spherical_triangle(t, sample_spherical_triangle(t, u, v));
            ASSERT_NEAR(back.x, u, 1e-3f) << f.name;
            ASSERT_NEAR(back.y, v, 1e-3f) << f.name;
        }
    }
}

TEST(Spherical, NeighboursInTheSquareStayNeighbours) {
    // Also across the diagonal of the parallelogram: strata are not cut up.
    for (const Figure& f : figures) {
        const auto s = make_spherical_parallelogram(f.p0, f.e1, f.e2);
        Vec3f last = sample_spherical_parallelogram(s, 0.0f, 1.0f);
        constexpr int steps = 4096;
        for (int i = 1; i < steps; ++i) {
            const Vec3f next = sample_spherical_parallelogram(
                s, static_cast<float>(i) / steps, one_minus_epsilon);
            ASSERT_LT(length(next - last), 0.05f) << f.name << " at " << i;
            last = next;
        }
    }
}

TEST(Spherical, SpecksAndPointsInThePlaneAreRefused) {
    EXPECT_FALSE(can_sample(
        make_spherical_triangle<float>({0, 0, 100}, {0.01f, 0, 0}, {0, 0.01f, 0})));
    EXPECT_FALSE(
        can_sample(make_spherical_triangle<float>({1, 1, 0}, {1, 0, 0}, {0, 1, 0})));
    EXPECT_FALSE(
        can_sample(make_spherical_triangle<float>({-1, -1, 0}, {5, 0, 0}, {0, 5, 0})));
    EXPECT_FALSE(
        can_sample(make_spherical_triangle<float>({0, 0, 0}, {5, 0, 0}, {0, 5, 0})));
}

}  // namespace
}  // namespace raykiln
