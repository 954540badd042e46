#include <gtest/gtest.h>

#include "bsdf/ggx_albedo.h"
#include "bsdf_cases.h"

// No BSDF makes energy, lossless ones keep all of it, and all are reciprocal.

namespace raykiln {
namespace {

using test::Rng;

/// Share of a white surrounding's light that a BSDF sends to dir_out (of radiance over
/// the square of the index), by a grid of `side`^2 sample positions for each of the
/// lobes' choices.
Vec3f furnace(const Bsdf& bsdf, const Vec3f& out, int side = 128, int lobes = 4) {
    double sum[3] = {0, 0, 0};
    for (int l = 0; l < lobes; ++l) {
        for (int i = 0; i < side; ++i) {
            for (int j = 0; j < side; ++j) {
                // Lattice points, shifted from lobe to lobe.
                const auto n = static_cast<float>(side);
                const float shift =
                    (static_cast<float>(l) + 0.5f) / static_cast<float>(lobes);
                const float x = (static_cast<float>(i) + shift) / n;
                const float y = (static_cast<float>(j) + shift) / n;
                // A choice that fits no lobe's probability falls anywhere between two.
                float lobe = shift + 0.618034f * static_cast<float>(i * side + j);
                lobe -= std::floor(lobe);
                const auto s = sample(bsdf, out, {min(lobe, one_minus_epsilon), x, y});
                const double scale = double(s.eta) * s.eta;
                sum[0] += s.weight.x * scale;
                sum[1] += s.weight.y * scale;
                sum[2] += s.weight.z * scale;
            }
        }
    }
    const double n = double(lobes) * side * side;
    return {static_cast<float>(sum[0] / n), static_cast<float>(sum[1] / n),
            static_cast<float>(sum[2] / n)};
}

struct Rough {
    float alpha;
    float kept;
};
// One scattering alone loses the light that meets the surface again: within 60 degrees,
// at least this share stays with a mirror or glass (found here; less would be a step
// back).
constexpr Rough rough[] = {
    {0.02f, 0.99f}, {0.1f, 0.95f}, {0.3f, 0.75f}, {0.6f, 0.55f}, {1.0f, 0.28f}};
const std::vector<int> above_angles{0, 15, 30, 45, 60, 70, 80, 85, 88};

// 65,536 points of a lattice: 1e-3 covers what the quadrature leaves where a weight
// jumps.
constexpr float quadrature = 1e-3f;

TEST(Furnace, EveryCaseAtEveryAngle) {
    for (const test::BsdfCase& c : test::bsdf_cases()) {
        for (const int degrees : test::angles_of(c)) {
            const Vec3f e = furnace(c.bsdf, test::direction_of_degrees(degrees));
            EXPECT_LE(max_component(e), 1 + quadrature) << c.name << " at " << degrees;
            EXPECT_GT(max_component(e), 0.2f) << c.name << " at " << degrees;
        }
    }
}

TEST(Furnace, LosslessSurfacesKeepAll) {
    const Dielectric<float> smooth{1.5f, Vec3f(1.0f), Vec3f(1.0f), {}, true, false};
    const Dielectric<float> thin{1.5f, Vec3f(1.0f), Vec3f(1.0f), {}, true, true};
    const Conductor<float> perfect{Vec3f(0.0f), Vec3f(1.0f), Vec3f(1.0f), {}, true};
    for (const int degrees : above_angles) {
        const Vec3f out = test::direction_of_degrees(degrees);
        // Products of a handful of rounded numbers.
        EXPECT_NEAR(furnace(smooth, out).x, 1.0f, 1e-6f);
        EXPECT_NEAR(furnace(smooth, -out).x, 1.0f, 1e-6f);
        EXPECT_NEAR(furnace(thin, out).x, 1.0f, 1e-6f);
        EXPECT_NEAR(furnace(perfect, out).x, 1.0f, 1e-6f);
        EXPECT_NEAR(furnace(Diffuse<float>{Vec3f(1.0f)}, out).x, 1.0f, 1e-6f);
    }
}

TEST(Furnace, SmoothPlasticOverWhiteKeepsAll) {
    // What enters the coat leaves it in the end, if the base absorbs nothing.
    for (const bool nonlinear : {false, true}) {
        const Bsdf white = test::plastic(Vec3f(1.0f), 0.0f, false, nonlinear);
        for (const int degrees : above_angles) {
            const Vec3f e = furnace(white, test::direction_of_degrees(degrees));
            EXPECT_NEAR(e.x, 1.0f, 2 * quadrature) << degrees;
        }
    }
}

/// Least energy within 60 degrees: 1 - that is what single scattering loses. Fails where
/// any angle, up to 88 degrees, gives more than came.
float least_energy(const Bsdf& bsdf, bool both_sides, const std::string& what,
                   float excess = 0.0f) {
    float least = 1.0f;
    for (const int degrees : above_angles) {
        for (const float side : {1.0f, -1.0f}) {
            if (side < 0.0f && !both_sides) {
                continue;
            }
            const Vec3f out = test::direction_of_degrees(degrees) * side;
            const float e = max_component(furnace(bsdf, out));
            EXPECT_LE(e, 1 + quadrature + excess) << what << " at " << degrees * side;
            least = degrees <= 60 ? min(least, e) : least;
        }
    }
    return least;
}

std::string name_of(const Microfacet<float>& mf) {
    return std::string(mf.beckmann ? "beckmann " : "ggx ") + std::to_string(mf.alpha_x);
}

TEST(Furnace, RoughMirrorsMakeNoEnergy) {
    for (const bool is_beckmann : {false, true}) {
        float last = 1.0f;
        for (const Rough& r : rough) {
            const Microfacet<float> mf{r.alpha, r.alpha, is_beckmann};
            const float least = least_energy(test::mirror(mf), false, name_of(mf));
            EXPECT_GT(least, r.kept) << name_of(mf);
            EXPECT_LE(least, last + quadrature) << "the rougher, the more is lost";
            last = least;
        }
    }
}

TEST(Furnace, RoughGlassMakesNoEnergy) {
    for (const float eta : {1.1f, 1.5f, 2.4f}) {
        for (const bool is_beckmann : {false, true}) {
            for (const Rough& r : rough) {
                const Microfacet<float> mf{r.alpha, r.alpha, is_beckmann};
                const std::string what = name_of(mf) + " eta " + std::to_string(eta);
                EXPECT_GT(least_energy(test::glass(eta, mf), true, what), r.kept) << what;
            }
        }
    }
}

TEST(Furnace, RoughPlasticMakesNoEnergy) {
    // What the coat's two crossings lose adds up.
    constexpr Rough coats[] = {
        {0.05f, 0.95f}, {0.1f, 0.9f}, {0.3f, 0.65f}, {0.6f, 0.4f}, {1.0f, 0.25f}};
    for (const bool nonlinear : {false, true}) {
        for (const Rough& r : coats) {
            const auto b = test::plastic(Vec3f(1.0f), r.alpha, false, nonlinear);
            const std::string what = "plastic " + std::to_string(r.alpha);
            EXPECT_GT(least_energy(b, false, what), r.kept) << what;
        }
    }
}

/// Albedo of a GGX surface towards a direction for Schlick's two ends, by a fine grid.
GgxAlbedo<float> fine_albedo(float alpha, const Vec3f& out) {
    constexpr int side = 256;
    const Microfacet<float> facet = test::ggx(alpha, alpha);
    double sums[2] = {0, 0};
    for (int i = 0; i < side * side; ++i) {
        const float u = (static_cast<float>(i / side) + 0.5f) / side;
        const float v = (static_cast<float>(i % side) + 0.5f) / side;
        const Vec3f m = sample_microfacet(facet, out, u, v);
        const Vec3f in = reflect(out, m);
        const float pdf = pdf_microfacet(facet, out, m) / (4 * dot(out, m));
        if (in.z <= 0.0f || !(pdf > 0.0f)) {
            continue;
        }
        const double weight = microfacet_d(facet, m) *
                              ggx_visibility_correlated(facet, out, in) * in.z / pdf;
        const double schlick = std::pow(1.0 - dot(out, m), 5);
        sums[0] += weight * (1 - schlick) / (side * side);
        sums[1] += weight * schlick / (side * side);
    }
    return {static_cast<float>(sums[0]), static_cast<float>(sums[1])};
}

// What interpolation between the table's nodes may leave of its error: near grazing
// angles of nearly smooth surfaces the albedo bends by 0.05 between two nodes, an eighth
// of which is the error of a straight line.
constexpr float table_error = 0.05f / 8;

TEST(Furnace, TableOfAlbedos) {
    for (const float roughness : {0.0f, 0.05f, 0.1f, 0.2f, 0.45f, 0.7f, 1.0f}) {
        for (const int degrees : above_angles) {
            const float alpha = max(roughness * roughness, min_alpha);
            const Vec3f out = test::direction_of_degrees(degrees);
            const GgxAlbedo<float> exact = fine_albedo(alpha, out);
            const GgxAlbedo<float> found = ggx_albedo(alpha, out.z);
            EXPECT_NEAR(found.at_f0, exact.at_f0, table_error)
                << roughness << ", " << degrees;
            EXPECT_NEAR(found.at_f90, exact.at_f90, table_error)
                << roughness << ", " << degrees;
        }
    }
}

TEST(Furnace, PrincipledMakesNoEnergy) {
    for (const float roughness : {0.0f, 0.1f, 0.2f, 0.5f, 1.0f}) {
        for (const float metallic : {0.0f, 0.5f, 1.0f}) {
            for (const float transmission : {0.0f, 0.5f, 1.0f}) {
                const auto b =
                    test::principled(Vec3f(1.0f), metallic, roughness, transmission);
                const std::string what = "roughness " + std::to_string(roughness) +
                                         " metallic " + std::to_string(metallic) +
                                         " transmission " + std::to_string(transmission);
                const float share = (1 - metallic) * (1 - transmission);
                EXPECT_GT(least_energy(b, false, what, share * table_error),
                          rough[4].kept)
                    << what;
            }
        }
    }
}

TEST(Furnace, WhitePrincipledBaseKeepsAll) {
    for (const float roughness : {0.0f, 0.1f, 0.2f, 0.5f, 1.0f}) {
        const auto b = test::principled(Vec3f(1.0f), 0.0f, roughness, 0.0f);
        for (const int degrees : above_angles) {
            const Vec3f e = furnace(b, test::direction_of_degrees(degrees));
            EXPECT_NEAR(e.x, 1.0f, quadrature + table_error)
                << roughness << ", " << degrees;
        }
    }
}

// Reciprocity: f(a, b) = f(b, a) for reflection; f(a, b) / eta_a^2 = f(b, a) / eta_b^2
// through an interface, as radiance over the squared index is what is kept (Veach 1997,
// section 5.2). Both sides are computed from the same numbers in another order: relative
// errors of some ulp, magnified by the distributions' slopes (at most 1 / alpha^2 = 100).
constexpr double reciprocity = 2e-4;

void expect_same(double there, double back, const std::string& what) {
    ASSERT_NEAR(there, back, reciprocity * std::max(there, back) + 1e-9) << what;
}

TEST(Reciprocity, Reflection) {
    Rng rng(71);
    for (const test::BsdfCase& c : test::bsdf_cases()) {
        int compared = 0;
        for (int i = 0; i < 20000; ++i) {
            Vec3f a = test::random_direction(rng), b = test::random_direction(rng);
            if (a.z * b.z <= 0.0f || min(std::fabs(a.z), std::fabs(b.z)) < 0.02f) {
                continue;
            }
            if (!c.transmissive) {
                a.z = std::fabs(a.z);
                b.z = std::fabs(b.z);
            }
            const Vec3f there = evaluate(c.bsdf, a, b).value / std::fabs(b.z);
            const Vec3f back = evaluate(c.bsdf, b, a).value / std::fabs(a.z);
            expect_same(there.x, back.x, c.name);
            expect_same(there.y, back.y, c.name);
            expect_same(there.z, back.z, c.name);
            compared += there.x > 1e-6f;
        }
        EXPECT_GT(compared, 1000) << c.name;
    }
}

TEST(Reciprocity, RefractionUpToTheSquaredIndex) {
    Rng rng(72);
    for (const test::BsdfCase& c : test::bsdf_cases()) {
        const auto* glass = std::get_if<Dielectric<float>>(&c.bsdf);
        if (glass == nullptr) {
            continue;
        }
        int compared = 0;
        for (int i = 0; i < 50000; ++i) {
            const Vec3f a = test::random_direction(rng), b = test::random_direction(rng);
            if (a.z <= 0.02f || b.z >= -0.02f) {
                continue;
            }
            // Near total reflection 1 - F goes with the root of a difference, whose
            // relative error is 1e-7 eta^2 / cos^2: below `reciprocity` from a cosine of
            // 0.05 on.
            const Vec3f m = normalize(a + b * glass->eta);
            if (min(std::fabs(dot(a, m)), std::fabs(dot(b, m))) < 0.05f) {
                continue;
            }
            const double there = evaluate(c.bsdf, a, b).value.x / std::fabs(b.z);
            const double back = evaluate(c.bsdf, b, a).value.x / std::fabs(a.z);
            // a is outside (index 1), b inside (index eta).
            expect_same(there * double(glass->eta) * glass->eta, back, c.name);
            compared += there > 1e-6;
        }
        EXPECT_GT(compared, 1000) << c.name;
    }
}

TEST(Reciprocity, TransmissionThroughAPane) {
    // Seen from the other side the frame is turned; the pane is isotropic.
    Rng rng(73);
    for (const float transmission : {0.5f, 1.0f}) {
        const auto pane = test::principled({0.8f, 0.5f, 0.2f}, 0.2f, 0.5f, transmission);
        for (int i = 0; i < 20000; ++i) {
            Vec3f a = test::random_direction(rng), b = test::random_direction(rng);
            if (min(std::fabs(a.z), std::fabs(b.z)) < 0.02f) {
                continue;
            }
            a.z = std::fabs(a.z);
            b.z = -std::fabs(b.z);
            const Vec3f a_turned{a.x, a.y, -a.z}, b_turned{b.x, b.y, -b.z};
            const Vec3f there = evaluate(pane, a, b).value / std::fabs(b.z);
            const Vec3f back = evaluate(pane, b_turned, a_turned).value / std::fabs(a.z);
            expect_same(there.x, back.x, "pane");
            expect_same(there.z, back.z, "pane");
        }
    }
}

TEST(Microfacets, ProjectToTheirSurface) {
    // The projected area of all facets is that of the surface, and that of the visible
    // ones is the cosine (Heitz 2014, equations 4 and 16), by Monte Carlo over the
    // sphere's half.
    for (const bool is_beckmann : {false, true}) {
        for (const float alpha : {0.2f, 0.5f, 1.0f}) {
            const Microfacet<float> mf{alpha, 0.5f * alpha, is_beckmann};
            const auto density = [&](const Vec3f& m) {
                return microfacet_d(mf, m) * max(m.z, 0.0f);
            };
            const auto masses = test::integrate_over_bins(density, 6);
            const double sum = std::accumulate(masses.begin(), masses.end(), 0.0);
            EXPECT_NEAR(sum, 1.0, 1e-3) << alpha;
            for (const int degrees : {0, 40, 75}) {
                const Vec3f v = test::direction_of_degrees(degrees);
                const auto visible = [&](const Vec3f& m) {
                    return microfacet_g1(mf, v, m) * max(dot(v, m), 0.0f) *
                           microfacet_d(mf, m);
                };
                const auto seen = test::integrate_over_bins(visible, 6);
                const double area = std::accumulate(seen.begin(), seen.end(), 0.0);
                // Walter's rational fit of Beckmann's shadowing is good to 0.35 %.
                EXPECT_NEAR(area / v.z, 1.0, is_beckmann ? 3.5e-3 : 1e-3)
                    << alpha << " at " << degrees;
            }
        }
    }
}

}  // namespace
}  // namespace raykiln
