#include <gtest/gtest.h>
#include <tbb/global_control.h>

#include "accel/accel.h"
#include "shapes.h"

// Watertightness: no ray from inside a closed mesh gets out through an edge.

namespace raykiln {
namespace {

using test::Rng;

struct Closed {
    test::Triangles triangles;
    Scene scene;
};

Closed closed_mesh(int levels, const Vec3f& center, float radius, float bumps,
                   std::uint64_t seed) {
    Rng rng(seed);
    Closed c{test::make_ball(levels, center, radius, bumps, rng), {}};
    c.scene.groups[0].meshes.push_back(test::make_mesh(c.triangles));
    return c;
}

/// A target on an edge of a random triangle; in one of three cases at its end.
Vec3f edge_point(const test::Triangles& t, Rng& rng, bool& vertex) {
    const auto& face = t.faces[rng.below(static_cast<std::uint32_t>(t.faces.size()))];
    const std::uint32_t side = rng.below(3);
    const Vec3f& a = t.positions[face[side]];
    const Vec3f& b = t.positions[face[(side + 1) % 3]];
    vertex = rng.below(3) == 0;
    return vertex ? a : lerp(a, b, rng.between(1e-4f, 1.0f - 1e-4f));
}

TEST(Watertight, NothingEscapesThroughSharedEdges) {
    // Both triangles at an edge compute the same product of it with the ray, up to the
    // sign, so that one of them is hit. At a vertex the products of several edges are
    // rounded each for itself: of rays aimed at one exactly, Embree loses some
    // thousandths (0.1 % of them with SSE, 0.3 % with fused multiply-add, over meshes
    // like these).
    const Closed meshes[] = {closed_mesh(1, {0, 0, 0}, 1.0f, 0.2f, 101),
                             closed_mesh(4, {0, 0, 0}, 1.0f, 0.02f, 102),
                             closed_mesh(3, {100, -50, 20}, 0.5f, 0.0f, 103),
                             closed_mesh(2, {0, 0, 0}, 1000.0f, 0.1f, 104)};
    constexpr int rays = 100000;
    for (const Closed& c : meshes) {
        const Accel accel(c.scene);
        Rng rng(105);
        const Bounds box = accel.bounds();
        int lost_at_vertices = 0;
        for (int i = 0; i < rays; ++i) {
            // Well inside: the radius varies by 0.2 at most.
            const float depth = 0.2f * box.extent().x * rng.unit();
            const Vec3f origin = box.center() + test::random_direction(rng) * depth;
            bool vertex;
            const Vec3f d = edge_point(c.triangles, rng, vertex) - origin;
            const Ray ray{origin, i % 2 == 0 ? normalize(d) : d};
            const bool hit = accel.intersect(ray).valid();
            ASSERT_EQ(accel.occluded(ray), hit);
            ASSERT_TRUE(hit || vertex) << i;
            lost_at_vertices += !hit;
        }
        EXPECT_LT(lost_at_vertices, rays / 3 / 100);
    }
}

/// Hits of rays through shared edges, where the order of the hierarchy could decide.
std::vector<Hit> edge_hits(const Closed& c, int threads) {
    const tbb::global_control limit(tbb::global_control::max_allowed_parallelism,
                                    static_cast<std::size_t>(threads));
    const Accel accel(c.scene);
    Rng rng(106);
    std::vector<Hit> hits;
    for (int i = 0; i < 50000; ++i) {
        bool vertex;
        const Vec3f target = edge_point(c.triangles, rng, vertex);
        const Vec3f origin = test::random_direction(rng) * (2.0f * rng.unit());
        hits.push_back(accel.intersect({origin, target - origin}));
    }
    return hits;
}

TEST(Watertight, HitsAreTheSameWhateverThreadsBuild) {
    // 81,920 triangles: enough for the build to go parallel.
    const Closed c = closed_mesh(6, {0, 0, 0}, 1.0f, 0.01f, 107);
    const std::vector<Hit> one = edge_hits(c, 1);
    for (const int threads : {1, 2, 5}) {
        const std::vector<Hit> other = edge_hits(c, threads);
        for (std::size_t i = 0; i < one.size(); ++i) {
            ASSERT_EQ(one[i].primitive, other[i].primitive) << i << " with " << threads;
            ASSERT_EQ(one[i].t, other[i].t);
            ASSERT_EQ(one[i].u, other[i].u);
            ASSERT_EQ(one[i].v, other[i].v);
        }
    }
}

}  // namespace
}  // namespace raykiln
