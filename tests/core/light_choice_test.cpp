#include <gtest/gtest.h>

#include "light/light.h"
#include "math/wide.h"
#include "shapes.h"

// Choosing one light of many: probabilities add up, are kept, and leave no light out.

namespace raykiln {
namespace {

using test::Rng;

constexpr int samples = 1000000;

/// Small emissive triangles here and there, some two-sided, spheres, points, spots, a sun
/// and a sky.
Scene lights_of_all_kinds(std::uint64_t seed) {
    Rng rng(seed);
    Scene scene;
    test::add_white(scene);
    scene.emissions.push_back({ColorSlot{{3, 2, 1}}, false});
    scene.emissions.push_back({ColorSlot{{1, 2, 3}}, true});
    for (int i = 0; i < 5; ++i) {
        const Vec3f axis = test::random_direction(rng);
        const Vec3f power = Vec3f(rng.between(0.1f, 10.0f));
        scene.lights.emplace_back(PointLight{test::random_point(rng, 3), power});
        scene.lights.emplace_back(
            SpotLight{test::random_point(rng, 3), axis, power, 0.9f, 0.7f});
    }
    scene.lights.emplace_back(DirectionalLight{{0, -1, 0}, Vec3f(1.0f)});
    scene.lights.emplace_back(EnvironmentLight{});
    for (std::uint32_t emission = 0; emission < 2; ++emission) {
        Mesh mesh = test::make_mesh(test::make_soup(20, 0.4f, rng));
        mesh.emission = emission;
        scene.groups[0].meshes.push_back(mesh);
    }
    Sphere sphere;
    sphere.center = {1, 1, 1};
    sphere.radius = 0.3f;
    sphere.emission = 0;
    scene.groups[0].spheres.push_back(sphere);
    prepare_lights(scene);
    return scene;
}

LightReceiver random_receiver(Rng& rng) {
    // Within the lights, among them and outside; some without a side.
    LightReceiver r{test::random_point(rng, 5), test::random_direction(rng)};
    if (rng.below(4) == 0) {
        r.normal = Vec3f(0.0f);
    }
    return r;
}

std::uint32_t count_of(const Scene& scene) {
    return static_cast<std::uint32_t>(scene.lights.size());
}

TEST(LightChoice, ProbabilitiesAddToOneAtMost) {
    const Scene scene = lights_of_all_kinds(131);
    Rng rng(132);
    for (int i = 0; i < 2000; ++i) {
        const LightReceiver receiver = random_receiver(rng);
        double sum = 0;
        for (std::uint32_t light = 0; light < count_of(scene); ++light) {
            const float pmf = pmf_of_light(scene, receiver, light);
            ASSERT_GE(pmf, 0.0f);
            sum += pmf;
        }
        // The rest is for branches whose lights turn out not to reach the receiver.
        ASSERT_LT(sum, 1 + 1e-5);
        ASSERT_GT(sum, 0.5 - 1e-5);
    }
}

TEST(LightChoice, DrawsWithItsProbabilities) {
    const Scene scene = lights_of_all_kinds(133);
    Rng rng(134);
    constexpr int receivers = 4;
    for (int r = 0; r < receivers; ++r) {
        const LightReceiver receiver = random_receiver(rng);
        std::vector<double> observed(count_of(scene) + 1), expected;
        for (int i = 0; i < samples; ++i) {
            const auto choice = choose_light(scene, receiver, rng.unit());
            if (choice.pmf <= 0.0f) {
                observed.back() += 1;
                continue;
            }
            observed[choice.light] += 1;
            if (i < 20000) {
                ASSERT_EQ(choice.pmf, pmf_of_light(scene, receiver, choice.light));
            }
        }
        double sum = 0;
        for (std::uint32_t light = 0; light < count_of(scene); ++light) {
            const double pmf = pmf_of_light(scene, receiver, light);
            sum += pmf;
            expected.push_back(pmf * samples);
        }
        expected.push_back(std::max(0.0, 1 - sum) * samples);
        const auto result = test::chi_squared_test(observed, expected);
        EXPECT_GT(result.p_value, test::sidak(receivers)) << result;
        EXPECT_EQ(result.impossible, 0);
    }
}

TEST(LightChoice, LeavesOutNoLightThatReachesTheReceiver) {
    const Scene scene = lights_of_all_kinds(135);
    Rng rng(136);
    int reached = 0;
    for (int i = 0; i < 5000; ++i) {
        const LightReceiver receiver = random_receiver(rng);
        for (std::uint32_t light = 0; light < count_of(scene); ++light) {
            const LightSample s = sample_light(scene, scene.lights[light], receiver,
                                               rng.unit(), rng.unit(), rng.unit());
            const bool any_side = length_squared(receiver.normal) == 0.0f;
            if (max_component(s.radiance) <= 0.0f ||
                !(any_side || dot(s.direction, receiver.normal) > 0.0f)) {
                continue;
            }
            ++reached;
            ASSERT_GT(pmf_of_light(scene, receiver, light), 0.0f)
                << "light " << light << " of kind " << scene.lights[light].index();
        }
    }
    EXPECT_GT(reached, 50000);
}

/// Lights in heaps: many at one place, others far apart.
LightTree heaps(std::uint64_t seed, std::uint32_t count) {
    Rng rng(seed);
    std::vector<LightBounds> lights(count);
    Vec3f center(0.0f);
    for (std::uint32_t i = 0; i < count; ++i) {
        if (i % 97 == 0) {
            center = test::random_point(rng, 10.0f);
        }
        LightBounds& b = lights[i];
        b.bounds.add(center);
        if (i % 3 != 0) {
            b.bounds.add(center + test::random_point(rng, 0.1f));
        }
        b.power = i % 11 == 0 ? 0.0f : rng.between(0.1f, 10.0f);
        b.axis = test::random_direction(rng);
        b.cos_theta_o = i % 5 == 0 ? -1.0f : 1.0f;
        b.two_sided = i % 2 == 0;
    }
    return LightTree(lights);
}

TEST(LightTree, ProbabilitiesOfManyLightsAddToOne) {
    constexpr std::uint32_t count = 3000;
    const LightTree tree = heaps(141, count);
    Rng rng(142);
    for (int i = 0; i < 20; ++i) {
        LightReceiver r = random_receiver(rng);
        r.normal = Vec3f(0.0f);
        double sum = 0;
        for (std::uint32_t light = 0; light < count; ++light) {
            const float pmf = tree.pmf<float>(r, light);
            sum += pmf;
            if (light % 11 == 0) {
                ASSERT_EQ(pmf, 0.0f) << "a light without power";
            }
        }
        ASSERT_LT(sum, 1 + 1e-4);
        ASSERT_GT(sum, 0.9);
        for (int k = 0; k < 1000; ++k) {
            const auto choice = tree.sample(r, rng.unit());
            if (choice.pmf > 0.0f) {
                ASSERT_EQ(choice.pmf, tree.pmf<float>(r, choice.light));
            }
        }
    }
}

TEST(LightTree, LanesChooseAsOneNumberDoes) {
    const LightTree tree = heaps(143, 3000);
    Rng rng(144);
    constexpr int width = NumberTraits<Wide>::width;
    for (int i = 0; i < 5000; ++i) {
        LightReceiver each[width];
        LightReceiverOf<Wide> all;
        float u[width];
        Wide wide_u(0.0f);
        for (int lane = 0; lane < width; ++lane) {
            each[lane] = random_receiver(rng);
            u[lane] = lane == 0 ? one_minus_epsilon : rng.unit();
            wide_u.set_lane(lane, u[lane]);
            set_lane(all.p, lane, each[lane].p);
            set_lane(all.normal, lane, each[lane].normal);
        }
        const LightChoiceOf<Wide> choice = tree.sample(all, wide_u);
        const Wide pmf = tree.pmf(all, choice.light);
        for (int lane = 0; lane < width; ++lane) {
            const auto one = tree.sample(each[lane], u[lane]);
            ASSERT_EQ(choice.light.lane(lane), one.light);
            ASSERT_EQ(choice.pmf.lane(lane), one.pmf);
            if (one.pmf > 0.0f) {
                ASSERT_EQ(pmf.lane(lane), one.pmf);
            }
        }
    }
}

TEST(LightTree, NeighboursHaveLikePlaces) {
    Rng rng(145);
    constexpr std::uint32_t count = 400;
    std::vector<LightBounds> lights(count);
    for (std::uint32_t i = 0; i < count; ++i) {
        const float side = i % 2 == 0 ? -100.0f : 100.0f;
        lights[i].bounds.add(Vec3f(side, 0, 0) + test::random_point(rng, 1.0f));
        lights[i].power = 1.0f;
    }
    const LightTree tree(lights);
    EXPECT_EQ(tree.size(), count);
    std::vector<int> used(LightTree::places);
    const bool low = tree.place<float>(0) < LightTree::places / 2;
    for (std::uint32_t i = 0; i < count; ++i) {
        const std::uint32_t place = tree.place<float>(i);
        ASSERT_LT(place, LightTree::places);
        ++used[place];
        ASSERT_EQ(place < LightTree::places / 2, low == (i % 2 == 0));
    }
    for (const int lights_here : used) {
        ASSERT_GE(lights_here, 1);
        ASSERT_LE(lights_here, 2);
    }
}

TEST(LightChoice, OneLightIsAlwaysChosen) {
    Scene scene;
    scene.lights.emplace_back(PointLight{{0, 0, 2}, Vec3f(1.0f)});
    prepare_lights(scene);
    const LightReceiver below{{0, 0, 0}, {0, 0, 1}};
    for (const float u : {0.0f, 0.5f, one_minus_epsilon}) {
        EXPECT_EQ(choose_light(scene, below, u).light, 0u);
        EXPECT_EQ(choose_light(scene, below, u).pmf, 1.0f);
    }
    EXPECT_EQ(pmf_of_light(scene, below, 0), 1.0f);
}

TEST(LightChoice, NearLightsAreChosenMoreOften) {
    Scene scene;
    scene.lights.emplace_back(PointLight{{0, 0, 1}, Vec3f(1.0f)});
    scene.lights.emplace_back(PointLight{{0, 0, 10}, Vec3f(1.0f)});
    prepare_lights(scene);
    const LightReceiver receiver{{0, 0, 0}, {0, 0, 1}};
    // By inverse square: 100 to 1, roughly.
    EXPECT_NEAR(pmf_of_light(scene, receiver, 0), 100.0 / 101, 1e-3);
}

TEST(LightChoice, LightsOfMirroredInstancesKeepTheirSide) {
    // A group with an emissive triangle, placed by a mirror image: the outside stays out.
    Scene scene;
    scene.emissions.push_back({ColorSlot{{1, 1, 1}}, false});
    test::Triangles t;
    t.positions = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}};
    t.faces = {{0, 1, 2}};
    scene.groups.resize(2);
    scene.groups[1].meshes.push_back(test::make_mesh(t));
    scene.groups[1].meshes[0].emission = 0;
    Transform mirror;
    mirror.x = {-1, 0, 0};
    mirror.origin = {5, 0, 0};
    scene.instances.push_back(test::make_instance(1, mirror));
    prepare_lights(scene);
    const auto& light = std::get<TriangleLight>(scene.lights[0]);
    EXPECT_NEAR(light.normal.z, 1.0f, 1e-6f);
    EXPECT_NEAR(light.area, 0.5f, 1e-6f);
    EXPECT_EQ(scene.instance_light_offset[0][0], 0u);
}

