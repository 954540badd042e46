#include "accel/few_triangles.h"

#include <gtest/gtest.h>

#include "accel/accel.h"
#include "math/wide.h"
#include "shapes.h"

// Testing against all triangles, compared with the hierarchy (which accel_test.cpp
// compares with brute force in double precision), alone and side by side.

namespace raykiln {
namespace {

using test::Rng;

Scene scene_of(std::vector<test::Triangles> meshes) {
    Scene scene;
    for (const test::Triangles& triangles : meshes) {
        scene.groups[0].meshes.push_back(test::make_mesh(triangles));
    }
    return scene;
}

Hit hit_of(const FewTriangles& few, const Ray& ray) {
    const auto hit = intersect(few, ray.origin, ray.direction, ray.t_near, ray.t_far);
    if (!hit.met) {
        return {};
    }
    const Vec3f& normal = few.triangles[hit.triangle].normal;
    return {hit.t,
            hit.u,
            hit.v,
            normal,
            few.geometry[hit.triangle],
            few.primitive[hit.triangle]};
}

bool is_occluded(const FewTriangles& few, const Ray& ray) {
    return occluded(few, ray.origin, ray.direction, ray.t_far, true);
}

Vec3f position(const Scene& scene, const Hit& hit) {
    const Mesh& mesh = scene.groups[0].meshes[hit.geometry];
    const std::uint32_t* corner = mesh.indices + 3 * hit.primitive;
    const Vec3f p = mesh.position(corner[0]);
    return p + (mesh.position(corner[1]) - p) * hit.u +
           (mesh.position(corner[2]) - p) * hit.v;
}

TEST(FewTriangles, MeetWhatTheHierarchyMeets) {
    Rng rng(1);
    constexpr int rays = 20000;
    int different = 0, met = 0;
    for (int s = 0; s < 10; ++s) {
        const Scene scene = scene_of({test::make_soup(40, 0.5f, rng),
                                      test::make_ball(0, {0.3f, 0, 0}, 0.4f, 0.1f, rng)});
        const FewTriangles few(scene);
        ASSERT_EQ(few.triangles.size(), 60u);
        const Accel accel(scene);
        for (int i = 0; i < rays; ++i) {
            Ray ray{test::random_direction(rng) * (2.0f * rng.unit()),
                    test::random_direction(rng) * rng.between(0.5f, 2.0f)};
            if (i % 2 == 1) {
                ray.t_near = rng.unit();
                ray.t_far = 2.0f * rng.unit();
            }
            const Hit expected = accel.intersect(ray), hit = hit_of(few, ray);
            if (hit.valid() != expected.valid() || hit.geometry != expected.geometry ||
                hit.primitive != expected.primitive) {
                ++different;
                continue;
            }
            if (hit.valid()) {
                ++met;
                ASSERT_NEAR(hit.t, expected.t, 3e-5f);
                const float off =
                    length(position(scene, hit) - position(scene, expected));
                ASSERT_LT(off, 3e-5f);
                ASSERT_NEAR(dot(normalize(hit.normal), normalize(expected.normal)), 1.0f,
                            1e-5f);
            }
            if (ray.t_near == 0.0f) {
                ASSERT_EQ(is_occluded(few, ray), hit.valid());
            }
        }
    }
    EXPECT_GT(met, 2 * rays);
    EXPECT_LT(different, 10);  // rays that pass an edge by a rounding
}

TEST(FewTriangles, AreWatertightAtEdgesAndCorners) {
    Rng rng(2);
    for (const float radius : {1.0f, 1000.0f, 1e-3f}) {
        const Vec3f center = Vec3f(3, -2, 1) * (10.0f * radius);
        const test::Triangles ball = test::make_ball(0, center, radius, 0.2f, rng);
        // Half of the faces in a mesh of its own: an edge may lie between two meshes.
        test::Triangles half = ball;
        half.faces.resize(10);
        test::Triangles other = ball;
        other.faces.erase(other.faces.begin(), other.faces.begin() + 10);
        const FewTriangles few(scene_of({half, other}));
        ASSERT_EQ(few.vertices.size(), 12u);
        ASSERT_EQ(few.edges.size(), 30u);
        for (int i = 0; i < 100000; ++i) {
            const auto& face = ball.faces[rng.below(20)];
            const std::uint32_t side = rng.below(3);
            const Vec3f& a = ball.positions[face[side]];
            const Vec3f& b = ball.positions[face[(side + 1) % 3]];
            const Vec3f target = i % 3 == 0 ? a : lerp(a, b, rng.unit());
            const Vec3f origin =
                center + test::random_direction(rng) * (0.3f * radius * rng.unit());
            const Ray ray{origin, target - origin};
            ASSERT_TRUE(hit_of(few, ray).valid()) << i;
            ASSERT_TRUE(is_occluded(few, ray)) << i;
        }
    }
}

TEST(FewTriangles, DoNotDependOnTheOtherLanes) {
    constexpr int width = NumberTraits<Wide>::width;
    Rng rng(3);
    const FewTriangles few(scene_of({test::make_soup(60, 0.7f, rng)}));
    for (int i = 0; i < 20000; ++i) {
        Ray rays[width];
        Vec3<Wide> origin, direction;
        for (int k = 0; k < width; ++k) {
            rays[k] = {test::random_direction(rng) * (2.0f * rng.unit()),
                       test::random_direction(rng)};
            set_lane(origin, k, rays[k].origin);
            set_lane(direction, k, rays[k].direction);
        }
        const auto hits = intersect(few, origin, direction, Wide(0.0f), Wide(infinity));
        const WideMask wanted = WideMask::of_bits(static_cast<std::uint32_t>(i));
        const WideMask blocked = occluded(few, origin, direction, Wide(infinity), wanted);
        for (int k = 0; k < width; ++k) {
            const auto alone =
                intersect(few, rays[k].origin, rays[k].direction, 0.0f, infinity);
            ASSERT_EQ(hits.met.lane(k), alone.met);
            ASSERT_EQ(hits.triangle.lane(k), alone.triangle);
            ASSERT_EQ(blocked.lane(k), wanted.lane(k) && alone.met);
            if (alone.met) {
                ASSERT_EQ(hits.t.lane(k), alone.t);
                ASSERT_EQ(hits.u.lane(k), alone.u);
                ASSERT_EQ(hits.v.lane(k), alone.v);
            }
        }
    }
}

TEST(FewTriangles, OfEqualDistancesTheFirstIsMet) {
    test::Triangles sheet{
        {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}}, {{0, 1, 2}, {2, 1, 0}}, {}, {}};
    const FewTriangles few(scene_of({sheet, sheet}));
    const Hit hit = hit_of(few, {{0.25f, 0.25f, 1}, {0, 0, -1}});
    EXPECT_EQ(hit.geometry, 0u);
    EXPECT_EQ(hit.primitive, 0u);
    EXPECT_EQ(hit.t, 1.0f);
    EXPECT_EQ(hit.u, 0.25f);
    EXPECT_EQ(hit.v, 0.25f);
}

TEST(FewTriangles, AreForScenesOfFewTrianglesAlone) {
    Rng rng(4);
    EXPECT_FALSE(FewTriangles(scene_of({test::make_soup(64, 1, rng)})).empty());
    EXPECT_TRUE(FewTriangles(scene_of({test::make_soup(65, 1, rng)})).empty());
    Scene with_sphere = scene_of({test::make_soup(2, 1, rng)});
    with_sphere.groups[0].spheres.emplace_back();
    EXPECT_TRUE(FewTriangles(with_sphere).empty());
    Scene with_instance = scene_of({test::make_soup(2, 1, rng)});
    with_instance.groups.emplace_back();
    with_instance.instances.push_back({1, {}, {}});
    EXPECT_TRUE(FewTriangles(with_instance).empty());
    EXPECT_TRUE(FewTriangles(Scene{}).empty());
}

TEST(FewTriangles, LeaveOutThoseWithoutArea) {
    const test::Triangles flat{{{0, 0, 0}, {1, 0, 0}, {2, 0, 0}, {0, 1, 0}},
                               {{0, 1, 2}, {0, 0, 0}, {0, 1, 3}},
                               {},
                               {}};
    const FewTriangles few(scene_of({flat}));
    ASSERT_EQ(few.triangles.size(), 1u);
    EXPECT_EQ(hit_of(few, {{0.2f, 0.2f, -1}, {0, 0, 1}}).primitive, 2u);
}

}  // namespace
}  // namespace raykiln
