#include <gtest/gtest.h>

#include <cmath>
#include <vector>

#include "light/light.h"
#include "sampling/warp.h"
#include "shapes.h"

// Where all lights look small, a diffuse surface's own samples of them may be left out:
// no light may then be so unlikely to be sampled that they would have been missed.

namespace raykiln {
namespace {

using test::Rng;

struct Lamp {
    Vec3f center, facing;
    float half = 0.03f, radiance = 1.0f;
};

/// `scene` may hold other lights.
Scene lit_by(const std::vector<Lamp>& lamps, Scene scene = {}) {
    test::add_white(scene);
    for (const Lamp& lamp : lamps) {
        const Frame<float> frame = frame_of_normal(lamp.facing);
        const auto corner = [&](float u, float v) {
            return lamp.center + (frame.s * u + frame.t * v) * lamp.half;
        };
        Mesh mesh =
            test::make_mesh({{corner(-1, -1), corner(1, -1), corner(1, 1), corner(-1, 1)},
                             {{0, 1, 2}, {2, 3, 0}},
                             {},
                             {}});
        mesh.emission = static_cast<std::uint32_t>(scene.emissions.size());
        scene.emissions.push_back({ColorSlot{Vec3f(lamp.radiance)}, false});
        scene.groups[0].meshes.push_back(mesh);
    }
    prepare_lights(scene);
    return scene;
}

/// Lamps here and there under a ceiling.
std::vector<Lamp> scattered(int count, float across, Rng& rng) {
    std::vector<Lamp> lamps;
    for (int i = 0; i < count; ++i) {
        const float x = rng.between(-across, across), z = rng.between(-across, across);
        lamps.push_back({{x, rng.between(2.8f, 3.0f), z}, {0, -1, 0}});
    }
    return lamps;
}

/// The same, and a hundred close together that hang lower.
std::vector<Lamp> with_a_cluster(Rng& rng) {
    std::vector<Lamp> lamps = scattered(900, 50.0f, rng);
    for (int i = 0; i < 100; ++i) {
        const Vec3f at{0.07f * static_cast<float>(i % 10), 2.0f,
                       0.07f * static_cast<float>(i / 10)};
        lamps.push_back({at, {0, -1, 0}});
    }
    return lamps;
}

/// Facing all ways, of many sizes and brightnesses, in heaps.
std::vector<Lamp> heaps(Rng& rng) {
    std::vector<Lamp> lamps;
    Vec3f center;
    for (int i = 0; i < 600; ++i) {
        if (i % 20 == 0) {
            center = test::random_point(rng, 20.0f);
        }
        const float size = std::exp2(rng.between(-8.0f, -3.0f));
        lamps.push_back({center + test::random_point(rng, 0.5f),
                         test::random_direction(rng), size,
                         std::exp2(rng.between(-2.0f, 2.0f))});
    }
    return lamps;
}

LightReceiver receiver_near(const std::vector<Lamp>& lamps, Rng& rng) {
    const auto one = rng.below(static_cast<std::uint32_t>(lamps.size()));
    const float distance = std::exp2(rng.between(-5.0f, 5.0f));
    return {lamps[one].center + test::random_direction(rng) * distance,
            test::random_direction(rng)};
}

bool look_small(const Scene& scene, const LightReceiver& receiver) {
    return choose_light(scene, receiver, 0.5f).small;
}

/// What is left out of a surface's samples of all lights, by the weights that they have.
struct LeftOut {
    int receivers = 0, lights = 0, heavy = 0;
    float most = 0.0f;

    void look(const Scene& scene, const LightReceiver& receiver, Rng& rng) {
        if (!look_small(scene, receiver)) {
            return;
        }
        ++receivers;
        for (std::uint32_t light = 0; light < scene.lights.size(); ++light) {
            const LightSample s = sample_light(scene, scene.lights[light], receiver,
                                               rng.unit(), rng.unit(), 0.0f);
            const float cosine = dot(s.direction, receiver.normal);
            if (max_component(s.radiance) <= 0.0f || cosine <= 0.0f) {
                continue;
            }
            const float pdf = s.pdf_solid_angle * pmf_of_light(scene, receiver, light);
            const float weight = mis_weight_of_bsdf(cosine * inv_pi, pdf);
            ++lights;
            heavy += weight > sqr(LightTree::small_share) ? 1 : 0;
            most = max(most, weight);
        }
    }
};

TEST(SmallLights, AreSampledMoreDenselyThanASurfaceWould) {
    Rng rng(171);
    for (const auto& lamps : {scattered(3, 5.0f, rng), scattered(1000, 6.0f, rng),
                              with_a_cluster(rng), heaps(rng)}) {
        const Scene scene = lit_by(lamps);
        LeftOut out;
        for (int i = 0; i < 30000; ++i) {
            out.look(scene, receiver_near(lamps, rng), rng);
        }
        EXPECT_GT(out.receivers, 500);
        EXPECT_LT(out.most, 0.2f);
        EXPECT_LT(out.heavy, 0.005 * out.lights);
    }
}

TEST(SmallLights, LookLargeFromNearby) {
    const std::vector<Lamp> lamp{{{0, 2, 0}, {0, -1, 0}, 0.1f}};
    const Scene one = lit_by(lamp);
    EXPECT_FALSE(look_small(one, {{0, 1.8f, 0}, {0, 1, 0}}));
    EXPECT_TRUE(look_small(one, {{0, 0, 0}, {0, 1, 0}}));
    // A lamp's part of a wide hall of lamps is nothing, but not beside it.
    Rng rng(172);
    std::vector<Lamp> hall = scattered(900, 50.0f, rng);
    hall.push_back({{0, 2, 0}, {0, -1, 0}});
    const Scene many = lit_by(hall);
    EXPECT_FALSE(look_small(many, {{0, 1.95f, 0}, {0, 1, 0}}));
    EXPECT_TRUE(look_small(many, {{0, -20, 0}, {0, 1, 0}}));
}

TEST(SmallLights, AreNotKnownWhereLightMayComeFromElsewhere) {
    const std::vector<Lamp> lamp{{{0, 2, 0}, {0, -1, 0}}};
    const LightReceiver floor{{0, 0, 0}, {0, 1, 0}};
    EXPECT_TRUE(look_small(lit_by(lamp), floor));
    Scene sky;
    sky.lights.emplace_back(EnvironmentLight{});
    for (const float u : {0.1f, 0.9f}) {
        EXPECT_FALSE(choose_light(lit_by(lamp, sky), floor, u).small);
    }
    // A lamp whose texture is black where it was looked at may shine elsewhere: only a
    // surface's own samples find that.
    for (const float texel : {0.0f, std::nanf("")}) {
        Scene textured;
        CheckerTexture checker;
        checker.color0 = checker.color1 = Vec3f(texel);
        textured.textures.emplace_back(checker);
        Emission emission{ColorSlot{{1, 1, 1}}, false};
        emission.radiance.texture = 0;
        textured.emissions.push_back(emission);
        Mesh mesh =
            test::make_mesh({{{9, 9, 9}, {9, 9, 8}, {9, 8, 9}}, {{0, 1, 2}}, {}, {}});
        mesh.emission = 0;
        textured.groups[0].meshes.push_back(mesh);
        EXPECT_FALSE(look_small(lit_by(lamp, textured), floor)) << texel;
    }
}

}  // namespace
}  // namespace raykiln
