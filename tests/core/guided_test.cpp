#include "integrator/guided.h"

#include <gtest/gtest.h>

#include "bsdf_cases.h"
#include "guides.h"

// Directions of a BSDF mixed with those of a guide, against the BSDF alone.

namespace raykiln {
namespace {

using test::guide_of_places;
using test::Place;
using test::places;
using test::Rng;
using test::up;

/// A surface on which the lights of `places` fall, seen at an angle.
struct Receiver {
    const test::BsdfCase& bsdf_case;
    int degrees;
    const Place& place;
    Frame<float> shading = frame_of_normal(normalize(Vec3f(0.5f, -0.3f, 0.7f)));

    Vec3f dir_out() const { return test::direction_of_degrees(degrees); }
};

std::vector<Receiver> receivers() {
    static const std::vector<test::BsdfCase> smooth{
        {"plastic_dark", test::plastic(Vec3f(0.02f), 0.0f, false, false)}};
    std::vector<Receiver> all;
    for (const auto* cases : {&test::bsdf_cases(), &smooth}) {
        for (const test::BsdfCase& c : *cases) {
            for (const int degrees : {0, 60}) {
                all.push_back({c, degrees, places[0]});
                all.push_back({c, degrees, places[2]});
            }
        }
    }
    return all;
}

BsdfSample<float> draw_guided(const CausticGuide& guide, const GuideAt<float>& at,
                              const Receiver& r, Rng& rng) {
    const BsdfRandom<float> u{rng.unit(), rng.unit(), rng.unit()};
    return std::visit(
        [&](const auto& bsdf) {
            return sample_guided(guide, at, bsdf, r.shading, r.dir_out(), u);
        },
        r.bsdf_case.bsdf);
}

/// Means of the light scattered, of parts of it, and of where it comes from.
struct Scattered {
    static constexpr int count = 5;
    test::Moments of[count];

    void add(const Receiver& r, const BsdfSample<float>& s) {
        const Vec3f d = s.dir_in;
        const float y = s.weight.y;
        const bool lit = dot(r.shading.to_world(d), up) > 0.95f;
        const float parts[count] = {s.weight.x, y * d.x, y * d.z * d.z, lit ? y : 0.0f,
                                    s.specular ? y : 0.0f};
        for (int i = 0; i < count; ++i) {
            of[i].add(parts[i]);
        }
    }
};

TEST(SampleGuided, MixtureHasTheMeansOfTheBsdf) {
    const CausticGuide guide = guide_of_places();
    const std::vector<Receiver> all = receivers();
    constexpr int samples = 100000;
    Rng rng(211);
    for (const Receiver& r : all) {
        const GuideAt<float> at = guide.find(r.place.p, true);
        Scattered mixed, plain;
        for (int i = 0; i < samples; ++i) {
            mixed.add(r, draw_guided(guide, at, r, rng));
            const BsdfRandom<float> u{rng.unit(), rng.unit(), rng.unit()};
            plain.add(r, sample(r.bsdf_case.bsdf, r.dir_out(), u));
        }
        for (int i = 0; i < Scattered::count; ++i) {
            const test::Moments &a = mixed.of[i], &b = plain.of[i];
            const double error = std::hypot(a.standard_error(), b.standard_error());
            const double gap = std::fabs(a.mean() - b.mean());
            // Rounding of weights that are all alike.
            const double p = gap < 1e-6 ? 1.0 : test::normal_two_sided(gap / error);
            EXPECT_GT(p, test::sidak(all.size() * Scattered::count))
                << r.bsdf_case.name << " at " << r.degrees << ", " << r.place.name
                << " light, part " << i << ": " << a.mean() << " for " << b.mean();
        }
    }
}

TEST(SampleGuided, WeightIsTheValueOverTheDensityOfTheMixture) {
    const CausticGuide guide = guide_of_places();
    for (const Receiver& r : receivers()) {
        const GuideAt<float> at = guide.find(r.place.p, true);
        Rng rng(212);
        int close = 0;
        for (int i = 0; i < 5000; ++i) {
            const BsdfSample<float> s = draw_guided(guide, at, r, rng);
            ASSERT_TRUE(is_finite(s.weight) && s.eta > 0.0f);
            const Vec3f world = r.shading.to_world(s.dir_in);
            close += dot(world, up) > 0.99f;
            if (s.specular || max_component(s.weight) <= 0.0f) {
                continue;
            }
            const BsdfValue<float> v = evaluate(r.bsdf_case.bsdf, r.dir_out(), s.dir_in);
            ASSERT_EQ(s.pdf_solid_angle, v.pdf_solid_angle);
            const float pdf =
                lerp(v.pdf_solid_angle, guide.pdf(at, normalize(world)), at.share);
            // The densities of narrow lobes change within a rounding of a direction.
            ASSERT_NEAR(s.weight.y * pdf, v.value.y, 2e-3f * v.value.y)
                << r.bsdf_case.name;
        }
        EXPECT_GT(close, 5000 * (r.place.zoom < 1e-4 ? 0.3 : 0.1)) << r.bsdf_case.name;
    }
}

TEST(SampleGuided, IsTheBsdfAloneWhereTheGuideKnowsNothing) {
    const CausticGuide guide = guide_of_places();
    const Receiver r{test::bsdf_cases()[12], 30, places[0]};
    Rng guided(213), alone(213);
    for (int i = 0; i < 1000; ++i) {
        const auto a = draw_guided(guide, GuideAt<float>{}, r, guided);
        const BsdfRandom<float> u{alone.unit(), alone.unit(), alone.unit()};
        const auto b = sample(r.bsdf_case.bsdf, r.dir_out(), u);
        ASSERT_EQ(a.weight.x, b.weight.x);
        ASSERT_EQ(a.dir_in.x, b.dir_in.x);
        ASSERT_EQ(a.eta, b.eta);
    }
}

}  // namespace
}  // namespace raykiln
