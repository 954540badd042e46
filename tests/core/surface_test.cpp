#include <gtest/gtest.h>

#include "surfaces.h"

// Points on surfaces: their coordinates and frames.

namespace raykiln {
namespace {

using test::finish;
using test::Rng;
using test::trace_one;

Scene one_sphere(const Sphere& sphere) {
    Scene scene;
    scene.groups[0].spheres.push_back(sphere);
    finish(scene);
    return scene;
}

TEST(SphereSurface, UvFollowsTheAngles) {
    Sphere s;
    s.center = {1, 2, 3};
    s.radius = 2;
    const Scene scene = one_sphere(s);
    const Accel accel(scene);
    Rng rng(155);
    for (int i = 0; i < 10000; ++i) {
        const Vec3f n = test::random_direction(rng);
        const auto at = trace_one(scene, accel, {s.center + n * 5.0f, -n});
        ASSERT_TRUE(at.hit.valid());
        // p is good to some ulp of 4, on a radius of 2.
        const double ring = std::hypot(n.x, n.z);
        const double u = 0.5 + std::atan2(double(n.x), double(n.z)) / test::tau;
        ASSERT_NEAR(at.surface.uv.y, std::acos(double(n.y)) / (test::tau / 2),
                    2e-6 / ring);
        const double turn = std::fabs(at.surface.uv.x - u);
        ASSERT_LT(std::min(turn, 1 - turn), 1e-6 / ring);
        ASSERT_LT(length(at.surface.normal - n), 4e-6f);
        ASSERT_LT(length(at.surface.p - (s.center + n * 2.0f)), 8e-6f);
    }
}

TEST(SphereSurface, TangentRunsAlongU) {
    Sphere s;
    const Scene scene = one_sphere(s);
    const Accel accel(scene);
    Rng rng(156);
    for (int i = 0; i < 2000; ++i) {
        const Vec3f n = test::random_direction(rng);
        if (std::hypot(n.x, n.z) < 0.1f) {
            continue;
        }
        const auto at = trace_one(scene, accel, {n * 5.0f, -n});
        const double step = 1e-3;
        const Vec3f further{
            static_cast<float>(n.x * std::cos(step) + n.z * std::sin(step)), n.y,
            static_cast<float>(n.z * std::cos(step) - n.x * std::sin(step))};
        const Vec2f uv = trace_one(scene, accel, {further * 5.0f, -further}).surface.uv;
        const float du = uv.x - at.surface.uv.x;
        if (std::fabs(du) > 0.5f) {
            continue;  // across the seam
        }
        EXPECT_NEAR(du, step / test::tau, 3e-6);
        EXPECT_GT(dot(at.surface.shading.s, normalize(further - n)), 0.999f);
    }
}

TEST(SphereSurface, FlippedNormalsLookInwards) {
    Sphere s;
    s.flip_normals = true;
    const Scene scene = one_sphere(s);
    const Accel accel(scene);
    const auto at = trace_one(scene, accel, {{0, 0, 5}, {0, 0, -1}});
    EXPECT_EQ(at.surface.normal.z, -1.0f);
}

/// A square in the plane z = 0, u along x, v along -y: the layout of images.
test::Triangles square() {
    test::Triangles t;
    t.positions = {{0, 0, 0}, {1, 0, 0}, {1, 1, 0}, {0, 1, 0}};
    t.uvs = {{0, 1}, {1, 1}, {1, 0}, {0, 0}};
    t.faces = {{0, 1, 2}, {0, 2, 3}};
    return t;
}

std::int32_t add_constant_map(Scene& scene, const Vec3f& color) {
    auto pixels = std::make_shared<std::vector<float>>(
        std::initializer_list<float>{color.x, color.y, color.z});
    ImageTexture image;
    image.pixels = pixels->data();
    image.owner = pixels;
    image.width = image.height = 1;
    image.channels = 3;
    image.format = PixelFormat::f32;
    scene.textures.emplace_back(image);
    return static_cast<std::int32_t>(scene.textures.size()) - 1;
}

Scene square_scene(const test::Triangles& t) {
    Scene scene;
    scene.groups[0].meshes.push_back(test::make_mesh(t));
    test::add_white(scene);
    finish(scene);
    return scene;
}

const Ray from_above{{0.3f, 0.4f, 2}, {0, 0, -1}};
const Ray from_below{{0.3f, 0.4f, -2}, {0, 0, 1}};

TEST(MeshSurface, InterpolatesUvAndFollowsU) {
    const Scene scene = square_scene(square());
    const Accel accel(scene);
    const auto at = trace_one(scene, accel, from_above);
    EXPECT_NEAR(at.surface.uv.x, 0.3f, 1e-6f);
    EXPECT_NEAR(at.surface.uv.y, 0.6f, 1e-6f);
    EXPECT_NEAR(at.surface.shading.s.x, 1.0f, 1e-6f);
    EXPECT_NEAR(at.surface.normal.z, 1.0f, 1e-6f);
    EXPECT_LT(length(at.surface.p - Vec3f(0.3f, 0.4f, 0)), 1e-6f);
}

TEST(MeshSurface, TwoSidedFramesFaceTheViewer) {
    Scene scene = square_scene(square());
    const Accel accel(scene);
    const auto below = trace_one(scene, accel, from_below);
    // The geometric normal stays outside, the shading frame turns.
    EXPECT_EQ(below.surface.normal.z, 1.0f);
    EXPECT_NEAR(below.surface.shading.n.z, -1.0f, 1e-6f);
    scene.materials[0].two_sided = false;
    EXPECT_NEAR(trace_one(scene, accel, from_below).surface.shading.n.z, 1.0f, 1e-6f);
}

TEST(MeshSurface, BentNormalsNeverLookAway) {
    // Vertex normals tilted by up to 80 degrees, seen from all around: a two-sided
    // surface's frame always has the viewer above it.
    Rng rng(157);
    test::Triangles t = square();
    for (int i = 0; i < 4; ++i) {
        const Vec3f aside = test::random_direction(rng);
        t.normals.push_back(normalize(Vec3f(aside.x, aside.y, 0.2f)));
    }
    const Scene scene = square_scene(t);
    const Accel accel(scene);
    int grazing = 0;
    for (int i = 0; i < 50000; ++i) {
        const Vec3f target(rng.unit(), rng.unit(), 0);
        const Vec3f d = test::random_direction(rng);
        const auto at = trace_one(scene, accel, {target - d, d});
        if (!at.hit.valid()) {
            continue;
        }
        const Frame<float>& f = at.surface.shading;
        const float cosine = dot(f.n, -d);
        ASSERT_GT(cosine, 0.0f);
        ASSERT_NEAR(length(f.n), 1.0f, 1e-6f);
        ASSERT_NEAR(dot(f.n, f.s), 0.0f, 2e-6f);
        // On the side of the geometric normal that is seen, at least in the limit.
        grazing += cosine < 0.01f;
    }
    EXPECT_GT(grazing, 0);
}

TEST(MeshSurface, FlatNormalMapChangesNothing) {
    Rng rng(158);
    test::Triangles t = square();
    for (int i = 0; i < 4; ++i) {
        t.normals.push_back(
            normalize(Vec3f(rng.between(-0.2f, 0.2f), rng.between(-0.2f, 0.2f), 1.0f)));
    }
    Scene plain = square_scene(t), mapped = square_scene(t);
    mapped.materials[0].normal_map = add_constant_map(mapped, {0.5f, 0.5f, 1.0f});
    const Accel accel(plain);
    for (const Ray& ray : {from_above, from_below}) {
        const Hit hit = accel.intersect(ray);
        const Frame<float> a = make_surface(plain, hit, ray).shading;
        const Frame<float> b = make_surface(mapped, hit, ray).shading;
        EXPECT_LT(length(a.n - b.n), 1e-6f);
        EXPECT_LT(length(a.s - b.s), 2e-6f);
        EXPECT_LT(length(a.t - b.t), 2e-6f);
    }
}

TEST(MeshSurface, NormalMapTiltsAlongUAndAgainstV) {
    // glTF: +x to the right of the image, +y to its top; v runs down.
    Scene scene = square_scene(square());
    const Accel accel(scene);
    scene.materials[0].normal_map = add_constant_map(scene, {0.8f, 0.5f, 0.9f});
    const Vec3f right = trace_one(scene, accel, from_above).surface.shading.n;
    EXPECT_NEAR(right.x, 0.6f, 1e-6f);
    EXPECT_NEAR(right.y, 0.0f, 1e-6f);
    scene.materials[0].normal_map = add_constant_map(scene, {0.5f, 0.8f, 0.9f});
    const Vec3f up = trace_one(scene, accel, from_above).surface.shading.n;
    EXPECT_NEAR(up.y, 0.6f, 1e-6f);
    scene.materials[0].normal_scale = 0.0f;
    EXPECT_NEAR(trace_one(scene, accel, from_above).surface.shading.n.z, 1.0f, 1e-6f);
}

TEST(MeshSurface, NormalMapsFollowMirroredCoordinates) {
    // With u running to the left the image is seen mirrored: its right is -x, its top
    // still y.
    test::Triangles t = square();
    for (Vec2f& uv : t.uvs) {
        uv.x = 1 - uv.x;
    }
    Scene scene = square_scene(t);
    const Accel accel(scene);
    scene.materials[0].normal_map = add_constant_map(scene, {0.8f, 0.5f, 0.9f});
    EXPECT_NEAR(trace_one(scene, accel, from_above).surface.shading.n.x, -0.6f, 1e-6f);
    scene.materials[0].normal_map = add_constant_map(scene, {0.5f, 0.8f, 0.9f});
    EXPECT_NEAR(trace_one(scene, accel, from_above).surface.shading.n.y, 0.6f, 1e-6f);
}

TEST(MeshSurface, PlacedMeshesTurnTheirFrames) {
    Scene scene;
    scene.groups.resize(2);
    scene.groups[1].meshes.push_back(test::make_mesh(square()));
    Transform m;  // x to y, y to z, z to x, and stretched along y
    m.x = {0, 2, 0};
    m.y = {0, 0, 1};
    m.z = {1, 0, 0};
    m.origin = {10, 0, 0};
    scene.instances.push_back(test::make_instance(1, m));
    finish(scene);
    const Accel accel(scene);
    const auto at = trace_one(scene, accel, {{12, 0.6f, 0.4f}, {-1, 0, 0}});
    ASSERT_TRUE(at.hit.valid());
    EXPECT_NEAR(at.surface.normal.x, 1.0f, 1e-6f);
    EXPECT_NEAR(at.surface.shading.s.y, 1.0f, 1e-6f);
    EXPECT_NEAR(at.surface.uv.x, 0.3f, 1e-6f);
    EXPECT_NEAR(at.surface.uv.y, 0.6f, 1e-6f);
    EXPECT_LT(length(at.surface.p - Vec3f(10, 0.6f, 0.4f)), 1e-5f);
}

TEST(MeshSurface, OpacityIsCutWhereItsMaterialSays) {
    Scene scene = square_scene(square());
    const Accel accel(scene);
    const Hit hit = accel.intersect(from_above);
    EXPECT_EQ(opacity_at(scene, hit), 1.0f);
    scene.materials[0].opacity.factor = 0.3f;
    EXPECT_FLOAT_EQ(opacity_at(scene, hit), 0.3f);
    scene.materials[0].alpha_cutoff = 0.5f;
    EXPECT_EQ(opacity_at(scene, hit), 0.0f);
    scene.materials[0].alpha_cutoff = 0.2f;
    EXPECT_EQ(opacity_at(scene, hit), 1.0f);
}

}  // namespace
}  // namespace raykiln
