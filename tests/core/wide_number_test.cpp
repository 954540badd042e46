#include <gtest/gtest.h>

#include <algorithm>
#include <bit>
#include <cmath>

#include "bsdf/conductor.h"
#include "bsdf/dielectric.h"
#include "bsdf/diffuse.h"
#include "math/elementary.h"
#include "math/wide.h"
#include "sampling/sampler.h"
#include "statistics.h"

// The SIMD number of this translation unit's instruction set, lane by lane against float.
// Built once for each instruction set.

namespace raykiln {
namespace {

using test::Rng;

constexpr int width = NumberTraits<Wide>::width;
constexpr int rounds = 20000;

std::uint32_t random_bits(Rng& rng) {
    return static_cast<std::uint32_t>(rng.bits());
}

/// Any bits at all, special values every other time.
float any_float(Rng& rng) {
    const float inf = infinity;
    const float special[] = {0.0f,      -0.0f, 1.0f,          -1.0f,     inf,     -inf,
                             0x1p-149f, 0.5f,  -2.5f,         0x1p-126f, 0x1p31f, 3.0f,
                             1e38f,     -0.5f, std::nanf(""), -0x1p-140f};
    const std::uint32_t choice = random_bits(rng);
    return choice % 2 == 0 ? special[(choice >> 8) % std::size(special)]
                           : std::bit_cast<float>(random_bits(rng));
}

struct Lanes {
    float f[width];
    std::uint32_t u[width];
    bool m[width];

