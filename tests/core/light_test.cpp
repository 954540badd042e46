#include "light/light.h"

#include <gtest/gtest.h>

#include "accel/sphere_geometry.h"
#include "sampling/spherical.h"
#include "shapes.h"

// Lights: directions drawn against their density, radiance and position against closed
// forms.

namespace raykiln {
namespace {

using test::Rng;

constexpr int samples = 1000000;
constexpr std::size_t tests = 9;

Scene lit_scene() {
    Scene scene;
    scene.emissions.push_back({ColorSlot{{3, 2, 1}}, false});
    scene.emissions.push_back({ColorSlot{{3, 2, 1}}, true});
    test::add_white(scene);
    return scene;
}

TriangleLight triangle_light() {
    TriangleLight t{};
    t.p0 = {-0.5f, -0.8f, 0.6f};
    t.edge1 = {1.4f, 0.1f, 0.2f};
    t.edge2 = {0.3f, 1.2f, -0.3f};
    const Vec3f n = cross(t.edge1, t.edge2);
    t.area = 0.5f * length(n);
    t.normal = normalize(n);
    t.uv0 = {0, 0};
    t.uv1 = {1, 0};
    t.uv2 = {0, 1};
    return t;
}

/// Distance along a ray to a triangle light, or negative.
float distance_to(const TriangleLight& t, const Vec3f& p, const Vec3f& d) {
    const Vec3f q = cross(d, t.edge2), s = p - t.p0, r = cross(s, t.edge1);
    const float det = dot(t.edge1, q);
    const float u = dot(s, q) / det, v = dot(d, r) / det;
    return u >= 0 && v >= 0 && u + v <= 1 ? dot(t.edge2, r) / det : -1.0f;
}

/// Chi-squared of the directions that a light draws towards p, binned about +z.
/// `pdf(direction)` is the density that is promised.
template <class Pdf, class Turn>
void expect_density(const Light& light, const Vec3f& p, const Pdf& pdf, const Turn& turn,
                    std::uint64_t seed) {
    const Scene scene = lit_scene();
    auto expected = test::integrate_over_bins(pdf, 8);
    const double mass = std::accumulate(expected.begin(), expected.end(), 0.0);
    // Edges of the density: 1/256 of the bins along them, of some 200 bins.
    EXPECT_NEAR(mass, 1.0, 2e-3);
    std::vector<double> observed(expected.size());
    Rng rng(seed);
    for (int i = 0; i < samples; ++i) {
        const LightSample s = sample_light(scene, light, {p}, rng.unit(), rng.unit(), 0);
        ASSERT_GT(s.pdf_solid_angle, 0.0f);
        observed[test::bin_of(turn(s.direction))] += 1;
    }
    for (double& e : expected) {
        e *= samples / mass;
    }
    const auto result = test::chi_squared_test(observed, expected);
    EXPECT_GT(result.p_value, test::sidak(tests)) << result;
}

const auto as_is = [](const Vec3f& d) { return d; };

TEST(TriangleLight, DirectionsFollowTheDensity) {
    const TriangleLight t = triangle_light();
    // From close by, from the side, and from behind.
    const Vec3f points[] = {{0, 0, 0.2f}, {0.9f, 0.5f, 0.1f}, {0.2f, 0.1f, 1.5f}};
    for (const Vec3f& p : points) {
        const auto pdf = [&](const Vec3f& d) {
            const float distance = distance_to(t, p, d);
            return distance > 0.0f ? pdf_light(t, p, d, distance) : 0.0f;
        };
        expect_density(t, p, pdf, as_is, 111);
    }
}

/// The same triangle twice, the second time turned round.
ParallelogramLight parallelogram_light() {
    return {triangle_light()};
}
TriangleLight other_half(const ParallelogramLight& l) {
    TriangleLight t = l.half;
    t.p0 = l.half.p0 + l.half.edge1 + l.half.edge2;
    t.edge1 = -l.half.edge1;
    t.edge2 = -l.half.edge2;
    return t;
}

TEST(ParallelogramLight, DirectionsFollowTheDensity) {
    const ParallelogramLight l = parallelogram_light();
    const TriangleLight other = other_half(l);
    const Vec3f points[] = {{0, 0, 0.2f}, {0.9f, 0.5f, 0.1f}, {0.2f, 0.1f, 1.5f}};
    for (const Vec3f& p : points) {
        const auto pdf = [&](const Vec3f& d) {
            const float distance =
                max(distance_to(l.half, p, d), distance_to(other, p, d));
            return distance > 0.0f ? pdf_light(l, p, d, distance) : 0.0f;
        };
        expect_density(l, p, pdf, as_is, 112);
    }
}

TEST(SphereLight, DirectionsFollowTheDensity) {
    const SphereLight s{{0.3f, -0.2f, 0.5f}, 0.8f, false, 1};
    // From outside far and near, and from within off the centre.
    const Vec3f points[] = {{3, 0, 0}, {0.3f, -0.2f, -0.4f}, {0.1f, 0.2f, 0.3f}};
    for (const Vec3f& p : points) {
        const auto pdf = [&](const Vec3f& d) {
            const double t = intersect_sphere(p, d, 0, 1e30, s.center, s.radius);
            return t > 0 ? pdf_light(s, p, d, static_cast<float>(t)) : 0.0f;
        };
        expect_density(s, p, pdf, as_is, 112);
    }
}

// Points, radiance and irradiance.

TEST(SurfaceLight, SamplesLieOnTheLight) {
    const Scene scene = lit_scene();
    const TriangleLight t = triangle_light();
    const SphereLight s{{0.3f, -0.2f, 0.5f}, 0.8f, false, 1};
    const Vec3f points[] = {{0, 0, -1}, {2, 1, 0.3f}, {0.2f, -0.1f, 0.4f}};
    Rng rng(119);
    for (const Vec3f& p : points) {
        for (int i = 0; i < 20000; ++i) {
            const LightSample on_t =
                sample_light(scene, t, {p}, rng.unit(), rng.unit(), 0);
            const LightSample on_s =
                sample_light(scene, s, {p}, rng.unit(), rng.unit(), 0);
            for (const LightSample& l : {on_t, on_s}) {
                ASSERT_NEAR(length(l.direction), 1.0f, 1e-6f);
                // Moved off by 64 ulp of coordinates up to 3.
                const float distance = length(l.point - p);
                ASSERT_LT(length(p + l.direction * distance - l.point), 1e-4f);
                ASSERT_FALSE(l.infinite || l.delta);
            }
            ASSERT_NEAR(dot(on_t.point - t.p0, t.normal), 0.0f, 3e-5f);
            ASSERT_NEAR(length(on_s.point - s.center), s.radius, 3e-5f);
            // The point is on p's side of its surface: nothing of the light is in
            // between.
            ASSERT_GE(dot(on_t.point - t.p0, t.normal) * dot(p - t.p0, t.normal), 0.0f);
            // The densities agree away from grazing directions, where distance cancels.
            const float cosine = std::fabs(dot(on_t.direction, t.normal));
            if (cosine > 0.05f) {
                const float pdf = pdf_light(t, p, on_t.direction, length(on_t.point - p));
                ASSERT_NEAR(pdf / on_t.pdf_solid_angle, 1.0f, 2e-3f);
            }
        }
    }
}

TEST(SurfaceLight, NearAndFarItsSamplesMeasureItsSolidAngle) {
    const Scene scene = lit_scene();
    const TriangleLight t = triangle_light();
    const ParallelogramLight q = parallelogram_light();
    Rng rng(120);
    // Less and more than where lights begin to look small, at 30.
    for (const float distance : {3.0f, 12.0f, 28.0f, 34.0f, 60.0f, 400.0f}) {
        const Vec3f p = t.p0 - normalize(Vec3f(0.3f, -0.2f, 1.0f)) * distance;
        const double solid_t =
            make_spherical_triangle(t.p0 - p, t.edge1, t.edge2).solid_angle;
        const double solid_q =
            make_spherical_parallelogram(t.p0 - p, t.edge1, t.edge2).solid_angle;
        constexpr int n = 20000;
        double sum_t = 0, sum_q = 0;
        for (int i = 0; i < n; ++i) {
            const float u = rng.unit(), v = rng.unit();
            const LightSample on_t = sample_light(scene, t, {p}, u, v, 0);
            const LightSample on_q = sample_light(scene, q, {p}, u, v, 0);
            sum_t += 1 / on_t.pdf_solid_angle;
            sum_q += 1 / on_q.pdf_solid_angle;
            const float pdf_t = pdf_light(t, p, on_t.direction, length(on_t.point - p));
            const float pdf_q = pdf_light(q, p, on_q.direction, length(on_q.point - p));
            ASSERT_NEAR(pdf_t / on_t.pdf_solid_angle, 1.0f, 2e-3f) << distance;
            ASSERT_NEAR(pdf_q / on_q.pdf_solid_angle, 1.0f, 2e-3f) << distance;
        }
        EXPECT_NEAR(sum_t / n / solid_t, 1.0, 2e-3) << distance;
        EXPECT_NEAR(sum_q / n / solid_q, 1.0, 2e-3) << distance;
    }
}

TEST(SurfaceLight, EmitsToItsFrontUnlessTwoSided) {
    const Scene scene = lit_scene();
    TriangleLight t = triangle_light();
    const Vec3f middle = t.p0 + (t.edge1 + t.edge2) * 0.3f;
    const Vec3f front = middle + t.normal, back = middle - t.normal;
    EXPECT_EQ(sample_light(scene, t, {front}, 0.3f, 0.3f, 0).radiance.x, 3.0f);
    EXPECT_EQ(sample_light(scene, t, {back}, 0.3f, 0.3f, 0).radiance.x, 0.0f);
    t.emission = 1;
    EXPECT_EQ(sample_light(scene, t, {back}, 0.3f, 0.3f, 0).radiance.x, 3.0f);
    SphereLight s{{0, 0, 0}, 1.0f, false, 0};
    EXPECT_EQ(sample_light(scene, s, {{0, 0, 3}}, 0.3f, 0.3f, 0).radiance.y, 2.0f);
    EXPECT_EQ(sample_light(scene, s, {{0, 0, 0.5f}}, 0.3f, 0.3f, 0).radiance.y, 0.0f);
    s.inward = true;
    EXPECT_EQ(sample_light(scene, s, {{0, 0, 3}}, 0.3f, 0.3f, 0).radiance.y, 0.0f);
    EXPECT_EQ(sample_light(scene, s, {{0, 0, 0.5f}}, 0.3f, 0.3f, 0).radiance.y, 2.0f);
}

/// Irradiance of a light on a surface element, by its own sampling.
test::Moments irradiance(const Light& light, const Vec3f& p, const Vec3f& normal,
                         std::uint64_t seed) {
    const Scene scene = lit_scene();
    Rng rng(seed);
    test::Moments e;
    for (int i = 0; i < samples; ++i) {
        const LightSample s = sample_light(scene, light, {p}, rng.unit(), rng.unit(), 0);
        const float cosine = max(dot(s.direction, normal), 0.0f);
        e.add(s.pdf_solid_angle > 0.0f ? s.radiance.x * cosine / s.pdf_solid_angle : 0.0);
    }
    return e;
}

TEST(SurfaceLight, IrradianceOfASphere) {
    // pi L (r / d)^2 cos, where all of it is above the horizon.
    const SphereLight s{{0, 0, 4}, 1.5f, false, 0};
    const double exact = test::tau / 2 * 3 * 1.5 * 1.5 / 16;
    EXPECT_GT(irradiance(s, {0, 0, 0}, {0, 0, 1}, 120).p_value_of_mean(exact), 0.005);
    const Vec3f tilted(std::sin(0.7f), 0, std::cos(0.7f));
    EXPECT_GT(
        irradiance(s, {0, 0, 0}, tilted, 121).p_value_of_mean(exact * std::cos(0.7)),
        0.005);
    // From within, everything above is light: pi L.
    const SphereLight around{{0.3f, 0, 0}, 2.0f, true, 0};
    EXPECT_GT(
        irradiance(around, {0, 0, 0}, {0, 0, 1}, 122).p_value_of_mean(1.5 * test::tau),
        0.01);
}

TEST(SurfaceLight, ParallelogramIsItsTriangles) {
    const ParallelogramLight l = parallelogram_light();
    const Vec3f points[] = {{0, 0, -1}, {2, 1, 0.3f}, {400, -300, -900}};
    for (const Vec3f& p : points) {
        const Vec3f toward = normalize(l.half.p0 - p);
        Light lights[] = {l, l.half, other_half(l)};
        test::Moments e[3];
        for (std::uint64_t i = 0; i < 3; ++i) {
            std::visit(
                [](auto& light) {
                    if constexpr (std::is_same_v<std::decay_t<decltype(light)>,
                                                 ParallelogramLight>) {
                        light.half.emission = 1;
                    } else if constexpr (std::is_same_v<std::decay_t<decltype(light)>,
                                                        TriangleLight>) {
                        light.emission = 1;
                    }
                },
                lights[i]);
            e[i] = irradiance(lights[i], p, toward, 130 + i);
        }
        const double parts = e[1].mean() + e[2].mean();
        EXPECT_NEAR(e[0].mean() / parts, 1.0, 3e-3) << p.x;
    }
}

TEST(SurfaceLight, IrradianceOfATriangle) {
    // Lambert's formula: half the sum over the edges of their angle times their normal.
    const TriangleLight t = triangle_light();
    const Vec3f p(0.1f, -0.1f, -0.5f), normal(0, 0, 1);
    const Vec3f corners[] = {t.p0 - p, t.p0 + t.edge1 - p, t.p0 + t.edge2 - p};
    double sum = 0;
    for (int i = 0; i < 3; ++i) {
        const Vec3f a = normalize(corners[i]), b = normalize(corners[(i + 1) % 3]);
        sum += std::acos(double(dot(a, b))) * dot(normalize(cross(a, b)), normal);
    }
    TriangleLight two_sided = t;
    two_sided.emission = 1;
    const auto e = irradiance(two_sided, p, normal, 123);
    EXPECT_GT(e.p_value_of_mean(0.5 * 3 * std::fabs(sum)), 0.01);
}

TEST(DeltaLight, InverseSquareAndCones) {
    const Scene scene = lit_scene();
    const PointLight point{{0, 0, 2}, {8, 4, 2}};
    const LightSample a = sample_light(scene, point, {{0, 0, 0}}, 0.5f, 0.5f, 0);
    EXPECT_FLOAT_EQ(a.radiance.x, 2.0f);
    EXPECT_EQ(a.direction.z, 1.0f);
    EXPECT_TRUE(a.delta);
    EXPECT_EQ(sample_light(scene, point, {{0, 0, 2}}, 0.5f, 0.5f, 0).radiance.x, 0.0f);

    const SpotLight spot{{0, 0, 2}, {0, 0, -1}, {8, 8, 8}, 0.95f, 0.9f};
    EXPECT_FLOAT_EQ(sample_light(scene, spot, {{0, 0, 0}}, 0, 0, 0).radiance.x, 2.0f);
    EXPECT_EQ(sample_light(scene, spot, {{0, 0, 4}}, 0, 0, 0).radiance.x, 0.0f);
    // At a cosine of 0.925, half-way between the cones: the falloff is 1/2 squared.
    const float aside = 2.0f * std::sqrt(1 / (0.925f * 0.925f) - 1);
    const auto edge = sample_light(scene, spot, {{aside, 0, 0}}, 0, 0, 0);
    EXPECT_NEAR(edge.radiance.x, 0.25f * 8 / (4 + aside * aside), 1e-4f);

    const DirectionalLight sun{{0, -1, 0}, {5, 5, 5}};
    const auto noon = sample_light(scene, sun, {{9, 9, 9}}, 0, 0, 0);
    EXPECT_TRUE(noon.infinite && noon.delta);
    EXPECT_EQ(noon.direction.y, 1.0f);
    EXPECT_EQ(noon.radiance.x, 5.0f);
}

}  // namespace
}  // namespace raykiln
