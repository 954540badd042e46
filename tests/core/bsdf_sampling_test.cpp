#include <gtest/gtest.h>

#include "bsdf_cases.h"

// Every BSDF's sampling against its density: chi-squared of 10^6 directions, for many
// angles.

namespace raykiln {
namespace {

using test::BsdfCase;
using test::Rng;

constexpr int samples = 1000000;

struct Setting {
    const BsdfCase* bsdf_case;
    int degrees;
};

std::vector<Setting> settings() {
    std::vector<Setting> all;
    for (const BsdfCase& c : test::bsdf_cases()) {
        for (const int degrees : test::angles_of(c)) {
            all.push_back({&c, degrees});
        }
    }
    return all;
}

class BsdfSampling : public testing::TestWithParam<Setting> {
  protected:
    const Bsdf& bsdf() const { return GetParam().bsdf_case->bsdf; }
    Vec3f dir_out() const { return test::direction_of_degrees(GetParam().degrees); }

    /// Probability of the mirror direction, where there is one beside a density.
    double mirror_probability() const {
        const auto* p = std::get_if<Plastic<float>>(&bsdf());
        if (p == nullptr || !p->smooth) {
            return 0.0;
        }
        const double r = fresnel_dielectric(dir_out().z, p->eta).reflectance;
        const double coat = r * mean(p->specular);
        return coat / (coat + (1 - r) * mean(p->diffuse));
    }
};

TEST_P(BsdfSampling, DirectionsFollowTheDensity) {
    const Vec3f out = dir_out();
    const auto pdf = [&](const Vec3f& in) {
        return evaluate(bsdf(), out, in).pdf_solid_angle;
    };
    std::vector<double> expected = test::integrate_over_bins(pdf, 8);
    std::vector<double> observed(expected.size());
    // Two more bins: the mirror direction, and samples that failed, which the density
    // leaves out.
    double mirrors = 0, failures = 0;
    Rng rng(61);
    for (int i = 0; i < samples; ++i) {
        const BsdfRandom<float> u{rng.unit(), rng.unit(), rng.unit()};
        const BsdfSample<float> s = sample(bsdf(), out, u);
        if (s.specular) {
            ++mirrors;
        } else if (max_component(s.weight) <= 0.0f) {
            ++failures;
        } else {
            ++observed[test::bin_of(s.dir_in)];
        }
    }
    const double density_mass = std::accumulate(expected.begin(), expected.end(), 0.0);
    // Integrated to 3e-4; at most all.
    EXPECT_LE(density_mass + mirror_probability(), 1 + 5e-4);
    const double failed_mass = std::max(0.0, 1 - density_mass - mirror_probability());
    expected.push_back(mirror_probability());
    expected.push_back(failed_mass < 1e-5 ? 0.0 : failed_mass);
    observed.push_back(mirrors);
    observed.push_back(failures);
    const double sum = std::accumulate(expected.begin(), expected.end(), 0.0);
    for (double& e : expected) {
        e *= samples / sum;
    }
    const auto result = test::chi_squared_test(observed, expected);
    EXPECT_GT(result.p_value, test::sidak(settings().size())) << result;
    EXPECT_EQ(result.impossible, 0) << result;
}

TEST_P(BsdfSampling, SampleTellsWhatEvaluateTells) {
    const Vec3f out = dir_out();
    Rng rng(62);
    for (int i = 0; i < 20000; ++i) {
        const BsdfRandom<float> u{rng.unit(), rng.unit(), rng.unit()};
        const BsdfSample<float> s = sample(bsdf(), out, u);
        ASSERT_TRUE(is_finite(s.weight) && is_finite(s.dir_in));
        ASSERT_GE(min(s.weight.x, min(s.weight.y, s.weight.z)), 0.0f);
        // Two reflections or refractions of unit vectors rounded to 6e-8 a component.
        ASSERT_NEAR(length(s.dir_in), 1.0f, 4e-6f);
        if (s.specular || max_component(s.weight) <= 0.0f) {
            continue;
        }
        const BsdfValue<float> v = evaluate(bsdf(), out, s.dir_in);
        ASSERT_EQ(v.pdf_solid_angle, s.pdf_solid_angle);
        ASSERT_GT(s.pdf_solid_angle, 0.0f);
        const Vec3f back = s.weight * s.pdf_solid_angle;
        // One division and one product: an ulp each.
        const float tolerance = 4 * 0x1p-23f;
        ASSERT_NEAR(back.x, v.value.x, tolerance * v.value.x);
        ASSERT_NEAR(back.y, v.value.y, tolerance * v.value.y);
        ASSERT_NEAR(back.z, v.value.z, tolerance * v.value.z);
    }
}

TEST_P(BsdfSampling, EveryLitDirectionCanBeDrawn) {
    const Vec3f out = dir_out();
    Rng rng(63);
    for (int i = 0; i < 20000; ++i) {
        const Vec3f in = test::random_direction(rng);
        const BsdfValue<float> v = evaluate(bsdf(), out, in);
        ASSERT_TRUE(is_finite(v.value) && std::isfinite(v.pdf_solid_angle));
        ASSERT_GE(v.pdf_solid_angle, 0.0f);
        if (max_component(v.value) > 0.0f) {
            ASSERT_GT(v.pdf_solid_angle, 0.0f);
        }
    }
}

INSTANTIATE_TEST_SUITE_P(Bsdf, BsdfSampling, testing::ValuesIn(settings()),
                         [](const testing::TestParamInfo<Setting>& s) {
                             return s.param.bsdf_case->name + "_at_" +
                                    std::to_string(s.param.degrees);
                         });

// Mirror directions: how often each is taken, and where it lies.

double z_of_share(double count, double p) {
    return (count - samples * p) / std::sqrt(samples * p * (1 - p));
}

TEST(SpecularSampling, SmoothDielectricChoosesByFresnel) {
    const Dielectric<float> b{1.5f, Vec3f(1.0f), Vec3f(1.0f), {}, true, false};
    const std::vector<int> angles{0, 30, 60, 85, 95, 150, 180};
    for (const int degrees : angles) {
        const Vec3f out = test::direction_of_degrees(degrees);
        const double r = fresnel_dielectric(out.z, b.eta).reflectance;
        double reflected = 0;
        Rng rng(64);
        for (int i = 0; i < samples; ++i) {
            const auto s = sample(b, out, {rng.unit(), rng.unit(), rng.unit()});
            ASSERT_TRUE(s.specular);
            const bool back = s.dir_in.z * out.z > 0.0f;
            reflected += back;
            if (back) {
                ASSERT_EQ(s.dir_in.x, -out.x);
                ASSERT_EQ(s.dir_in.z, out.z);
                continue;
            }
            const float ratio = out.z > 0.0f ? 1.5f : 1 / 1.5f;
            ASSERT_NEAR(s.dir_in.x * ratio, -out.x, 1e-6f);
            ASSERT_NEAR(s.dir_in.y * ratio, -out.y, 1e-6f);
            ASSERT_NEAR(s.eta, ratio, 1e-6f);
            ASSERT_NEAR(s.weight.x * ratio * ratio, 1.0f, 1e-6f);
        }
        if (r >= 1.0) {
            EXPECT_EQ(reflected, samples);
        } else {
            const double p = test::normal_two_sided(z_of_share(reflected, r));
            EXPECT_GT(p, test::sidak(angles.size())) << degrees;
        }
    }
}

TEST(SpecularSampling, ThinPaneGoesStraightOn) {
    const Dielectric<float> b{1.5f, Vec3f(1.0f), Vec3f(1.0f), {}, false, true};
    const std::vector<int> angles{0, 45, 80, 135};
    for (const int degrees : angles) {
        const Vec3f out = test::direction_of_degrees(degrees);
        const double r = fresnel_dielectric(std::fabs(out.z), b.eta).reflectance;
        double reflected = 0;
        Rng rng(65);
        for (int i = 0; i < samples; ++i) {
            const auto s = sample(b, out, {rng.unit(), rng.unit(), rng.unit()});
            ASSERT_TRUE(s.specular);
            ASSERT_EQ(s.weight.x, 1.0f);
            ASSERT_EQ(s.eta, 1.0f);
            const bool back = s.dir_in.z * out.z > 0.0f;
            reflected += back;
            ASSERT_EQ(s.dir_in.x, -out.x);
            ASSERT_EQ(s.dir_in.z, back ? out.z : -out.z);
        }
        const double p = test::normal_two_sided(z_of_share(reflected, 2 * r / (1 + r)));
        EXPECT_GT(p, test::sidak(angles.size())) << degrees;
    }
}

TEST(SpecularSampling, MirrorsHaveNoDensity) {
    const Conductor<float> smooth{Vec3f(0.2f), Vec3f(3.0f), Vec3f(1.0f), {}, true};
    const Vec3f out = test::direction_of_degrees(40);
    const auto s = sample(smooth, out, {0.3f, 0.4f, 0.5f});
    EXPECT_TRUE(s.specular);
    EXPECT_EQ(s.dir_in.x, -out.x);
    EXPECT_EQ(s.dir_in.y, -out.y);
    EXPECT_EQ(s.dir_in.z, out.z);
    EXPECT_FLOAT_EQ(s.weight.x, fresnel_conductor(out.z, 0.2f, 3.0f));
    EXPECT_EQ(evaluate(smooth, out, s.dir_in).pdf_solid_angle, 0.0f);
    EXPECT_EQ(evaluate(smooth, out, s.dir_in).value.x, 0.0f);
    const Dielectric<float> glass{1.5f, Vec3f(1.0f), Vec3f(1.0f), {}, true, false};
    EXPECT_EQ(evaluate(glass, out, s.dir_in).pdf_solid_angle, 0.0f);
}

TEST(OneSidedBsdf, IsBlackFromBelow) {
    for (const BsdfCase& c : test::bsdf_cases()) {
        if (c.transmissive) {
            continue;
        }
        Rng rng(66);
        for (int i = 0; i < 1000; ++i) {
            const Vec3f out = test::direction_of_degrees(120);
            const auto s = sample(c.bsdf, out, {rng.unit(), rng.unit(), rng.unit()});
            ASSERT_EQ(max_component(s.weight), 0.0f) << c.name;
            const auto v = evaluate(c.bsdf, out, test::random_direction(rng));
            ASSERT_EQ(max_component(v.value), 0.0f) << c.name;
        }
    }
}

}  // namespace
}  // namespace raykiln
