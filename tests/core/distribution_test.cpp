#include "sampling/distribution.h"

#include <gtest/gtest.h>

#include "statistics.h"

namespace raykiln {
namespace {

using test::ChiSquared;
using test::Rng;

constexpr int samples = 1000000;

std::vector<float> spread_weights(std::size_t n, std::uint64_t seed) {
    Rng rng(seed);
    std::vector<float> weights(n);
    for (float& w : weights) {
        w = rng.below(4) == 0 ? 0.0f : std::exp2(rng.between(-8.0f, 8.0f));
    }
    return weights;
}

std::vector<double> scaled_to(const std::vector<float>& weights, double total) {
    const double sum = std::accumulate(weights.begin(), weights.end(), 0.0);
    std::vector<double> expected;
    for (const float w : weights) {
        expected.push_back(total * w / sum);
    }
    return expected;
}

const std::vector<std::vector<float>>& tables() {
    static const std::vector<std::vector<float>> all{
        {1.0f},
        {1.0f, 3.0f},
        {0.0f, 0.0f, 5.0f},
        {1e-6f, 1.0f, 1e6f},
        spread_weights(7, 31),
        spread_weights(100, 32),
        spread_weights(1000, 33),
        std::vector<float>(64, 2.5f),
    };
    return all;
}

TEST(AliasTable, ProbabilitiesAreTheWeights) {
    for (const auto& weights : tables()) {
        const AliasTable table(weights);
        const auto expected = scaled_to(weights, 1.0);
        double sum = 0;
        for (std::uint32_t i = 0; i < table.size(); ++i) {
            EXPECT_NEAR(table.pmf(i), expected[i], 1e-7 * expected[i]);
            sum += table.pmf(i);
        }
        EXPECT_NEAR(sum, 1.0, 1e-6);
    }
}

TEST(AliasTable, DrawsWithItsProbabilities) {
    for (const auto& weights : tables()) {
        const AliasTable table(weights);
        std::vector<double> counts(weights.size());
        Rng rng(34);
        for (int i = 0; i < samples; ++i) {
            float remapped;
            counts[table.sample(rng.unit(), remapped)] += 1;
        }
        for (std::size_t i = 0; i < weights.size(); ++i) {
            if (weights[i] == 0.0f) {
                EXPECT_EQ(counts[i], 0) << "drew an index of weight 0";
            }
        }
        const ChiSquared result =
            test::chi_squared_test(counts, scaled_to(weights, samples));
        EXPECT_GT(result.p_value, test::sidak(tables().size())) << result;
    }
}

TEST(AliasTable, RestOfTheNumberIsUniform) {
    // For every index drawn; few enough of them that 24 bits leave a fine rest.
    const AliasTable table({0.5f, 4.0f, 1.0f, 2.0f});
    std::vector<test::UniformTally> rests(4, test::UniformTally(32));
    Rng rng(35);
    for (int i = 0; i < samples; ++i) {
        float remapped;
        const auto index = table.sample(rng.unit(), remapped);
        ASSERT_GE(remapped, 0.0f);
        ASSERT_LT(remapped, 1.0f);
        rests[index].add(remapped);
    }
    for (const auto& rest : rests) {
        EXPECT_GT(rest.test().p_value, test::sidak(4)) << rest.test();
    }
}

TEST(AliasTable, AllZeroWeightsAreUniform) {
    const AliasTable table(std::vector<float>(8, 0.0f));
    std::vector<double> counts(8);
    Rng rng(36);
    for (int i = 0; i < samples; ++i) {
        float remapped;
        counts[table.sample(rng.unit(), remapped)] += 1;
    }
    const auto result =
        test::chi_squared_test(counts, std::vector<double>(8, samples / 8.0));
    EXPECT_GT(result.p_value, 0.01) << result;
    EXPECT_FLOAT_EQ(table.pmf(5), 0.125f);
}

TEST(AliasTable, EndsOfTheUnitInterval) {
    const AliasTable table({1.0f, 0.0f, 2.0f, 0.0f});
    for (const float u : {0.0f, 0.25f, 0.5f, 0.75f, one_minus_epsilon}) {
        float remapped;
        const auto index = table.sample(u, remapped);
        EXPECT_TRUE(index == 0 || index == 2) << u;
        EXPECT_GE(remapped, 0.0f);
        EXPECT_LT(remapped, 1.0f);
    }
}

struct Grid {
    int width, height;
    std::vector<float> weights;
};

const std::vector<Grid>& grids() {
    static const std::vector<Grid> all = [] {
        std::vector<Grid> g{{1, 1, {3.0f}},
                            {16, 8, spread_weights(128, 37)},
                            {5, 7, spread_weights(35, 38)},
                            {64, 32, spread_weights(2048, 39)}};
        for (int x = 0; x < 16; ++x) {
            g[1].weights[3 * 16 + static_cast<std::size_t>(x)] = 0.0f;  // a whole row
        }
        return g;
    }();
    return all;
}

TEST(Distribution2D, DensityIntegratesToOne) {
    for (const Grid& g : grids()) {
        const Distribution2D d(g.weights, g.width, g.height);
        const auto expected = scaled_to(g.weights, 1.0);
        double sum = 0;
        for (int y = 0; y < g.height; ++y) {
            for (int x = 0; x < g.width; ++x) {
                const Vec2f at{
                    (static_cast<float>(x) + 0.5f) / static_cast<float>(g.width),
                    (static_cast<float>(y) + 0.5f) / static_cast<float>(g.height)};
                const double mass = d.pdf(at) / (double(g.width) * g.height);
                // The tables hold sums up to 1 rounded to 6e-8, and differences of them.
                const auto cell = static_cast<std::size_t>(y * g.width + x);
                EXPECT_NEAR(mass, expected[cell], 2.4e-7);
                sum += mass;
            }
        }
        EXPECT_NEAR(sum, 1.0, 1e-6);
    }
}

TEST(Distribution2D, DrawsWithItsDensity) {
    for (const Grid& g : grids()) {
        const Distribution2D d(g.weights, g.width, g.height);
        std::vector<double> counts(g.weights.size());
        test::UniformTally within(16 * 16);
        Rng rng(40);
        for (int i = 0; i < samples; ++i) {
            float pdf;
            const Vec2f at = d.sample(rng.unit(), rng.unit(), pdf);
            ASSERT_GT(pdf, 0.0f);
            const float x = at.x * static_cast<float>(g.width);
            const float y = at.y * static_cast<float>(g.height);
            const int ix = std::min(static_cast<int>(x), g.width - 1);
            const int iy = std::min(static_cast<int>(y), g.height - 1);
            const auto cell = static_cast<std::size_t>(iy * g.width + ix);
            if (g.weights[cell] == 0.0f) {
                // Only by rounding at the upper edge of the cell before: a half ulp each
                // in the sum and the quotient of `sample` and in the product here.
                const float ulps = 1.5f * 0x1p-23f;
                ASSERT_TRUE(x - static_cast<float>(ix) <= x * ulps ||
                            y - static_cast<float>(iy) <= y * ulps)
                    << "drew a cell of weight 0";
                continue;
            }
            counts[cell] += 1;
            if (g.width == 1) {
                within.add_bin(static_cast<std::size_t>(y * 16) * 16 +
                               static_cast<std::size_t>(x * 16));
            }
        }
        const auto result = test::chi_squared_test(counts, scaled_to(g.weights, samples));
        EXPECT_GT(result.p_value, test::sidak(grids().size())) << result;
        if (g.width == 1) {
            EXPECT_GT(within.test().p_value, 0.01) << within.test();
        }
    }
}

TEST(Distribution2D, SampledDensityIsTheDensityThere) {
    // A grid of powers of two, where cells are told apart exactly.
    const Grid& g = grids()[1];
    const Distribution2D d(g.weights, g.width, g.height);
    Rng rng(41);
    for (int i = 0; i < 100000; ++i) {
        float pdf;
        const Vec2f at = d.sample(rng.unit(), rng.unit(), pdf);
        ASSERT_EQ(pdf, d.pdf(at));
    }
}

TEST(Distribution2D, EndsOfTheUnitSquareDrawNoEmptyCell) {
    // The first and last column, and the first and last row, are empty.
    std::vector<float> weights(25, 1.0f);
    for (std::size_t i = 0; i < 5; ++i) {
        weights[i] = weights[20 + i] = weights[5 * i] = weights[5 * i + 4] = 0.0f;
    }
    const Distribution2D d(weights, 5, 5);
    for (const float u : {0.0f, 0x1p-24f, 0.5f, one_minus_epsilon}) {
        for (const float v : {0.0f, 0x1p-24f, 0.5f, one_minus_epsilon}) {
            float pdf;
            const Vec2f at = d.sample(u, v, pdf);
            EXPECT_GT(pdf, 0.0f) << u << ", " << v;
            EXPECT_TRUE(at.x >= 0.2f && at.x <= 0.8f && at.y >= 0.2f && at.y <= 0.8f);
        }
    }
}

}  // namespace
}  // namespace raykiln