/// Lights of a square (corners in order) with its fourth corner moved off by (off, off),
/// cut along one diagonal or the other, and of a triangle behind it.
Scene square(float off, bool other_diagonal, bool textured, float uv_off) {
    Scene scene;
    scene.textures.emplace_back(CheckerTexture{});
    Emission emission{ColorSlot{{1, 1, 1}}, false};
    emission.radiance.texture = textured ? 0 : no_texture;
    scene.emissions.push_back(emission);
    test::Triangles t;
    t.positions = {{0, 0, 1}, {1, 0, 1}, {1 + off, 1 + off, 1}, {0, 1, 1}, {5, 0, 0}};
    t.uvs = {{0, 0}, {1, 0}, {1 + uv_off, 1}, {0, 1}, {0, 0}};
    if (other_diagonal) {
        t.faces = {{1, 2, 3}, {0, 1, 3}, {0, 1, 4}};
    } else {
        t.faces = {{0, 1, 2}, {2, 3, 0}, {0, 1, 4}};
    }
    scene.groups[0].meshes.push_back(test::make_mesh(t));
    scene.groups[0].meshes[0].emission = 0;
    prepare_lights(scene);
    return scene;
}

TEST(SurfaceLights, TwoTrianglesOfAParallelogramAreOneLight) {
    using Indices = std::vector<std::uint32_t>;
    const Indices joined{0, 0, 1}, apart{0, 1, 2};
    for (const bool other_diagonal : {false, true}) {
        for (const bool textured : {false, true}) {
            const Scene scene = square(0, other_diagonal, textured, 0);
            EXPECT_EQ(scene.surface_lights, joined);
            const auto& half = std::get<ParallelogramLight>(scene.lights[0]).half;
            EXPECT_NEAR(half.area, 0.5f, 1e-6f);
            EXPECT_NEAR(half.normal.z, 1.0f, 1e-6f);
        }
    }
    EXPECT_EQ(square(1e-3f, false, false, 0).surface_lights, apart);
    EXPECT_EQ(square(0, false, true, 0.1f).surface_lights, apart);
    // Where nothing is looked up, texture coordinates do not matter.
    EXPECT_EQ(square(0, false, false, 0.1f).surface_lights, joined);
}

TEST(SurfaceLights, TextureOfAParallelogramIsWhereItsTrianglesHaveIt) {
    Scene scene = square(0, true, true, 0);
    auto& checker = std::get<CheckerTexture>(scene.textures[0]);
    checker.color0 = Vec3f(1.0f);
    checker.color1 = Vec3f(5.0f);
    Rng rng(151);
    for (int i = 0; i < 10000; ++i) {
        const LightSample s = sample_light(scene, scene.lights[0], {{0.3f, 0.2f, 3}},
                                           rng.unit(), rng.unit(), 0);
        const float x = s.point.x, y = s.point.y;
        if (std::fabs(x - 0.5f) > 1e-3f && std::fabs(y - 0.5f) > 1e-3f) {
            ASSERT_EQ(s.radiance.x, (x < 0.5f) == (y < 0.5f) ? 1.0f : 5.0f);
        }
    }
}

}  // namespace
}  // namespace raykiln
