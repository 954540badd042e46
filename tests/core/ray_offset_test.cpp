#include <gtest/gtest.h>

#include "sampling/warp.h"
#include "surfaces.h"

// Rays that leave a surface do not meet it again, and those that end at one do not touch
// it.

namespace raykiln {
namespace {

using test::finish;
using test::Rng;
using test::trace_one;

/// A direction on the side of `normal` that `sign` says, down to grazing ones.
Vec3f leaving_direction(const Vec3f& normal, float sign, Rng& rng) {
    const Vec3f d = test::random_direction(rng);
    const float cosine = dot(d, normal);
    return std::fabs(cosine) < 1e-6f ? normal * sign : (cosine * sign > 0 ? d : -d);
}

Vec3f point_in(const test::Triangles& t, Rng& rng) {
    const Vec2f b = sample_triangle(rng.unit(), rng.unit());
    return t.positions[0] * (1 - b.x - b.y) + t.positions[1] * b.x + t.positions[2] * b.y;
}

test::Triangles random_triangle(float size, float distance, Rng& rng) {
    test::Triangles t;
    const Vec3f at = test::random_direction(rng) * distance;
    do {
        t.positions.clear();
        for (int i = 0; i < 3; ++i) {
            t.positions.push_back(at + test::random_direction(rng) * size);
        }
    } while (length(cross(t.positions[1] - t.positions[0],
                          t.positions[2] - t.positions[0])) < 0.1f * size * size);
    t.faces = {{0, 1, 2}};
    return t;
}

TEST(SpawnedRays, LeaveFlatTriangles) {
    // One triangle alone: whatever a ray from it meets is itself.
    Rng rng(151);
    int spawned = 0;
    for (const float size : {1e-3f, 1.0f, 1e4f}) {
        for (const float distance : {0.0f, 1.0f, 1e3f, 1e5f}) {
            if (distance * 0x1p-24f * 100 > size) {
                continue;  // the triangle itself is lost in rounding
            }
            for (int i = 0; i < 50; ++i) {
                const auto t = random_triangle(size, distance, rng);
                Scene scene;
                scene.groups[0].meshes.push_back(test::make_mesh(t));
                finish(scene);
                const Accel accel(scene);
                for (int j = 0; j < 100; ++j) {
                    const Vec3f target = point_in(t, rng);
                    const Vec3f d = test::random_direction(rng);
                    const auto from = trace_one(scene, accel, {target - d * size, d});
                    if (!from.hit.valid()) {
                        continue;
                    }
                    for (const float sign : {1.0f, -1.0f}) {
                        const Vec3f out =
                            leaving_direction(from.surface.normal, sign, rng);
                        ASSERT_FALSE(accel.occluded(spawn_ray(from.surface, out)))
                            << size << " wide, " << distance << " away";
                        ++spawned;
                    }
                }
            }
        }
    }
    EXPECT_GT(spawned, 50000);
}

TEST(SpawnedRays, LeavePlacedTriangles) {
    // Uneven scales up to 10 : 1; the error grows with their ratio.
    Rng rng(152);
    int spawned = 0;
    for (const float distance : {0.0f, 10.0f, 1e4f}) {
        for (int i = 0; i < 100; ++i) {
            const auto t = random_triangle(1.0f, 1.0f, rng);
            Scene scene;
            scene.groups.resize(2);
            scene.groups[1].meshes.push_back(test::make_mesh(t));
            const Vec3f scale(rng.between(0.3f, 3), rng.between(0.3f, 3),
                              rng.between(-3, -0.3f));
            const Transform m = test::random_placement(
                scale, test::random_direction(rng) * distance, rng);
            scene.instances.push_back(test::make_instance(1, m));
            finish(scene);
            const Accel accel(scene);
            for (int j = 0; j < 100; ++j) {
                const Vec3f target = m.point(point_in(t, rng));
                const Vec3f d = test::random_direction(rng);
                const auto from = trace_one(scene, accel, {target - d, d});
                if (!from.hit.valid()) {
                    continue;
                }
                // The error that a surface states is that of its distance from the plane.
                const float off = dot(from.surface.p - target, from.surface.normal);
                ASSERT_LT(std::fabs(off), from.surface.error) << distance;
                for (const float sign : {1.0f, -1.0f}) {
                    const Vec3f out = leaving_direction(from.surface.normal, sign, rng);
                    ASSERT_FALSE(accel.occluded(spawn_ray(from.surface, out)))
                        << distance;
                    ++spawned;
                }
            }
        }
    }
    EXPECT_GT(spawned, 10000);
}

TEST(SpawnedRays, LeaveSpheresAndCrossThem) {
    Rng rng(153);
    int outside = 0, inside = 0;
    for (const float radius : {0.01f, 1.0f, 1e3f}) {
        for (const float distance : {0.0f, 1.0f, 100.0f}) {
            Scene scene;
            Sphere s;
            s.center = test::random_direction(rng) * distance;
            s.radius = radius;
            scene.groups[0].spheres.push_back(s);
            finish(scene);
            const Accel accel(scene);
            for (int i = 0; i < 3000; ++i) {
                const Vec3f origin =
                    s.center + test::random_direction(rng) * (3 * radius);
                const Vec3f target =
                    s.center + test::random_direction(rng) * (0.999f * radius);
                const auto from =
                    trace_one(scene, accel, {origin, normalize(target - origin)});
                ASSERT_TRUE(from.hit.valid());
                const Surface& at = from.surface;
                const Vec3f out = leaving_direction(at.normal, 1, rng);
                ASSERT_FALSE(accel.occluded(spawn_ray(at, out)));
                ++outside;
                // Inwards: to the far side, 2 r cos away, unless that is about the
                // offset.
                const Vec3f in = leaving_direction(at.normal, -1, rng);
                const float chord = -2 * radius * dot(in, at.normal);
                if (chord * chord < 100 * radius * at.error) {
                    continue;
                }
                const Hit far = accel.intersect(spawn_ray(at, in));
                ASSERT_TRUE(far.valid());
                ASSERT_NEAR(far.t / chord, 1.0f, 0.1f);
                ++inside;
            }
        }
    }
    EXPECT_EQ(outside, 27000);
    EXPECT_GT(inside, 20000);
}

TEST(SpawnedRays, ShadowRaysEndBeforeTheLight) {
    // From a floor to points on an emissive triangle over it: nothing is in between.
    Rng rng(154);
    Scene scene;
    test::Triangles floor;
    floor.positions = {{-9, 0, -9}, {9, 0, -9}, {9, 0, 9}, {-9, 0, 9}};
    floor.faces = {{0, 2, 1}, {0, 3, 2}};
    scene.groups[0].meshes.push_back(test::make_mesh(floor));
    auto lamp = random_triangle(0.5f, 0.0f, rng);
    for (Vec3f& p : lamp.positions) {
        p.y += 2;
    }
    scene.groups[0].meshes.push_back(test::make_mesh(lamp));
    scene.groups[0].meshes[1].emission = 0;
    scene.emissions.push_back({ColorSlot{}, true});
    finish(scene);
    const Accel accel(scene);
    int sent = 0, met = 0;
    for (int i = 0; i < 20000; ++i) {
        const Ray down{{rng.between(-8, 8), 1, rng.between(-8, 8)}, {0, -1, 0}};
        const auto from = trace_one(scene, accel, down);
        ASSERT_TRUE(from.hit.valid());
        const LightSample light = sample_light(scene, scene.lights[0], {from.surface.p},
                                               rng.unit(), rng.unit(), 0);
        if (light.pdf_solid_angle <= 0.0f) {
            continue;
        }
        Ray shadow = spawn_ray(from.surface, light.direction);
        shadow.direction = light.point - shadow.origin;
        shadow.t_far = 1.0f - 1e-6f;
        ASSERT_FALSE(accel.occluded(shadow));
        // And a little further it is met, but for samples within the offset of the
        // outline.
        shadow.t_far = 1.01f;
        met += accel.occluded(shadow);
        ++sent;
    }
    EXPECT_GT(met, sent * 999 / 1000);
    EXPECT_GT(sent, 19000);
}

}  // namespace
}  // namespace raykiln
