#include "render/film.h"

#include <gtest/gtest.h>

#include "light/light.h"
#include "render/renderer.h"
#include "shapes.h"

// Passes, and that the bits of an image depend on nothing but what it shows.

namespace raykiln {
namespace {

TEST(Passes, StartWithOneAndGoOnBySixteen) {
    const std::uint32_t ends[] = {1, 16, 32, 48, 64};
    std::uint32_t done = 0;
    for (const std::uint32_t end : ends) {
        EXPECT_EQ(next_pass(done, 1000), end);
        done = end;
    }
    EXPECT_EQ(next_pass(992, 1000), 1000u);
    EXPECT_EQ(next_pass(0, 1), 1u);
    EXPECT_EQ(next_pass(1, 5), 5u);
    EXPECT_EQ(next_pass(16, 20), 20u);
}

TEST(Passes, AnInterruptedPassEndsWhereItWouldHave) {
    // From any count, a pass ends where the pass that holds it ends.
    std::uint32_t start = 0;
    for (int pass = 0; pass < 12; ++pass) {
        const std::uint32_t end = next_pass(start, 10000);
        for (std::uint32_t done = start; done < end; ++done) {
            EXPECT_EQ(next_pass(done, 10000), end) << done;
        }
        start = end;
    }
}

TEST(Film, SumsRunsAndCounts) {
    Film film(3, 2, {true, true, true});
    PixelSums sums;
    sums.radiance = {1, 2, 3};
    sums.luminance_squared = 4;
    sums.albedo = {0.1f, 0.2f, 0.3f};
    sums.normal = {0, 0, 1};
    sums.depth = 7;
    sums.depth_weight = 1;
    film.add(1, 1, sums, 1);
    film.add(1, 1, sums, 2);
    EXPECT_EQ(film.count(1, 1), 2u);
    EXPECT_EQ(film.count(0, 1), 0u);
    EXPECT_EQ(film.radiance()[3 * 4 + 2], 6.0f);
    EXPECT_EQ(film.luminance_squared()[4], 8.0f);
    EXPECT_EQ(film.normal()[3 * 4 + 2], 2.0f);
    EXPECT_EQ(film.depth()[4], 14.0f);
    EXPECT_EQ(film.depth_weight()[4], 2.0f);
    EXPECT_EQ(film.radiance()[0], 0.0f);
    EXPECT_TRUE(Film(3, 2, {}).albedo().empty());
}

/// A lit, glossy corner with instances, enough to draw on every part of the renderer.
Scene small_scene() {
    test::Rng rng(171);
    Scene scene;
    test::add_white(scene);
    Material metal;
    ConductorMaterial rough;
    rough.surface.alpha_u.factor = rough.surface.alpha_v.factor = 0.2f;
    metal.kind = rough;
    scene.materials.push_back(metal);
    scene.emissions.push_back({ColorSlot{{4, 3, 2}}, true});
    scene.groups.resize(2);
    test::Triangles floor;
    floor.positions = {{-3, -1, -3}, {3, -1, -3}, {3, -1, 3}, {-3, -1, 3}};
    floor.faces = {{0, 2, 1}, {0, 3, 2}};
    scene.groups[0].meshes.push_back(test::make_mesh(floor));
    scene.groups[0].meshes.push_back(test::make_mesh(test::make_soup(2, 0.5f, rng)));
    scene.groups[0].meshes[1].emission = 0;
    Sphere ball;
    ball.radius = 0.4f;
    ball.material = 1;
    scene.groups[1].spheres.push_back(ball);
    for (int i = 0; i < 3; ++i) {
        scene.instances.push_back(test::make_instance(
            1, test::random_placement(Vec3f(1.0f), {rng.between(-1, 1), -0.5f, 0}, rng)));
    }
    EnvironmentLight sky;
    sky.scale = Vec3f(0.2f);
    scene.lights.emplace_back(sky);
    prepare_lights(scene);
    return scene;
}

class Images : public testing::Test {
  protected:
    Images() : scene_(small_scene()), accel_(scene_) {
        camera_.origin = {0, 0.5f, 4};
        camera_.tan_half_x = camera_.tan_half_y = 0.5f;
        options_.width = options_.crop_x1 = 40;
        options_.height = options_.crop_y1 = 33;
        options_.spp = 20;
        options_.layers = {true, true, true};
    }

    Renderer renderer() const { return {scene_, accel_, camera_, options_}; }

    /// Some tenths of a second a pass on any machine: polls come every 20 ms.
    void make_slow() {
        options_.width = options_.crop_x1 = 240;
        options_.height = options_.crop_y1 = 160;
        options_.spp = 4096;
        options_.threads = 1;
    }

    static void run(Renderer& r) {
        while (!r.finished()) {
            r.run_pass([](std::uint64_t) { return true; });
        }
    }

