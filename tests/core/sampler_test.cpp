#include "sampling/sampler.h"

#include <gtest/gtest.h>

#include <algorithm>

#include "statistics.h"

// The Sobol' sampler: what its theory promises, before and after scrambling; the
// independent sampler: nothing but uniformity.

namespace raykiln {
namespace {

using test::Rng;
using test::UniformTally;

using Point = std::array<std::uint32_t, 4>;  // fractions of 2^32

std::vector<Point> plain_points(std::uint32_t n) {
    std::vector<Point> points(n);
    for (std::uint32_t i = 0; i < n; ++i) {
        for (int d = 0; d < 4; ++d) {
            points[i][static_cast<std::size_t>(d)] = reverse_bits(sobol_reversed(i, d));
        }
    }
    return points;
}

std::vector<Point> scrambled_points(std::uint32_t n, std::uint32_t first,
                                    std::uint32_t pixel, std::uint32_t group) {
    std::vector<Point> points(n);
    for (std::uint32_t i = 0; i < n; ++i) {
        const auto u = sobol_sample<float>({pixel, first + i}, group);
        for (std::size_t d = 0; d < 4; ++d) {
            points[i][d] = static_cast<std::uint32_t>(u[d] * 0x1p32f);
        }
    }
    return points;
}

/// Whether 2^m points put 2^t into every elementary interval of volume 2^(t - m) over the
/// given dimensions: a (t, m, s)-net in base 2 (Niederreiter 1987).
bool is_net(const std::vector<Point>& points, const std::vector<std::size_t>& dimensions,
            int m, int t) {
    const int bits = m - t;
    std::vector<int> split(dimensions.size(), 0);
    const auto check = [&] {
        std::vector<std::uint32_t> counts(std::size_t{1} << bits);
        for (const Point& p : points) {
            std::uint32_t cell = 0;
            for (std::size_t k = 0; k < split.size(); ++k) {
                if (split[k] > 0) {
                    cell = (cell << split[k]) | (p[dimensions[k]] >> (32 - split[k]));
                }
            }
            ++counts[cell];
        }
        return std::all_of(counts.begin(), counts.end(),
                           [&](std::uint32_t c) { return c == (1u << t); });
    };
    // All ways of dealing the bits out to the dimensions.
    const auto deal = [&](auto&& self, std::size_t k, int left) -> bool {
        if (k + 1 == split.size()) {
            split[k] = left;
            return check();
        }
        for (split[k] = 0; split[k] <= left; ++split[k]) {
            if (!self(self, k + 1, left - split[k])) {
                return false;
            }
        }
        return true;
    };
    return deal(deal, 0, bits);
}

// The quality parameter of a Sobol' sequence over some of its dimensions is at most the
// sum of (degree - 1) of their primitive polynomials (Sobol' 1967), which are of degree
// 1, 1 (the radical inverse and x + 1), 2 and 3 here.
constexpr std::array<int, 4> quality{0, 0, 1, 2};

void expect_nets(const std::vector<Point>& points, int m, const char* what) {
    for (std::size_t a = 0; a < 4; ++a) {
        EXPECT_TRUE(is_net(points, {a}, m, 0))
            << what << ": dimension " << a << ", m " << m;
        for (std::size_t b = a + 1; b < 4; ++b) {
            const int t = std::min(quality[a] + quality[b], m);
            EXPECT_TRUE(is_net(points, {a, b}, m, t))
                << what << ": dimensions " << a << ", " << b << ", m " << m;
        }
    }
    EXPECT_TRUE(is_net(points, {0, 1, 2}, m, std::min(1, m))) << what << ", m " << m;
    EXPECT_TRUE(is_net(points, {0, 1, 2, 3}, m, std::min(3, m))) << what << ", m " << m;
}

TEST(Sobol, PowersOfTwoAreNets) {
    for (int m = 0; m <= 10; ++m) {
        expect_nets(plain_points(1u << m), m, "plain");
    }
}

TEST(Sobol, ScramblingKeepsTheNets) {
    for (std::uint32_t pixel = 1; pixel <= 5; ++pixel) {
        for (int m = 0; m <= 10; ++m) {
            const auto key = sample_key(7, pixel, 3, 0).pixel;
            expect_nets(scrambled_points(1u << m, 0, key, pixel), m, "scrambled");
        }
        // Later blocks of a power of two are nets, too.
        expect_nets(scrambled_points(64, 64 * pixel, pixel * 977, 2), 6, "later block");
    }
}

TEST(Sobol, NetTestSeesWhatIsNotANet) {
    auto points = plain_points(256);
    points[17][0] ^= 0x80000000u;
    EXPECT_FALSE(is_net(points, {0}, 8, 0));
    EXPECT_FALSE(is_net(points, {0, 1}, 8, 0));
    Rng rng(21);
    for (Point& p : points) {
        p = {static_cast<std::uint32_t>(rng.bits()),
             static_cast<std::uint32_t>(rng.bits()), 0, 0};
    }
    EXPECT_FALSE(is_net(points, {0, 1}, 8, 3));
}

TEST(Sobol, DimensionsAsPublished) {
    // Points 2^i of dimensions 1 to 4 of the sequence of Joe and Kuo (2008), in 1/256:
    // all others are their sums without carry.
    const std::array<std::array<std::uint32_t, 4>, 8> published{{{128, 128, 128, 128},
                                                                 {64, 192, 192, 192},
                                                                 {32, 160, 96, 32},
                                                                 {16, 240, 144, 80},
                                                                 {8, 136, 232, 248},
                                                                 {4, 204, 92, 116},
                                                                 {2, 170, 142, 162},
                                                                 {1, 255, 197, 147}}};
    const auto points = plain_points(256);
    for (std::uint32_t i = 0; i < 256; ++i) {
        for (std::size_t d = 0; d < 4; ++d) {
            std::uint32_t sum = 0;
            for (std::size_t bit = 0; bit < 8; ++bit) {
                sum ^= (i >> bit) & 1u ? published[bit][d] : 0u;
            }
            EXPECT_EQ(points[i][d] >> 24, sum) << "point " << i << ", dimension " << d;
        }
    }
}

TEST(Sobol, TablesOfBytesGiveTheSamePoints) {
    Rng rng(25);
    for (int i = 0; i < 20000; ++i) {
        // All bits of the index, not only the low ones.
        const auto index = static_cast<std::uint32_t>(rng.bits() >> (32 + rng.below(32)));
        const auto point = sobol_point_reversed(index);
        for (int d = 0; d < 4; ++d) {
            ASSERT_EQ(point[static_cast<std::size_t>(d)], sobol_reversed(index, d))
                << index;
        }
    }
}

TEST(OwenScrambling, EachBitDependsOnHigherBitsAlone) {
    // With reversed bits: output bit k is input bit k, flipped by a function of the seed
    // and the bits below. Then the map is a bijection and moves intervals onto intervals.
    Rng rng(22);
    for (int i = 0; i < 20000; ++i) {
        const auto seed = static_cast<std::uint32_t>(rng.bits());
        const auto x = static_cast<std::uint32_t>(rng.bits());
        for (int k = 0; k < 32; ++k) {
            const std::uint32_t above = k == 31 ? 0u : ~0u << (k + 1);
            const auto noise = static_cast<std::uint32_t>(rng.bits());
            const std::uint32_t y = (x ^ (1u << k)) ^ (noise & above);
            const std::uint32_t change =
                owen_hash_reversed(x, seed) ^ owen_hash_reversed(y, seed);
            const std::uint32_t below = (1u << k) - 1u;
            ASSERT_EQ(change & below, 0u);
            ASSERT_NE(change & (1u << k), 0u);
        }
    }
}

TEST(OwenScrambling, FlipsOfABitAreEven) {
    // Over seeds, each of the first 12 bits flips for half of them, whatever lies above.
    constexpr int bits = 12, seeds = 4000;
    Rng rng(23);
    const double level = test::sidak(bits);
    for (int k = 0; k < bits; ++k) {
        double flips = 0;
        for (int i = 0; i < seeds; ++i) {
            const auto seed = hash_bits(static_cast<std::uint32_t>(rng.bits()));
            const auto x = static_cast<std::uint32_t>(rng.bits());
            flips += ((owen_hash_reversed(x, seed) ^ x) >> k) & 1u;
        }
        const double z = (flips - 0.5 * seeds) / std::sqrt(0.25 * seeds);
        EXPECT_GT(test::normal_two_sided(z), level) << "bit " << k;
    }
}

constexpr std::uint32_t grid = 16;
std::size_t pair_cell(float a, float b) {
    return static_cast<std::size_t>(a * grid) * grid + static_cast<std::size_t>(b * grid);
}

class EachSampler : public testing::TestWithParam<SamplerKind> {};

std::string name_of(const testing::TestParamInfo<SamplerKind>& kind) {
    return kind.param == SamplerKind::sobol ? "sobol" : "independent";
}

INSTANTIATE_TEST_SUITE_P(Sampler, EachSampler,
                         testing::Values(SamplerKind::sobol, SamplerKind::independent),
                         name_of);

TEST_P(EachSampler, IsAFunctionOfItsKey) {
    const auto key = sample_key(5, 10, 20, 30);
    EXPECT_EQ(sample_4d(GetParam(), key, 4), sample_4d(GetParam(), key, 4));
    const auto base = sample_4d(GetParam(), key, 4);
    EXPECT_NE(base, sample_4d(GetParam(), key, 5));
    EXPECT_NE(base, sample_4d(GetParam(), sample_key(6, 10, 20, 30), 4));
    EXPECT_NE(base, sample_4d(GetParam(), sample_key(5, 11, 20, 30), 4));
    EXPECT_NE(base, sample_4d(GetParam(), sample_key(5, 10, 21, 30), 4));
    EXPECT_NE(base, sample_4d(GetParam(), sample_key(5, 10, 20, 31), 4));
    EXPECT_NE(sample_4d(GetParam(), sample_key(5, 20, 10, 30), 4),
              sample_4d(GetParam(), sample_key(5, 10, 20, 30), 4));
}

TEST_P(EachSampler, UniformOverPixels) {
    // For one sample number and group, over an image: every dimension, and pairs of them.
    constexpr std::uint32_t size = 512;
    std::vector<UniformTally> tallies(10, UniformTally(grid * grid));
    for (std::uint32_t y = 0; y < size; ++y) {
        for (std::uint32_t x = 0; x < size; ++x) {
            const auto u = sample_4d(GetParam(), sample_key(0, x, y, 3), 1);
            std::size_t test = 0;
            for (std::size_t a = 0; a < 4; ++a) {
                ASSERT_GE(u[a], 0.0f);
                ASSERT_LT(u[a], 1.0f);
                tallies[test++].add(u[a]);
                for (std::size_t b = a + 1; b < 4; ++b) {
                    tallies[test++].add_bin(pair_cell(u[a], u[b]));
                }
            }
        }
    }
    for (const auto& tally : tallies) {
        EXPECT_GT(tally.test().p_value, test::sidak(tallies.size())) << tally.test();
    }
}

TEST_P(EachSampler, NeighbouringPixelsShareNothing) {
    constexpr std::uint32_t size = 512;
    std::vector<UniformTally> tallies(3, UniformTally(grid * grid));
    for (std::uint32_t y = 0; y < size; ++y) {
        for (std::uint32_t x = 0; x < size; x += 2) {
            const float here = sample_4d(GetParam(), sample_key(0, x, y, 0), 0)[0];
            const float right = sample_4d(GetParam(), sample_key(0, x + 1, y, 0), 0)[0];
            const float seed = sample_4d(GetParam(), sample_key(1, x, y, 0), 0)[0];
            const float below =
                sample_4d(GetParam(), sample_key(0, x, y + size, 0), 0)[0];
            tallies[0].add_bin(pair_cell(here, right));
            tallies[1].add_bin(pair_cell(here, seed));
            tallies[2].add_bin(pair_cell(here, below));
        }
    }
    for (const auto& tally : tallies) {
        EXPECT_GT(tally.test().p_value, test::sidak(tallies.size())) << tally.test();
    }
}

TEST_P(EachSampler, GroupsAreUncorrelated) {
    // The covariance over the samples of a pixel, averaged over pixels, is 0 between any
    // two of the 16 dimensions of four groups; within a group, too.
    constexpr std::uint32_t pixels = 2000, spp = 32;
    constexpr std::size_t n = 16;
    std::vector<test::Moments> covariance(n * n);
    for (std::uint32_t pixel = 0; pixel < pixels; ++pixel) {
        std::array<double, n * n> sums{};
        for (std::uint32_t i = 0; i < spp; ++i) {
            std::array<double, n> u;
            for (std::uint32_t g = 0; g < n / 4; ++g) {
                const auto four = sample_4d(GetParam(), sample_key(0, pixel, 1, i), g);
                std::copy(four.begin(), four.end(), u.begin() + 4 * g);
            }
            for (std::size_t a = 0; a < n; ++a) {
                for (std::size_t b = 0; b < a; ++b) {
                    sums[a * n + b] += (u[a] - 0.5) * (u[b] - 0.5);
                }
            }
        }
        for (std::size_t k = 0; k < n * n; ++k) {
            covariance[k].add(sums[k] / spp);
        }
    }
    const double level = test::sidak(n * (n - 1) / 2);
    for (std::size_t a = 0; a < n; ++a) {
        for (std::size_t b = 0; b < a; ++b) {
            EXPECT_GT(covariance[a * n + b].p_value_of_mean(0.0), level)
                << a << ", " << b;
        }
    }
}

TEST(IndependentSampler, SamplesOfAPixelAreUniformAndUnrelated) {
    std::vector<UniformTally> tallies(8, UniformTally(grid * grid));
    auto last = independent_sample<float>(sample_key(9, 4, 4, 0), 0);
    for (std::uint32_t i = 1; i < 300000; ++i) {
        const auto u = independent_sample<float>(sample_key(9, 4, 4, i), 0);
        for (std::size_t d = 0; d < 4; ++d) {
            tallies[d].add(u[d]);
            tallies[4 + d].add_bin(pair_cell(last[d], u[(d + 1) % 4]));
        }
        last = u;
    }
    for (const auto& tally : tallies) {
        EXPECT_GT(tally.test().p_value, test::sidak(tallies.size())) << tally.test();
    }
}

template <std::uint32_t wanted>
void expect_part_of_all(SamplerKind kind) {
    const SampleKey<float> key = sample_key(7, 3, 5, 41);
    const Sample4<float> all = sample_4d(kind, key, 6);
    const Sample4<float> part = sample_4d<float, wanted>(kind, key, 6);
    for (std::uint32_t d = 0; d < 4; ++d) {
        EXPECT_EQ(part[d], (wanted >> d & 1u) != 0 ? all[d] : 0.0f) << d;
    }
}

TEST(Sampler, PartOfTheNumbersIsThatOfAll) {
    for (const SamplerKind kind : {SamplerKind::sobol, SamplerKind::independent}) {
        expect_part_of_all<first_two>(kind);
        expect_part_of_all<first_three>(kind);
        expect_part_of_all<the_third>(kind);
        expect_part_of_all<the_fourth>(kind);
    }
}

}  // namespace
}  // namespace raykiln
