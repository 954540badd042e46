#include "light/emitter_bounds.h"

#include <gtest/gtest.h>

#include "light/light.h"
#include "math/wide.h"
#include "shapes.h"

// The last ray of a path is not traced where no light can be: none may be lost so.

namespace raykiln {
namespace {

using test::Rng;

/// Flat lamps that face an axis, each a shape of its own.
Scene flat_lamps(int count, Rng& rng) {
    Scene scene;
    test::add_white(scene);
    scene.emissions.push_back({ColorSlot{{1, 1, 1}}, true});
    for (int i = 0; i < count; ++i) {
        const Vec3f p = test::random_point(rng, 100.0f);
        const Vec3f along[3] = {{0.01f, 0, 0}, {0, 0.01f, 0}, {0, 0, 0.01f}};
        Mesh mesh = test::make_mesh(
            {{p, p + along[i % 3], p + along[(i + 1) % 3]}, {{0, 1, 2}}, {}, {}});
        mesh.emission = 0;
        scene.groups[0].meshes.push_back(mesh);
    }
    prepare_lights(scene);
    return scene;
}

/// Whether a ray meets a lamp, in double precision.
bool meets(const Mesh& lamp, int axis, const Vec3f& origin, const Vec3f& direction) {
    const auto at = [](const Vec3f& v, int k) {
        return static_cast<double>(component(v, k % 3));
    };
    const Vec3f p = lamp.position(0);
    const double t = (at(p, axis + 2) - at(origin, axis + 2)) / at(direction, axis + 2);
    const auto along = [&](int k) {
        const double size = at(lamp.position(k == axis ? 1 : 2), k) - at(p, k);
        return (at(origin, k) + t * at(direction, k) - at(p, k)) / size;
    };
    const double u = along(axis), v = along(axis + 1);
    return t > 0 && u >= 0 && v >= 0 && u + v <= 1;
}

TEST(EmitterBounds, NoRayToALampIsLost) {
    Rng rng(3);
    for (const int lamps : {1, 8, 9, 50}) {
        const Scene scene = flat_lamps(lamps, rng);
        ASSERT_EQ(scene.emitter_bounds.size(),
                  lamps <= 8 ? static_cast<std::size_t>(lamps) : 1u);
        int met = 0;
        for (int i = 0; i < 200000; ++i) {
            const auto chosen = rng.below(static_cast<std::uint32_t>(lamps));
            const Mesh& lamp = scene.groups[0].meshes[chosen];
            const float u = rng.between(0, 1), v = rng.between(0, 1 - u);
            const Vec3f at = lamp.position(0) * (1 - u - v) + lamp.position(1) * u +
                             lamp.position(2) * v;
            // From near and far, also along the planes between the axes.
            Vec3f origin =
                at + test::random_direction(rng) * std::exp2(rng.between(-10, 10));
            origin.x = rng.below(4) == 0 ? at.x : origin.x;
            origin.y = rng.below(4) == 0 ? at.y : origin.y;
            origin.z = rng.below(4) == 0 ? at.z : origin.z;
            if (max_abs(at - origin) == 0.0f) {
                continue;
            }
            const Vec3f direction = normalize(at - origin);
            if (meets(lamp, static_cast<int>(chosen % 3), origin, direction)) {
                ++met;
                ASSERT_TRUE(may_meet_light(scene, origin, direction));
            }
        }
        EXPECT_GT(met, 100000);
    }
}

TEST(EmitterBounds, RaysElsewhereAreKnown) {
    Rng rng(4);
    Scene scene = flat_lamps(1, rng);
    const Vec3f center = scene.emitter_bounds[0].center();
    int found = 0;
    for (int i = 0; i < 10000; ++i) {
        const Vec3f origin = center + test::random_direction(rng) * 5.0f;
        EXPECT_FALSE(may_meet_light(scene, origin, normalize(origin - center)));
        found += may_meet_light(scene, origin, test::random_direction(rng)) ? 1 : 0;
    }
    EXPECT_LT(found, 10);
    scene.light_table.environments.push_back(0);
    EXPECT_TRUE(may_meet_light(scene, center, Vec3f(1, 0, 0)));
}

TEST(EmitterBounds, MeshesWithoutTrianglesHaveNone) {
    Rng rng(6);
    Scene scene = flat_lamps(1, rng);
    scene.groups[0].meshes[0].triangle_count = 0;
    scene.emitter_bounds.clear();
    prepare_lights(scene);
    EXPECT_TRUE(scene.emitter_bounds.empty());
}

TEST(EmitterBounds, LanesAreDecidedAsOneByOne) {
    Rng rng(5);
    const Scene scene = flat_lamps(20, rng);
    constexpr int lanes = NumberTraits<Wide>::width;
    for (int k = 0; k < 2000; ++k) {
        Vec3f origin[lanes], direction[lanes];
        alignas(64) float numbers[6][lanes];
        for (int i = 0; i < lanes; ++i) {
            origin[i] = test::random_point(rng, 300.0f);
            direction[i] = test::random_direction(rng);
            const float all[6] = {origin[i].x,    origin[i].y,    origin[i].z,
                                  direction[i].x, direction[i].y, direction[i].z};
            for (int n = 0; n < 6; ++n) {
                numbers[n][i] = all[n];
            }
        }
        const auto read = [&](int n) { return NumberTraits<Wide>::load(numbers[n]); };
        const auto may = bits(may_meet_light<Wide>(scene, {read(0), read(1), read(2)},
                                                   {read(3), read(4), read(5)}));
        for (int i = 0; i < lanes; ++i) {
            EXPECT_EQ((may >> i & 1u) != 0,
                      may_meet_light(scene, origin[i], direction[i]));
        }
    }
}

}  // namespace
}  // namespace raykiln