    explicit Lanes(Rng& rng) {
        for (int i = 0; i < width; ++i) {
            f[i] = any_float(rng);
            u[i] = random_bits(rng) >> (random_bits(rng) % 32);
            m[i] = random_bits(rng) % 2 != 0;
        }
    }
    Wide wide() const { return load<Wide>(f); }
    WideUint uint() const { return load<WideUint>(u); }
    WideMask mask() const {
        std::uint32_t set = 0;
        for (int i = 0; i < width; ++i) {
            set |= static_cast<std::uint32_t>(m[i]) << i;
        }
        return WideMask::of_bits(set);
    }
};

/// The same bits; all that are not numbers count as one, as their payload means nothing.
bool same(float a, float b) {
    return (std::isnan(a) && std::isnan(b)) ||
           std::bit_cast<std::uint32_t>(a) == std::bit_cast<std::uint32_t>(b);
}
bool same(std::uint32_t a, std::uint32_t b) {
    return a == b;
}
bool same(bool a, bool b) {
    return a == b;
}

/// Compares f at SIMD width with f lane by lane, over random operands.
template <class F>
void expect_same_lanes(const char* name, F&& f) {
    Rng rng(1);
    for (int round = 0; round < rounds; ++round) {
        const Lanes a(rng), b(rng);
        const auto wide = f(a.wide(), b.wide(), a.uint(), b.uint(), a.mask(), b.mask());
        for (int i = 0; i < width; ++i) {
            const auto scalar = f(a.f[i], b.f[i], a.u[i], b.u[i], a.m[i], b.m[i]);
            ASSERT_TRUE(same(wide.lane(i), scalar))
                << name << " lane " << i << ": " << wide.lane(i) << " instead of "
                << scalar << " for " << a.f[i] << ", " << b.f[i] << "; " << a.u[i] << ", "
                << b.u[i] << "; " << a.m[i] << ", " << b.m[i];
        }
    }
}

#define EXPECT_SAME_LANES(expression)                                                   \
    expect_same_lanes(                                                                  \
        #expression,                                                                    \
        []([[maybe_unused]] auto x, [[maybe_unused]] auto y, [[maybe_unused]] auto i,   \
           [[maybe_unused]] auto j, [[maybe_unused]] auto m, [[maybe_unused]] auto n) { \
            [[maybe_unused]] typedef decltype(x) F;                                     \
            [[maybe_unused]] typedef decltype(i) U;                                     \
            [[maybe_unused]] typedef decltype(m) M;                                     \
            return expression;                                                          \
        })

TEST(WideNumber, ArithmeticOfFloats) {
    EXPECT_SAME_LANES(x + y);
    EXPECT_SAME_LANES(x - y);
    EXPECT_SAME_LANES(x * y);
    EXPECT_SAME_LANES(x / y);
    EXPECT_SAME_LANES(-x);
    EXPECT_SAME_LANES((x += y, x));
    EXPECT_SAME_LANES((x -= y, x));
    EXPECT_SAME_LANES((x *= y, x));
    EXPECT_SAME_LANES((x /= y, x));
    EXPECT_SAME_LANES(F(-0.0f));
    EXPECT_SAME_LANES(F(0x1p-149f));
    EXPECT_SAME_LANES(abs(x));
    EXPECT_SAME_LANES(sqrt(x));
    EXPECT_SAME_LANES(floor(x));
    EXPECT_SAME_LANES(min(x, y));
    EXPECT_SAME_LANES(max(x, y));
    EXPECT_SAME_LANES(min(x, x));
    EXPECT_SAME_LANES(copysign(x, y));
}

TEST(WideNumber, Comparisons) {
    EXPECT_SAME_LANES(x == y);
    EXPECT_SAME_LANES(x != y);
    EXPECT_SAME_LANES(x < y);
    EXPECT_SAME_LANES(x <= y);
    EXPECT_SAME_LANES(x > y);
    EXPECT_SAME_LANES(x >= y);
    EXPECT_SAME_LANES(x == F(3.0f));
    EXPECT_SAME_LANES(i == j);
    EXPECT_SAME_LANES(i != j);
    EXPECT_SAME_LANES(i < j);
    EXPECT_SAME_LANES(i <= j);
    EXPECT_SAME_LANES(i > j);
    EXPECT_SAME_LANES(i >= j);
    EXPECT_SAME_LANES(i >= i);
    EXPECT_SAME_LANES(is_finite(x));
}

TEST(WideNumber, Masks) {
    EXPECT_SAME_LANES(M(m & n));
    EXPECT_SAME_LANES(M(m | n));
    EXPECT_SAME_LANES(M(m ^ n));
    EXPECT_SAME_LANES(!m);
    EXPECT_SAME_LANES(m == n);
    EXPECT_SAME_LANES(m != n);
    EXPECT_SAME_LANES((m &= n, m));
    EXPECT_SAME_LANES((m |= n, m));
    EXPECT_SAME_LANES(M(true));
    EXPECT_SAME_LANES(M(false));
    EXPECT_SAME_LANES(select(m, x, y));
    EXPECT_SAME_LANES(select(m, i, j));
    EXPECT_SAME_LANES(select(m, n, !n));
    EXPECT_SAME_LANES(select(x < y, x, y));
}

TEST(WideNumber, UnsignedArithmetic) {
    EXPECT_SAME_LANES(i + j);
    EXPECT_SAME_LANES(i - j);
    EXPECT_SAME_LANES(i * j);
    EXPECT_SAME_LANES(i & j);
    EXPECT_SAME_LANES(i | j);
    EXPECT_SAME_LANES(i ^ j);
    EXPECT_SAME_LANES(~i);
    EXPECT_SAME_LANES(i << 5);
    EXPECT_SAME_LANES(i >> 5);
    EXPECT_SAME_LANES(i >> 31);
    EXPECT_SAME_LANES((i += j, i));
    EXPECT_SAME_LANES((i -= j, i));
    EXPECT_SAME_LANES((i *= j, i));
    EXPECT_SAME_LANES((i &= j, i));
    EXPECT_SAME_LANES((i |= j, i));
    EXPECT_SAME_LANES((i ^= j, i));
    EXPECT_SAME_LANES(min(i, j));
    EXPECT_SAME_LANES(max(i, j));
    EXPECT_SAME_LANES(U(0xdeadbeefu));
    EXPECT_SAME_LANES(reverse_bits(i));
    EXPECT_SAME_LANES(hash_combine(i, j));
    EXPECT_SAME_LANES(owen_hash_reversed(i, j));
}

TEST(WideNumber, ConversionsOfBitsAndValues) {
    EXPECT_SAME_LANES(as_uint(as_float(i)));
    EXPECT_SAME_LANES(as_float(i));
    EXPECT_SAME_LANES(to_float(i >> 1));
    EXPECT_SAME_LANES(to_uint(to_float(i >> 1) * F(0.25f)));
    EXPECT_SAME_LANES(to_uint(select(abs(x) < F(0x1p31f), abs(x), F(7.75f))));
    EXPECT_SAME_LANES(unit_from_bits(i));
    EXPECT_SAME_LANES(exp2_integral(to_float(i & U(0xffu)) - F(128.0f)));
    // Of positive normal numbers, as it is meant for.
    EXPECT_SAME_LANES([&] {
        const F positive = as_float((i & U(0x3fffffffu)) + U(0x00800000u));
        F exponent;
        const F mantissa = split_exponent(positive, exponent);
        return select(m, mantissa, exponent);
    }());
}

TEST(WideNumber, Gathers) {
    [[maybe_unused]] static float floats[1024];
    [[maybe_unused]] static std::uint32_t uints[1024];
    Rng rng(2);
    for (int k = 0; k < 1024; ++k) {
        floats[k] = any_float(rng);
        uints[k] = random_bits(rng);
    }
    EXPECT_SAME_LANES(gather(floats, i & U(1023u)));
    EXPECT_SAME_LANES(gather(uints, i & U(1023u)));
    EXPECT_SAME_LANES(gather(m, floats, i & U(1023u), y));
    EXPECT_SAME_LANES(gather(m, uints, i & U(1023u), j));
    EXPECT_SAME_LANES(gather4(floats, i & U(1020u))[0]);
    EXPECT_SAME_LANES(gather4(floats, i & U(1020u))[1]);
    EXPECT_SAME_LANES(gather4(floats, i & U(1020u))[2]);
    EXPECT_SAME_LANES(gather4(floats, (i & U(1023u)) - min(i & U(1023u), U(3u)))[3]);
    EXPECT_SAME_LANES(
        count_not_above(floats, (i & U(1023u)) - min(i & U(1023u), U(15u)), y));
    // Where the mask is not set, the index may be anything.
    EXPECT_SAME_LANES(gather(i < U(1024u), floats, i, y));
    EXPECT_SAME_LANES(gather(i < U(1024u), uints, i, j));
    [[maybe_unused]] static const std::array<std::uint32_t, 16> table = [] {
        std::array<std::uint32_t, 16> t{};
        Rng of_table(3);
        for (auto& entry : t) {
            entry = random_bits(of_table);
        }
        return t;
    }();
    EXPECT_SAME_LANES(lookup16(table, i & U(15u)));
}

TEST(WideNumber, ScattersInTheOrderOfLanes) {
    Rng rng(4);
    for (int round = 0; round < rounds; ++round) {
        const Lanes a(rng);
        // Few places, so that lanes meet.
        float floats[8] = {}, expected_floats[8] = {};
        std::uint32_t uints[8] = {}, expected_uints[8] = {};
        const WideUint place = a.uint() & WideUint(7u);
        scatter(a.mask(), floats, place, a.wide());
        scatter(a.mask(), uints, place, a.uint());
        for (int i = 0; i < width; ++i) {
            scatter(a.m[i], expected_floats, place.lane(i), a.f[i]);
            scatter(a.m[i], expected_uints, place.lane(i), a.u[i]);
        }
        for (int k = 0; k < 8; ++k) {
            ASSERT_TRUE(same(floats[k], expected_floats[k]));
            ASSERT_EQ(uints[k], expected_uints[k]);
        }
    }
}

TEST(WideNumber, CountsMasks) {
    Rng rng(5);
    for (int round = 0; round < rounds; ++round) {
        const Lanes a(rng);
        std::uint32_t expected_bits = 0;
        int expected_count = 0;
        for (int i = 0; i < width; ++i) {
            expected_bits |= static_cast<std::uint32_t>(a.m[i]) << i;
            expected_count += count(a.m[i]);
        }
        const WideMask from_comparison =
            select(a.mask(), WideUint(1u), WideUint(0u)) > WideUint(0u);
        ASSERT_EQ(bits(from_comparison), expected_bits);
        ASSERT_EQ(bits(!a.mask()), (1u << width) - 1u - expected_bits);
        ASSERT_EQ(count(from_comparison), expected_count);
        ASSERT_EQ(any(from_comparison), expected_count != 0);
        ASSERT_EQ(none(from_comparison), expected_count == 0);
        ASSERT_EQ(all(from_comparison), expected_count == width);
    }
    EXPECT_TRUE(all(WideMask(true)) && all(!WideMask(false)) && !any(!WideMask(true)));
    for (int n = 0; n <= width; ++n) {
        EXPECT_EQ(bits(WideMask::first(n)), (1u << n) - 1u);
    }
}

TEST(WideNumber, CompressedStoresKeepTheOrder) {
    Rng rng(6);
    for (int round = 0; round < rounds; ++round) {
        const Lanes a(rng);
        std::uint32_t uints[width + 1];
        float floats[width + 1];
        uints[width] = 77u;
        floats[width] = 77.0f;
        const int n = compress_store(a.mask(), a.uint(), uints);
        ASSERT_EQ(compress_store(a.mask(), a.wide(), floats), n);
        int next = 0;
        for (int i = 0; i < width; ++i) {
            if (a.m[i]) {
                ASSERT_EQ(uints[next], a.u[i]);
                ASSERT_TRUE(same(floats[next], a.f[i]));
                ++next;
            }
        }
        ASSERT_EQ(n, next);
        ASSERT_EQ(uints[width], 77u);
        ASSERT_EQ(floats[width], 77.0f);
    }
}

TEST(WideNumber, MaskedStoresLeaveTheOtherLanes) {
    Rng rng(7);
    for (int round = 0; round < rounds; ++round) {
        const Lanes a(rng);
        std::uint32_t uints[width], packed[width];
        float floats[width];
        std::fill_n(uints, width, 77u);
        std::fill_n(floats, width, 77.0f);
        store(a.mask(), uints, a.uint());
        store(a.mask(), floats, a.wide());
        store(packed, compress(a.mask(), a.uint()));
        int next = 0;
        for (int i = 0; i < width; ++i) {
            ASSERT_EQ(uints[i], a.m[i] ? a.u[i] : 77u);
            ASSERT_TRUE(same(floats[i], a.m[i] ? a.f[i] : 77.0f));
            if (a.m[i]) {
                ASSERT_EQ(packed[next++], a.u[i]);
            }
        }
    }
}

TEST(WideNumber, LoadsAndStoresWithoutAlignment) {
    float floats[width + 1], copied_floats[width + 1];
    std::uint32_t uints[width + 1], copied_uints[width + 1];
    for (int i = 0; i <= width; ++i) {
        floats[i] = static_cast<float>(i);
        uints[i] = static_cast<std::uint32_t>(i);
    }
    store(copied_floats + 1, load<Wide>(floats + 1));
    store(copied_uints + 1, load<WideUint>(uints + 1));
    Wide set = Wide(0.0f);
    for (int i = 0; i < width; ++i) {
        EXPECT_EQ(copied_floats[i + 1], floats[i + 1]);
        EXPECT_EQ(copied_uints[i + 1], uints[i + 1]);
        EXPECT_EQ(iota<WideUint>().lane(i), uints[i]);
        set.set_lane(i, floats[i]);
    }
    EXPECT_TRUE(all(set == to_float(iota<WideUint>())));
}

TEST(WideNumber, SamplesAreThoseOfTheScalarSampler) {
    Rng rng(7);
    for (int round = 0; round < rounds; ++round) {
        Lanes a(rng), b(rng);
        const SampleKey<Wide> key{a.uint(), b.uint()};
        const auto group = random_bits(rng) % 40u;
        const auto point = sobol_point_reversed(b.uint());
        for (const SamplerKind kind : {SamplerKind::sobol, SamplerKind::independent}) {
            const Sample4<Wide> wide = sample_4d(kind, key, group);
            for (int i = 0; i < width; ++i) {
                const SampleKey<float> lane{a.u[i], b.u[i]};
                const Sample4<float> scalar = sample_4d(kind, lane, group);
                for (std::size_t d = 0; d < 4; ++d) {
                    ASSERT_EQ(wide[d].lane(i), scalar[d]);
                    ASSERT_EQ(point[d].lane(i), sobol_point_reversed(b.u[i])[d]);
                }
            }
        }
    }
}

/// Equal up to the rounding that fused multiplication and addition saves.
void expect_near(const Wide& wide, int lane, float scalar, float scale = 1.0f) {
    const float tolerance = 2e-5f * std::max(scale, std::fabs(scalar));
    EXPECT_NEAR(wide.lane(lane), scalar, tolerance) << "lane " << lane;
}

TEST(WideNumber, ElementaryFunctions) {
    Rng rng(8);
    for (int round = 0; round < rounds / 4; ++round) {
        Wide x, y;
        for (int i = 0; i < width; ++i) {
            x.set_lane(i, rng.between(-20.0f, 20.0f));
            y.set_lane(i, rng.between(-20.0f, 20.0f));
        }
        Wide sine, cosine;
        sin_cos_turns(x, sine, cosine);
        const Wide angle = atan2(y, x), logarithm = log(abs(x)), power = exp(y);
        for (int i = 0; i < width; ++i) {
            float s, c;
            sin_cos_turns(x.lane(i), s, c);
            expect_near(sine, i, s);
            expect_near(cosine, i, c);
            expect_near(angle, i, atan2(y.lane(i), x.lane(i)));
            expect_near(logarithm, i, log(std::fabs(x.lane(i))));
            expect_near(power, i, exp(y.lane(i)));
        }
    }
}

template <class F>
Vec3<F> broadcast(const Vec3f& v) {
    return {F(v.x), F(v.y), F(v.z)};
}

template <class F>
Diffuse<F> diffuse() {
    return {broadcast<F>({0.8f, 0.5f, 0.2f})};
}
template <class F>
Conductor<F> conductor() {
    return {broadcast<F>({0.2f, 0.9f, 1.1f}), broadcast<F>({3.9f, 2.4f, 2.2f}),
            broadcast<F>({1.0f, 0.9f, 0.8f}), Microfacet<F>{F(0.3f), F(0.2f), false},
            false};
}
template <class F>
Dielectric<F> dielectric() {
    return {F(1.5f),
            broadcast<F>({1.0f, 0.9f, 0.8f}),
            broadcast<F>({0.9f, 1.0f, 0.8f}),
            Microfacet<F>{F(0.4f), F(0.4f), false},
            false,
            false};
}

/// The values and samples of a BSDF at SIMD width are those of its scalar form.
template <class WideBsdf, class ScalarBsdf>
void expect_same_bsdf(const WideBsdf& wide, const ScalarBsdf& scalar, bool below) {
    Rng rng(9);
    int valid = 0, flipped = 0;
    for (int round = 0; round < rounds / 4; ++round) {
        Vec3<Wide> dir_out;
        BsdfRandom<Wide> u;
        for (int i = 0; i < width; ++i) {
            Vec3f v = sample_sphere(rng.unit(), rng.unit());
            v.z = below ? v.z : std::fabs(v.z);
            set_lane(dir_out, i, v);
            u.lobe.set_lane(i, rng.unit());
            u.x.set_lane(i, rng.unit());
            u.y.set_lane(i, rng.unit());
        }
        const BsdfSample<Wide> s = sample(wide, dir_out, u);
        const BsdfValue<Wide> value = evaluate(wide, dir_out, s.dir_in);
        for (int i = 0; i < width; ++i) {
            const BsdfRandom<float> u_lane{u.lobe.lane(i), u.x.lane(i), u.y.lane(i)};
            const Vec3f out = lane_of(dir_out, i), in = lane_of(s.dir_in, i);
            const BsdfSample<float> expected = sample(scalar, out, u_lane);
            // At grazing angles and at the edge between two lobes rounding decides.
            if (std::min(std::fabs(out.z), std::fabs(in.z)) < 0.05f) {
                continue;
            }
            if (dot(in, expected.dir_in) < 0.99f) {
                ++flipped;
                continue;
            }
            ++valid;
            ASSERT_EQ(s.specular.lane(i), expected.specular);
            EXPECT_NEAR(in.x, expected.dir_in.x, 1e-4f);
            EXPECT_NEAR(in.y, expected.dir_in.y, 1e-4f);
            EXPECT_NEAR(in.z, expected.dir_in.z, 1e-4f);
            EXPECT_NEAR(s.weight.x.lane(i), expected.weight.x, 1e-3f);
            EXPECT_NEAR(s.eta.lane(i), expected.eta, 1e-5f);
            const BsdfValue<float> at = evaluate(scalar, out, in);
            EXPECT_NEAR(value.pdf_solid_angle.lane(i), at.pdf_solid_angle,
                        1e-6f + 1e-3f * at.pdf_solid_angle);
            EXPECT_NEAR(value.value.y.lane(i), at.value.y, 1e-6f + 1e-3f * at.value.y);
        }
    }
    EXPECT_GT(valid, rounds / 4 * width * 2 / 3);
    EXPECT_LT(flipped, 3 + valid / 10000);
}

TEST(WideNumber, Bsdfs) {
    expect_same_bsdf(diffuse<Wide>(), diffuse<float>(), false);
    expect_same_bsdf(conductor<Wide>(), conductor<float>(), false);
    expect_same_bsdf(dielectric<Wide>(), dielectric<float>(), true);
}

TEST(WideNumber, LanesDoNotKnowOfEachOther) {
    Rng rng(10);
    const auto b = dielectric<Wide>();
    for (int round = 0; round < 1000; ++round) {
        const auto direction = [&] { return sample_sphere(rng.unit(), rng.unit()); };
        const Vec3f out = direction();
        const float lobe = rng.unit(), x = rng.unit(), y = rng.unit();
        const auto alone =
            sample(b, broadcast<Wide>(out), {Wide(lobe), Wide(x), Wide(y)});
        Vec3<Wide> mixed_out = broadcast<Wide>(direction());
        BsdfRandom<Wide> u{Wide(rng.unit()), Wide(rng.unit()), Wide(rng.unit())};
        const int place = static_cast<int>(random_bits(rng) % width);
        set_lane(mixed_out, place, out);
        u.lobe.set_lane(place, lobe);
        u.x.set_lane(place, x);
        u.y.set_lane(place, y);
        const auto mixed = sample(b, mixed_out, u);
        ASSERT_TRUE(same(mixed.dir_in.x.lane(place), alone.dir_in.x.lane(0)));
        ASSERT_TRUE(same(mixed.weight.z.lane(place), alone.weight.z.lane(0)));
        ASSERT_TRUE(
            same(mixed.pdf_solid_angle.lane(place), alone.pdf_solid_angle.lane(0)));
    }
}

}  // namespace
}  // namespace raykiln