    static void expect_same(Film& a, Film& b) {
        EXPECT_EQ(a.counts(), b.counts());
        EXPECT_EQ(a.radiance(), b.radiance());
        EXPECT_EQ(a.luminance_squared(), b.luminance_squared());
        EXPECT_EQ(a.albedo(), b.albedo());
        EXPECT_EQ(a.normal(), b.normal());
        EXPECT_EQ(a.depth(), b.depth());
    }

    Scene scene_;
    Accel accel_;
    Camera camera_;
    RenderOptions options_;
};

TEST_F(Images, HaveTheSameBitsWhateverTheThreads) {
    options_.threads = 1;
    Renderer one = renderer();
    run(one);
    double sum = 0;
    for (const float r : one.film().radiance()) {
        sum += r;
    }
    EXPECT_GT(sum, 0.0);
    for (const int threads : {2, 5}) {
        options_.threads = threads;
        Renderer more = renderer();
        run(more);
        expect_same(one.film(), more.film());
        EXPECT_EQ(one.counts().camera, more.counts().camera);
        EXPECT_EQ(one.counts().bounce, more.counts().bounce);
        EXPECT_EQ(one.counts().shadow, more.counts().shadow);
    }
    EXPECT_EQ(one.counts().camera, 40u * 33u * 20u);
    EXPECT_EQ(one.counts().nonfinite, 0u);
}

TEST_F(Images, HaveTheSameBitsInParts) {
    Renderer whole = renderer();
    run(whole);
    // Tiles start elsewhere in a crop.
    options_.crop_x0 = 7;
    options_.crop_y0 = 5;
    options_.crop_x1 = 31;
    Renderer part = renderer();
    run(part);
    ASSERT_EQ(part.film().width(), 24);
    for (int y = 5; y < 33; ++y) {
        for (int x = 7; x < 31; ++x) {
            const auto in_whole = 3 * static_cast<std::size_t>(y * 40 + x);
            const auto in_part = 3 * static_cast<std::size_t>((y - 5) * 24 + x - 7);
            for (std::size_t c = 0; c < 3; ++c) {
                ASSERT_EQ(whole.film().radiance()[in_whole + c],
                          part.film().radiance()[in_part + c]);
            }
        }
    }
}

TEST_F(Images, HaveTheSameBitsWhenStoppedAndResumed) {
    Renderer undisturbed = renderer();
    run(undisturbed);
    Renderer first = renderer();
    for (int pass = 0; pass < 2; ++pass) {
        first.run_pass([](std::uint64_t) { return true; });
    }
    EXPECT_EQ(first.samples_done(), 16u);
    Renderer second = renderer();
    Film& film = second.film();
    film.radiance() = first.film().radiance();
    film.luminance_squared() = first.film().luminance_squared();
    film.albedo() = first.film().albedo();
    film.normal() = first.film().normal();
    film.depth() = first.film().depth();
    film.depth_weight() = first.film().depth_weight();
    film.counts() = first.film().counts();
    second.resume();
    EXPECT_EQ(second.samples_done(), 16u);
    run(second);
    expect_same(undisturbed.film(), film);
}

TEST_F(Images, HaveTheSameBitsAfterAStopInAPass) {
    make_slow();
    Renderer stopped = renderer();
    // Stops in the middle of whichever passes last longer than a poll, and goes on.
    int stops = 0;
    while (stops < 3 && !stopped.finished()) {
        const bool ran = stopped.run_pass([](std::uint64_t) { return false; });
        stops += !ran;
    }
    ASSERT_EQ(stops, 3);
    const auto& counts = stopped.film().counts();
    EXPECT_NE(counts.front(), counts.back()) << "stopped between passes, not in one";
    stopped.run_pass([](std::uint64_t) { return true; });
    options_.spp = stopped.samples_done();
    options_.threads = 0;
    Renderer undisturbed = renderer();
    run(undisturbed);
    expect_same(undisturbed.film(), stopped.film());
}

TEST_F(Images, DifferBySeed) {
    options_.spp = 1;
    Renderer a = renderer();
    run(a);
    options_.seed = 1;
    Renderer b = renderer();
    run(b);
    EXPECT_NE(a.film().radiance(), b.film().radiance());
}

TEST_F(Images, ErrorsInAPollStopTheRunAndPassThrough) {
    make_slow();
    Renderer r = renderer();
    const auto run_all = [&] {
        while (!r.finished()) {
            r.run_pass([](std::uint64_t) -> bool { throw std::runtime_error("enough"); });
        }
    };
    EXPECT_THROW(run_all(), std::runtime_error);
    EXPECT_FALSE(r.finished());
}

}  // namespace
}  // namespace raykiln
