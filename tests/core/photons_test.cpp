#include "integrator/photons.h"

#include <gtest/gtest.h>

#include "surfaces.h"

// Light that is sent at smooth surfaces: its power, and where it goes, against geometry.

namespace raykiln {
namespace {

using test::Rng;

constexpr float index_of_glass = 1.5f;
constexpr double pi_d = test::tau / 2;

/// A wide white floor at z = 0, and room for glass, material 1, above it.
Scene floor_scene() {
    Scene scene;
    test::add_white(scene);
    Material glass;
    DielectricMaterial dielectric;
    dielectric.eta = index_of_glass;
    dielectric.surface = {{0.0f}, {0.0f}, false};
    glass.kind = dielectric;
    glass.two_sided = false;
    scene.materials.push_back(glass);
    test::Triangles t;
    t.positions = {{-50, -50, 0}, {50, -50, 0}, {50, 50, 0}, {-50, 50, 0}};
    t.faces = {{0, 1, 2}, {0, 2, 3}};
    scene.groups[0].meshes.push_back(test::make_mesh(t));
    return scene;
}

/// Two wide faces of glass, as their edges are too far away to matter.
Mesh slab(float bottom, float top) {
    test::Triangles t;
    for (const float z : {bottom, top}) {
        t.positions.insert(t.positions.end(),
                           {{-40, -40, z}, {40, -40, z}, {40, 40, z}, {-40, 40, z}});
    }
    t.faces = {{0, 2, 1}, {0, 3, 2}, {4, 5, 6}, {4, 6, 7}};
    Mesh mesh = test::make_mesh(t);
    mesh.material = 1;
    return mesh;
}

Sphere ball(const Vec3f& center, float radius) {
    Sphere sphere;
    sphere.center = center;
    sphere.radius = radius;
    sphere.material = 1;
    return sphere;
}

/// What a ray leaves behind in many tries.
std::vector<Photon> photons_of(const Scene& scene, const Ray& ray, std::uint32_t tries) {
    const Accel accel(scene);
    const EstimatorSettings settings;
    std::vector<Photon> photons;
    for (std::uint32_t i = 0; i < tries; ++i) {
        RayCounts counts;
        const Context c{scene, accel, settings, {17, i}, counts};
        trace_photon(c, ray, photons);
    }
    return photons;
}

TEST(Photons, PassASlabInTheirDirection) {
    Scene scene = floor_scene();
    scene.groups[0].meshes.push_back(slab(2, 3));
    test::finish(scene);
    constexpr std::uint32_t tries = 1000;
    for (const double degrees : {0.0, 30.0, 70.0}) {
        const double angle = degrees * pi_d / 180;
        const double inside = std::asin(std::sin(angle) / index_of_glass);
        const Vec3f down = -test::direction_at(angle, 0.0);
        const auto photons = photons_of(scene, {Vec3f(0, 0, 5), down}, tries);
        ASSERT_LE(photons.size(), tries);
        std::uint32_t straight = 0;
        for (const Photon& photon : photons) {
            ASSERT_NEAR(photon.p.z, 0.0f, 1e-4f);
            ASSERT_LT(length(photon.direction + down), 1e-5f);
            // Reflected within the slab twice for each further two steps.
            const double steps =
                (-photon.p.x - 4 * std::tan(angle)) / std::max(std::tan(inside), 1e-9);
            straight += std::fabs(steps - 1) < 1e-3 || degrees == 0.0;
            const double odd = (steps - 1) / 2;
            ASSERT_TRUE(degrees == 0.0 || std::fabs(odd - std::round(odd)) < 1e-3);
        }
        EXPECT_GT(straight, tries / 4) << degrees;
        if (degrees > 0.0) {
            EXPECT_LT(straight, photons.size()) << degrees;
        }
    }
}

TEST(Photons, BendAtABallAsSnellSays) {
    Scene scene = floor_scene();
    scene.groups[0].spheres.push_back(ball({0, 0, 4}, 1));
    test::finish(scene);
    constexpr std::uint32_t tries = 1000;
    for (const double off : {0.0, 0.3, 0.8}) {
        const double theta = std::asin(off), inside = std::asin(off / index_of_glass);
        // Where it leaves, as an angle from straight down, and the angle that it is bent.
        const double leaves = 2 * inside - theta, bent = 2 * (theta - inside);
        const double x = std::sin(leaves) -
                         (4 - std::cos(leaves)) * std::tan(bent) * (off > 0 ? 1 : 0);
        const Ray ray{Vec3f(static_cast<float>(off), 0, 9), Vec3f(0, 0, -1)};
        std::uint32_t straight = 0;
        for (const Photon& photon : photons_of(scene, ray, tries)) {
            const Vec3f from(static_cast<float>(std::sin(bent)), 0,
                             static_cast<float>(std::cos(bent)));
            straight += std::fabs(photon.p.x - x) < 1e-3 &&
                        length(photon.direction - from) < 1e-4f;
        }
        EXPECT_GT(straight, tries / 4) << off;
    }
}

TEST(Photons, LightThatIsNotFocusedLeavesNone) {
    Scene scene = floor_scene();
    scene.groups[0].spheres.push_back(ball({0, 0, 4}, 1));
    test::finish(scene);
    EXPECT_TRUE(photons_of(scene, {Vec3f(3, 0, 9), Vec3f(0, 0, -1)}, 100).empty());
    EXPECT_TRUE(photons_of(scene, {Vec3f(3, 0, 9), Vec3f(0, 0, 1)}, 100).empty());
}

std::vector<Emitted> emit_many(const PhotonSource& source, std::uint32_t count) {
    std::vector<Emitted> rays(count);
    source.emit(23, 0, count, rays);
    return rays;
}

/// Mean power of rays, through both sides of what they are sent at.
test::Moments power_of(const std::vector<Emitted>& rays) {
    test::Moments power;
    for (const Emitted& e : rays) {
        power.add(e.power);
    }
    return power;
}

constexpr float lamp_radius = 0.5f, lamp_radiance = 3.0f;

void add_lamp(Scene& scene, const Vec3f& center) {
    scene.emissions.push_back({ColorSlot{Vec3f(lamp_radiance)}, 0});
    Sphere lamp = ball(center, lamp_radius);
    lamp.material = 0;
    lamp.emission = 0;
    scene.groups[0].spheres.push_back(lamp);
}

/// Between a lamp and a disk far away that faces it.
double flux(double area, double distance) {
    return lamp_radiance * pi_d * lamp_radius * lamp_radius * area /
           (distance * distance);
}

TEST(Photons, StandForThePowerThatReachesABall) {
    // As it is, and as an instance of twice the size.
    for (const bool instanced : {false, true}) {
        const float scale = instanced ? 2.0f : 1.0f;
        Scene scene = floor_scene();
        if (instanced) {
            scene.groups.emplace_back();
            scene.groups[1].spheres.push_back(ball(Vec3f(0.0f), 0.5f));
            const Transform t{{scale, 0, 0}, {0, scale, 0}, {0, 0, scale}, {0, 0, 2}};
            scene.instances.push_back(test::make_instance(1, t));
        } else {
            scene.groups[0].spheres.push_back(ball({0, 0, 2}, 1));
        }
        add_lamp(scene, {30, 0, 42});
        test::finish(scene);
        const PhotonSource source(scene);
        ASSERT_FALSE(source.empty());
        EXPECT_NEAR(source.area(), 4 * pi_d, 1e-4);
        const auto rays = emit_many(source, 100000);
        const test::Moments power = power_of(rays);
        const double expected = 2 * flux(pi_d, 50);
        EXPECT_NEAR(power.mean(), expected, 4 * power.standard_error() + 1e-3 * expected);
        for (const Emitted& e : rays) {
            const Vec3f from = e.ray.origin - Vec3f(30, 0, 42);
            ASSERT_NEAR(length(from), lamp_radius, 1e-3f);
            const Vec3f to = Vec3f(0, 0, 2) - e.ray.origin;
            const Vec3f off = to - e.ray.direction * dot(to, e.ray.direction);
            ASSERT_LT(length(off), 1 + 1e-3f);
        }
    }
}

TEST(Photons, StandForThePowerThatReachesMeshes) {
    Scene scene = floor_scene();
    test::Triangles small, large;
    small.positions = {{0, 0, 1}, {1, 0, 1}, {0, 1, 1}};
    small.faces = {{0, 1, 2}, {0, 0, 1}};  // the second has no area
    large.positions = {{1, 0, 1}, {3, 3, 1}, {0, 1, 1}};
    large.faces = {{0, 1, 2}};
    for (const test::Triangles& t : {small, large}) {
        Mesh mesh = test::make_mesh(t);
        mesh.material = 1;
        scene.groups[0].meshes.push_back(mesh);
    }
    add_lamp(scene, {1, 1, 101});
    test::finish(scene);
    const PhotonSource source(scene);
    EXPECT_NEAR(source.area(), 3.0, 1e-4);
    const test::Moments power = power_of(emit_many(source, 100000));
    const double expected = flux(3.0, 100);
    EXPECT_NEAR(power.mean(), expected, 4 * power.standard_error() + 2e-3 * expected);
}

TEST(Photons, NeedSmoothSurfacesAndLight) {
    Scene dark = floor_scene();
    dark.groups[0].spheres.push_back(ball({0, 0, 2}, 1));
    test::finish(dark);
    EXPECT_TRUE(PhotonSource(dark).empty());
    Scene dull = floor_scene();
    add_lamp(dull, {0, 0, 9});
    test::finish(dull);
    EXPECT_TRUE(PhotonSource(dull).empty());
}

TEST(Photons, AFlatSkyAndLightsWithoutSizeHaveNoPower) {
    Scene scene = floor_scene();
    scene.groups[0].spheres.push_back(ball({0, 0, 2}, 1));
    scene.lights.emplace_back(EnvironmentLight{});
    scene.lights.emplace_back(PointLight{{0, 0, 9}, Vec3f(1.0f)});
    scene.lights.emplace_back(DirectionalLight{{0, 0, -1}, Vec3f(1.0f)});
    test::finish(scene);
    const auto rays = emit_many(PhotonSource(scene), 1000);
    EXPECT_EQ(power_of(rays).mean(), 0.0);
    EXPECT_TRUE(equal_in_power(rays, 1000).empty());
}

/// A slab and a ball beside it, under a lamp.
Scene slab_and_ball() {
    Scene scene = floor_scene();
    scene.groups[0].meshes.push_back(slab(2, 3));
    scene.groups[0].spheres.push_back(ball({60, 0, 2}, 1));
    add_lamp(scene, {0, 0, 90});
    test::finish(scene);
    return scene;
}

TEST(Photons, AreSentInTheOrderOfTheirPlaces) {
    const Scene scene = slab_and_ball();
    const PhotonSource source(scene);
    const double of_ball = 4 * pi_d, of_slab = 2 * 80.0 * 80.0;
    EXPECT_NEAR(source.area(), of_slab + of_ball, 1e-2);
    const double last = of_slab / (of_slab + of_ball);
    constexpr std::size_t total = 1'000'000;
    for (const double place : {0.0, 0.3, 0.7, 0.99 * last, last + 1e-4, 0.99999}) {
        Emitted e;
        source.emit(23, static_cast<std::size_t>(place * total), total, {&e, 1});
        ASSERT_GT(e.power, 0.0f);
        // Where the ray crosses the slab's two faces, or the ball.
        const float z = place < 0.5 * last ? 2.0f : 3.0f;
        const Vec3f p =
            e.ray.origin + e.ray.direction * ((z - e.ray.origin.z) / e.ray.direction.z);
        EXPECT_EQ(std::fabs(p.x) < 40, place < last) << place;
    }
}

TEST(Photons, AreSentAloneAsAmongOthers) {
    const Scene scene = slab_and_ball();
    const PhotonSource source(scene);
    const auto together = emit_many(source, 1003);
    for (std::size_t i = 0; i < together.size(); ++i) {
        Emitted alone;
        source.emit(23, i, together.size(), {&alone, 1});
        EXPECT_EQ(alone.power, together[i].power);
        EXPECT_EQ(alone.density, together[i].density);
        EXPECT_EQ(alone.ray.origin.x, together[i].ray.origin.x);
        EXPECT_EQ(alone.ray.direction.x, together[i].ray.direction.x);
    }
}

TEST(EqualInPower, TakesRaysAsOftenAsTheirPowerSays) {
    Rng rng(221);
    std::vector<Emitted> rays(5000);
    double total = 0;
    std::size_t lit = 0;
    for (Emitted& ray : rays) {
        ray.power = rng.below(3) == 0 ? 0.0f : std::pow(rng.unit(), 8.0f);
        total += ray.power;
        lit += ray.power > 0.0f;
    }
    for (const std::size_t most : {rays.size(), lit / 2}) {
        const std::vector<std::uint32_t> chosen = equal_in_power(rays, most);
        ASSERT_EQ(chosen.size(), std::min(lit, most));
        std::vector<int> times(rays.size());
        for (const std::uint32_t i : chosen) {
            ++times.at(i);
        }
        int greatest = 0;
        for (std::size_t i = 0; i < rays.size(); ++i) {
            const double expected = rays[i].power / total * double(chosen.size());
            ASSERT_LT(std::fabs(times[i] - expected), 1 + 1e-6) << i;
            ASSERT_TRUE(rays[i].power > 0.0f || times[i] == 0) << i;
            greatest = std::max(greatest, times[i]);
        }
        EXPECT_GT(greatest, 3);
    }
}

TEST(EqualInPower, TakesTheOnlyOneAndNoneOfNone) {
    std::vector<Emitted> rays(100);
    EXPECT_TRUE(equal_in_power(rays, 100).empty());
    EXPECT_TRUE(equal_in_power({}, 100).empty());
    rays[37].power = 1e-30f;
    EXPECT_EQ(equal_in_power(rays, 100), std::vector<std::uint32_t>{37});
    EXPECT_TRUE(equal_in_power(rays, 0).empty());
}

}  // namespace
}  // namespace raykiln
