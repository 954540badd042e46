#include "guide/caustic_guide.h"

#include <gtest/gtest.h>

#include "guides.h"
#include "math/wide.h"

// The guide's density against what it draws, and where it knows of light.

namespace raykiln {
namespace {

using test::add_square;
using test::aside;
using test::guide_of_places;
using test::learned;
using test::near_direction;
using test::Place;
using test::places;
using test::Rng;
using test::up;

/// A map of the sphere to itself about +z that a lobe of width `a` there makes uniform.
struct Zoom {
    double a;

    Vec3f out_of(const Vec3f& looked_at) const {
        const double ring = std::hypot(looked_at.x, looked_at.y);
        const double t = looked_at.z > 0 ? ring * ring / (1 + double(looked_at.z))
                                         : 1 - double(looked_at.z);
        const double plain = a * t / (a + 2 - t);
        const double scale = ring > 0 ? std::sqrt(plain * (2 - plain)) / ring : 0.0;
        return {static_cast<float>(looked_at.x * scale),
                static_cast<float>(looked_at.y * scale), static_cast<float>(1 - plain)};
    }
    Vec3f into(const Vec3f& direction) const {
        const double ring = std::hypot(direction.x, direction.y);
        const double plain = direction.z > 0 ? ring * ring / (1 + double(direction.z))
                                             : 1 - double(direction.z);
        const double t = (a + 2) * plain / (plain + a);
        const double phi =
            std::atan2(static_cast<double>(direction.y), double(direction.x));
        return test::direction_at(std::acos(std::max(1 - t, -1.0)), phi);
    }
    double stretch(const Vec3f& looked_at) const {
        const double left = a + 1 + double(looked_at.z);
        return a * (a + 2) / (left * left);
    }
};

TEST(CausticGuide, DrawsByItsDensityWhichIntegratesToOne) {
    const CausticGuide guide = guide_of_places();
    constexpr int samples = 500000;
    for (const Place& place : places) {
        const GuideAt<float> at = guide.find(place.p, true);
        ASSERT_GT(at.share, 0.3f) << place.name;
        const Zoom zoom{place.zoom};
        const auto density = [&](const Vec3f& d) {
            return zoom.stretch(d) * double(guide.pdf(at, zoom.out_of(d)));
        };
        std::vector<double> expected = test::integrate_over_bins(density, 8);
        const double mass = std::accumulate(expected.begin(), expected.end(), 0.0);
        EXPECT_NEAR(mass, 1.0, 5e-4) << place.name;
        for (double& e : expected) {
            e *= samples / mass;
        }
        std::vector<double> observed(expected.size());
        Rng rng(202);
        for (int i = 0; i < samples; ++i) {
            const Vec3f d = guide.sample(at, rng.unit(), rng.unit(), rng.unit());
            ASSERT_NEAR(length(d), 1.0f, 1e-6f);
            ++observed[test::bin_of(zoom.into(d))];
        }
        const auto result = test::chi_squared_test(observed, expected);
        EXPECT_GT(result.p_value, test::sidak(std::size(places)))
            << place.name << ": " << result;
        EXPECT_EQ(result.impossible, 0) << place.name << ": " << result;
    }
}

TEST(CausticGuide, LooksWhereThePhotonsCameFrom) {
    const CausticGuide guide = guide_of_places();
    const auto share_within = [&](const Place& place, const Vec3f& of, float cosine) {
        const GuideAt<float> at = guide.find(place.p, true);
        Rng rng(203);
        constexpr int samples = 20000;
        int within = 0;
        for (int i = 0; i < samples; ++i) {
            within +=
                dot(guide.sample(at, rng.unit(), rng.unit(), rng.unit()), of) > cosine;
        }
        return static_cast<double>(within) / samples;
    };
    EXPECT_GT(share_within(places[0], up, 0.9999f), 0.5);
    EXPECT_LT(share_within(places[1], up, 0.99f), 0.05);
    EXPECT_GT(share_within(places[2], up, 0.999f), 0.3);
    EXPECT_GT(share_within(places[2], aside, 0.8f), 0.3);
}

TEST(CausticGuide, KnowsNothingElsewhere) {
    const CausticGuide guide = guide_of_places();
    const auto knows = [&](const Vec3f& p, bool wanted) {
        const GuideAt<float> at = guide.find(p, wanted);
        EXPECT_EQ(at.share > 0.0f, at.count > 0u);
        EXPECT_EQ(at.share > 0.0f, guide.pdf(at, up) > 0.0f);
        return at.share > 0.0f;
    };
    EXPECT_TRUE(knows({0, 0, 0}, true));
    EXPECT_FALSE(knows({0, 0, 0}, false));
    for (const float side : {-1.0f, 1.0f}) {
        EXPECT_FALSE(knows({side * 4.7f, 0, 0}, true));
        EXPECT_FALSE(knows({0, side * 0.7f, 0}, true));
        EXPECT_FALSE(knows({0, 0, side * 0.2f}, true));
    }
    EXPECT_FALSE(knows(Vec3f(std::nanf("")), true));
    EXPECT_FALSE(knows(Vec3f(infinity), true));
}

TEST(CausticGuide, NeedsAFewPhotons) {
    for (const std::size_t count : {0u, 1u, 11u, 12u}) {
        Rng rng(204);
        std::vector<Photon> photons;
        add_square(photons, count, Vec3f(0.0f), rng, [&](std::size_t) { return up; });
        const CausticGuide guide = learned(std::move(photons));
        EXPECT_EQ(guide.empty(), count < 12);
        EXPECT_EQ(guide.size(), count < 12 ? 0 : count);
        EXPECT_EQ(guide.find(Vec3f(0.0f), true).share > 0.0f, count >= 12);
    }
}

TEST(CausticGuide, LeavesOutCellsThatAreNotWorthIt) {
    // As much light on a square metre, and spread over a square kilometre.
    for (const float size : {1.0f, 1000.0f}) {
        Rng rng(205);
        std::vector<Photon> photons;
        add_square(photons, 5000, Vec3f(0.0f), rng,
                   [&](std::size_t) { return near_direction(up, 0.01f, rng); });
        for (Photon& photon : photons) {
            photon.p = photon.p * size;
        }
        EXPECT_EQ(learned(std::move(photons), 5000.0f).empty(), size > 1.0f);
    }
}

TEST(CausticGuide, TakesPhotonsThatAreAllTheSame) {
    const Vec3f p{1, 2, 3};
    for (const std::size_t count : {12u, 1000u}) {
        const CausticGuide guide = learned(std::vector<Photon>(count, {p, aside}));
        const GuideAt<float> at = guide.find(p, true);
        ASSERT_GT(at.share, 0.0f);
        ASSERT_LT(at.share, 0.5f);
        Rng rng(206);
        int close = 0;
        for (int i = 0; i < 1000; ++i) {
            const Vec3f d = guide.sample(at, rng.unit(), rng.unit(), rng.unit());
            ASSERT_TRUE(is_finite(d));
            const float pdf = guide.pdf(at, d);
            ASSERT_TRUE(std::isfinite(pdf) && pdf > 0.0f);
            close += dot(d, aside) > 0.9999f;
        }
        EXPECT_GT(close, 700);
        EXPECT_EQ(guide.find(p + Vec3f(1e-3f), true).share, 0.0f);
    }
}

TEST(CausticGuide, ACellKnowsNoPhotonsOfFarAwayOnes) {
    // Numbers of photons at which a half has just as many as the wider cells begin with.
    Rng rng(207);
    std::vector<Photon> photons;
    add_square(photons, 193, {-4, 0, 0}, rng, [&](std::size_t) { return aside; });
    add_square(photons, 193, {4, 0, 0}, rng, [&](std::size_t) { return up; });
    const CausticGuide guide = learned(std::move(photons));
    // Nothing but the tails of lobes of least width: 1e-5 / (2 pi t^2), t = 0.2.
    for (int i = 0; i < 1000; ++i) {
        const Vec3f off(rng.between(-0.45f, 0.45f), rng.between(-0.45f, 0.45f), 0.0f);
        const GuideAt<float> left = guide.find(Vec3f(-4, 0, 0) + off, true);
        const GuideAt<float> right = guide.find(Vec3f(4, 0, 0) + off, true);
        ASSERT_LT(guide.pdf(left, up), 1e-4f);
        ASSERT_LT(guide.pdf(right, aside), 1e-4f);
    }
}

TEST(CausticGuide, RoundingOfAPointOnAWallDoesNotChooseItsCell) {
    for (const float side : {-1.0f, 1.0f}) {
        const float wall = side * 1.55f;
        Rng rng(209);
        std::vector<Photon> photons;
        for (int i = 0; i < 3000; ++i) {
            const float y = rng.between(-1, 1), along = rng.between(0, 2);
            const Vec3f on_wall(std::nextafter(wall, i % 3 - 1.0f), y, along);
            photons.push_back(
                {i % 2 == 0 ? on_wall : Vec3f(wall - side * along, y, 0), up});
        }
        const CausticGuide guide = learned(std::move(photons));
        for (int i = 0; i < 1000; ++i) {
            const float y = rng.between(-0.9f, 0.9f), z = rng.between(0.1f, 1.9f);
            const auto in = guide.find(Vec3f(std::nextafter(wall, 0.0f), y, z), true);
            const auto out =
                guide.find(Vec3f(std::nextafter(wall, side * 2), y, z), true);
            ASSERT_EQ(in.first, out.first);
            ASSERT_GT(in.share, 0.0f);
        }
    }
}

TEST(CausticGuide, LanesAreAsOneNumberIs) {
    const CausticGuide guide = guide_of_places();
    constexpr int width = NumberTraits<Wide>::width;
    Rng rng(208);
    int known = 0;
    for (int i = 0; i < 20000; ++i) {
        Vec3f p[width];
        float u[width][3];
        Vec3<Wide> all_p;
        Wide all_u[3];
        const std::uint32_t wanted = rng.below(1u << width);
        for (int lane = 0; lane < width; ++lane) {
            p[lane] = {rng.between(-6, 6), rng.between(-0.6f, 0.6f),
                       rng.below(4) == 0 ? rng.between(-0.2f, 0.2f) : 0.0f};
            set_lane(all_p, lane, p[lane]);
            for (int k = 0; k < 3; ++k) {
                u[lane][k] = rng.below(64) == 0 ? one_minus_epsilon : rng.unit();
                all_u[k].set_lane(lane, u[lane][k]);
            }
        }
        const auto at = guide.find(all_p, WideMask::of_bits(wanted));
        const Vec3<Wide> drawn = guide.sample(at, all_u[0], all_u[1], all_u[2]);
        const Wide pdf = guide.pdf(at, drawn);
        for (int lane = 0; lane < width; ++lane) {
            const auto one = guide.find(p[lane], ((wanted >> lane) & 1u) != 0);
            ASSERT_EQ(at.share.lane(lane), one.share);
            ASSERT_EQ(at.first.lane(lane), one.first);
            ASSERT_EQ(at.count.lane(lane), one.count);
            const Vec3f d = guide.sample(one, u[lane][0], u[lane][1], u[lane][2]);
            const Vec3f lane_d = lane_of(drawn, lane);
            ASSERT_TRUE(lane_d.x == d.x && lane_d.y == d.y && lane_d.z == d.z);
            ASSERT_EQ(pdf.lane(lane), guide.pdf(one, d));
            known += one.share > 0.0f;
        }
    }
    EXPECT_GT(known, 1000);
}

}  // namespace
}  // namespace raykiln
