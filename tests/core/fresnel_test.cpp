#include "bsdf/fresnel.h"

#include <gtest/gtest.h>

#include <complex>

#include "bsdf/dielectric.h"
#include "statistics.h"

namespace raykiln {
namespace {

using test::Rng;

/// Fresnel's equations in complex numbers: s and p reflectances from index 1 into n.
double exact_reflectance(double cosine, std::complex<double> n) {
    const std::complex<double> sin2_t = (1 - cosine * cosine) / (n * n);
    const std::complex<double> cos_t = std::sqrt(1.0 - sin2_t);
    const auto s = (cosine - n * cos_t) / (cosine + n * cos_t);
    const auto p = (n * cosine - cos_t) / (n * cosine + cos_t);
    return 0.5 * (std::norm(s) + std::norm(p));
}

TEST(Fresnel, DielectricHeadOn) {
    for (const float eta : {1.1f, 1.33f, 1.5f, 2.42f, 1 / 1.5f}) {
        const double r = std::pow((double(eta) - 1) / (double(eta) + 1), 2);
        EXPECT_NEAR(fresnel_dielectric(1.0f, eta).reflectance, r, 1e-7);
        EXPECT_NEAR(fresnel_dielectric(-1.0f, eta).reflectance, r, 1e-7);
    }
    EXPECT_NEAR(fresnel_dielectric(1.0f, 1.5f).reflectance, 0.04, 1e-7);
}

TEST(Fresnel, DielectricAtBrewstersAngle) {
    // No p light is reflected; r_s^2 = ((1 - eta^2) / (1 + eta^2))^2.
    for (const double eta : {1.33, 1.5, 2.0}) {
        const double cosine = 1 / std::sqrt(1 + eta * eta);
        const double r = 0.5 * std::pow((1 - eta * eta) / (1 + eta * eta), 2);
        const auto f =
            fresnel_dielectric(static_cast<float>(cosine), static_cast<float>(eta));
        EXPECT_NEAR(f.reflectance, r, 1e-6);
    }
}

TEST(Fresnel, DielectricAgainstComplexEquations) {
    Rng rng(51);
    for (int i = 0; i < 100000; ++i) {
        const float eta = rng.between(1.01f, 3.0f);
        const float cosine = rng.between(-1.0f, 1.0f);
        const double n = cosine >= 0 ? double(eta) : 1 / double(eta);
        const double exact = exact_reflectance(std::fabs(double(cosine)), n);
        // Near the critical angle the root of 1 - sin^2 magnifies the rounding of sin^2.
        const double sin2_t = (1 - double(cosine) * cosine) / (n * n);
        const double root = std::sqrt(std::fabs(1 - sin2_t));
        const double tolerance = 2e-6 + 2e-6 / std::max(root, 1e-3);
        const double r = fresnel_dielectric(cosine, eta).reflectance;
        ASSERT_NEAR(r, exact, tolerance) << cosine << ", " << eta;
        ASSERT_LE(r, 1.0 + 2e-7);
    }
}

TEST(Fresnel, TotalReflectionBeginsAtTheCriticalAngle) {
    for (const float eta : {1.33f, 1.5f, 2.42f}) {
        const double critical = std::sqrt(1 - 1 / (double(eta) * eta));
        const auto beyond = static_cast<float>(-0.999 * critical);
        const auto before = static_cast<float>(-1.001 * critical);
        EXPECT_EQ(fresnel_dielectric(beyond, eta).reflectance, 1.0f);
        EXPECT_LT(fresnel_dielectric(before, eta).reflectance, 1.0f);
        EXPECT_EQ(fresnel_dielectric(-1e-4f, eta).reflectance, 1.0f);
        EXPECT_NEAR(fresnel_dielectric(1e-5f, eta).reflectance, 1.0f, 1e-3f);
    }
}

TEST(Fresnel, MatchedIndexReflectsNothing) {
    for (const float cosine : {1.0f, 0.5f, 1e-3f, -0.2f, -1.0f}) {
        const auto f = fresnel_dielectric(cosine, 1.0f);
        EXPECT_EQ(f.reflectance, 0.0f);
        // The root of 1 - sin^2, which is rounded to 6e-8.
        EXPECT_NEAR(f.cos_transmitted, -cosine, 1e-7f / std::fabs(cosine));
    }
}

TEST(Fresnel, BothSidesOfAnInterfaceReflectAlike) {
    // Reflectance is the same along a light path either way.
    Rng rng(52);
    for (int i = 0; i < 100000; ++i) {
        const float eta = rng.between(1.01f, 3.0f);
        const float cosine = rng.between(0.05f, 1.0f);
        const auto there = fresnel_dielectric(cosine, eta);
        const auto back = fresnel_dielectric(there.cos_transmitted, eta);
        // The way back magnifies the rounding of sin^2 by eta^2, and its root by 1 / cos;
        // near grazing the reflectance falls by 4 eta a unit of the cosine.
        const float tolerance = 1.5e-7f * eta * eta / cosine;
        ASSERT_NEAR(back.cos_transmitted, cosine, tolerance) << cosine << ", " << eta;
        ASSERT_NEAR(there.reflectance, back.reflectance, 4 * eta * tolerance);
    }
}

TEST(Fresnel, RefractionFollowsSnell) {
    Rng rng(53);
    int refracted = 0;
    for (int i = 0; i < 100000; ++i) {
        const float eta = rng.between(1.01f, 3.0f);
        const float z = rng.between(-1.0f, 1.0f), phi = rng.unit();
        float sine, cosine;
        sin_cos_turns(phi, sine, cosine);
        const float r = std::sqrt(1 - z * z);
        const Vec3f v{r * cosine, r * sine, z};
        const Vec3f m =
            normalize(Vec3f{rng.between(-0.5f, 0.5f), rng.between(-0.5f, 0.5f), 1.0f});
        const auto f = fresnel_dielectric(dot(v, m), eta);
        if (f.reflectance >= 1.0f) {
            continue;
        }
        ++refracted;
        const Vec3f t = refract(v, m, f.cos_transmitted, f.eta_ti);
        ASSERT_NEAR(length(t), 1.0f, 4e-6f);
        ASSERT_LE(dot(t, m) * dot(v, m), 1e-7f) << "on the other side";
        // n_i v_tangential = -n_t t_tangential, in the same plane.
        const Vec3f v_tangential = v - m * dot(v, m), t_tangential = t - m * dot(t, m);
        ASSERT_LT(length(v_tangential * f.eta_ti + t_tangential), 4e-6f);
    }
    EXPECT_GT(refracted, 50000);
}

TEST(Fresnel, ConductorAgainstComplexEquations) {
    Rng rng(54);
    for (int i = 0; i < 100000; ++i) {
        const float eta = rng.between(0.04f, 5.0f), k = rng.between(0.0f, 9.0f);
        const float cosine = rng.between(0.0f, 1.0f);
        // The time convention of the index does not matter to a reflectance. The form in
        // squares loses digits where t0^2 swamps 4 eta^2 k^2: relative 6e-8 k^4.
        const double exact = exact_reflectance(cosine, {eta, k});
        ASSERT_NEAR(fresnel_conductor(cosine, eta, k), exact, 2e-4)
            << cosine << ", " << eta << " + i " << k;
    }
}

TEST(Fresnel, KnownMetals) {
    // Head-on: ((eta - 1)^2 + k^2) / ((eta + 1)^2 + k^2).
    const auto head_on = [](double eta, double k) {
        return ((eta - 1) * (eta - 1) + k * k) / ((eta + 1) * (eta + 1) + k * k);
    };
    EXPECT_NEAR(fresnel_conductor(1.0f, 0.2f, 3.91f), head_on(0.2, 3.91),
                1e-6);  // copper
    EXPECT_NEAR(fresnel_conductor(1.0f, 1.1f, 6.79f), head_on(1.1, 6.79),
                1e-6);                                                  // aluminium
    EXPECT_NEAR(fresnel_conductor(1.0f, 0.155f, 4.83f), 0.9751, 1e-3);  // silver
    EXPECT_NEAR(fresnel_conductor(0.0f, 0.2f, 3.91f), 1.0, 1e-6);
    // A conductor that does not absorb is a dielectric; no index at all is a mirror.
    Rng rng(55);
    for (int i = 0; i < 1000; ++i) {
        const float cosine = rng.between(0.0f, 1.0f);
        EXPECT_NEAR(fresnel_conductor(cosine, 1.5f, 0.0f),
                    fresnel_dielectric(cosine, 1.5f).reflectance, 2e-6);
        EXPECT_EQ(fresnel_conductor(cosine, 0.0f, 1.0f), 1.0f);
    }
}

TEST(Fresnel, SchlickMeetsItsEnds) {
    const Vec3f f0(0.04f, 0.5f, 0.9f), f90(1.0f);
    EXPECT_EQ(fresnel_schlick(1.0f, f0, f90).x, 0.04f);
    EXPECT_EQ(fresnel_schlick(0.0f, f0, f90).y, 1.0f);
    EXPECT_NEAR(fresnel_schlick(0.5f, f0, f90).x, 0.04 + 0.96 / 32, 1e-6);
}

TEST(Fresnel, DiffuseReflectanceOfAnInterface) {
    // From outside by Walsh's closed form (Duntley 1942), from inside by the identity
    // 1 - R_inside = (1 - R_outside) / eta^2, which holds as the interface loses nothing.
    for (const double n : {1.2, 1.33, 1.5, 2.0}) {
        const double n2 = n * n, n4 = n2 * n2;
        const double walsh =
            0.5 + (n - 1) * (3 * n + 1) / (6 * (n + 1) * (n + 1)) +
            n2 * std::pow(n2 - 1, 2) / std::pow(n2 + 1, 3) * std::log((n - 1) / (n + 1)) -
            2 * n2 * n * (n2 + 2 * n - 1) / ((n2 + 1) * (n4 - 1)) +
            8 * n4 * (n4 + 1) / ((n2 + 1) * std::pow(n4 - 1, 2)) * std::log(n);
        const auto eta = static_cast<float>(n);
        // Midpoint sums of 1024 steps; from inside the integrand has a kink: error 1 / n.
        EXPECT_NEAR(fresnel_diffuse_reflectance(eta), walsh, 1e-5) << n;
        EXPECT_NEAR(fresnel_diffuse_reflectance(1 / eta), 1 - (1 - walsh) / n2, 1e-3)
            << n;
    }
}

TEST(Fresnel, ThinPaneSumsItsReflections) {
    for (const float r : {0.0f, 0.04f, 0.5f, 0.9f}) {
        double sum = r;
        double passing = (1.0 - r) * (1.0 - r) * r;
        for (int bounce = 0; bounce < 2000; ++bounce) {
            sum += passing;
            passing *= double(r) * r;
        }
        EXPECT_NEAR(thin_reflectance(r), sum, 1e-6);
    }
    EXPECT_EQ(thin_reflectance(1.0f), 1.0f);
}

}  // namespace
}  // namespace raykiln
