#include <gtest/gtest.h>

#include "sampling/block_distribution.h"
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

// The textbook's way: the last cell whose sum before it is not above u.
std::size_t cell_by_walking(const std::vector<float>& sums, std::size_t n, float u) {
    std::size_t cell = 0;
    while (cell + 1 < n && sums[cell] <= u) {
        ++cell;
    }
    return cell;
}

TEST(Cdf, FindsWhatWalkingAlongFinds) {
    Rng rng(34);
    for (std::uint32_t n = 1; n < 300; n = n < 70 ? n + 1 : n + 37) {
        // Also where it is told that there is one more.
        for (const std::uint32_t most : {n, n + 1}) {
            std::vector<float> sums(3 + Cdf::floats_for(most));
            const std::uint32_t begin = 3;
            Cdf::fill(spread_weights(n, n).data(), n, &sums[begin]);
            const std::vector<float> line(sums.begin() + begin, sums.end());
            std::vector<float> at{0.0f, one_minus_epsilon};
            for (std::uint32_t i = 0; i < n; ++i) {
                at.push_back(std::min(line[i], one_minus_epsilon));
                at.push_back(rng.between(0.0f, one_minus_epsilon));
            }
            for (const float u : at) {
                float within;
                const std::uint32_t cell = Cdf::find(sums.data(), begin, most, u, within);
                ASSERT_EQ(cell, cell_by_walking(line, n, u)) << n << " at " << u;
                const float p = Cdf::probability(line.data(), cell);
                const float before = cell == 0 ? 0.0f : line[cell - 1];
                ASSERT_NEAR(before + within * p, u, 1e-6);
                ASSERT_GE(within, 0.0f);
                ASSERT_LT(within, 1.0f);
            }
        }
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
                            // Blocks of two and three cells, and of one and two.
                            {77, 19, spread_weights(77 * 19, 39)},
                            {64, 32, spread_weights(2048, 39)}};
        for (int x = 0; x < 16; ++x) {
            g[1].weights[3 * 16 + static_cast<std::size_t>(x)] = 0.0f;  // a whole row
        }
        return g;
    }();
    return all;
}

/// A distribution with three views: the weights themselves, blocks alike, and blocks with
/// weights of their own, some of them 0.
BlockDistribution blocks_of(const Grid& g) {
    BlockDistribution d(g.weights, g.width, g.height);
    const std::size_t n = d.masses().size();
    d.add_view(d.masses());
    d.add_view(std::vector<double>(n, 0.0));
    const auto own = spread_weights(n, 42);
    d.add_view({own.begin(), own.end()});
    return d;
}

constexpr ViewMix<float> as_weighted{{0, 0, 0}, {1.0f, 0.0f, 0.0f}};
constexpr ViewMix<float> mixed{{0, 1, 2}, {0.5f, 0.125f, 0.375f}};

std::size_t cell_of(const Grid& g, Vec2f at) {
    const int x =
        std::min(static_cast<int>(at.x * static_cast<float>(g.width)), g.width - 1);
    const int y =
        std::min(static_cast<int>(at.y * static_cast<float>(g.height)), g.height - 1);
    return static_cast<std::size_t>(y * g.width + x);
}

/// Probabilities of the cells, by the density in their middle.
std::vector<double> masses_of_cells(const BlockDistribution& d, const Grid& g,
                                    const ViewMix<float>& views) {
    std::vector<double> masses;
    for (int y = 0; y < g.height; ++y) {
        for (int x = 0; x < g.width; ++x) {
            const Vec2f at{(static_cast<float>(x) + 0.5f) / static_cast<float>(g.width),
                           (static_cast<float>(y) + 0.5f) / static_cast<float>(g.height)};
            masses.push_back(d.pdf(views, at) / (double(g.width) * g.height));
        }
    }
    return masses;
}

TEST(BlockDistribution, DensityIsThatOfTheWeights) {
    for (const Grid& g : grids()) {
        const auto masses = masses_of_cells(blocks_of(g), g, as_weighted);
        const auto expected = scaled_to(g.weights, 1.0);
        for (std::size_t cell = 0; cell < masses.size(); ++cell) {
            // The tables hold sums up to 1 rounded to 6e-8, and differences of them.
            EXPECT_NEAR(masses[cell], expected[cell], 4.8e-7);
        }
    }
}

TEST(BlockDistribution, DensityIntegratesToOne) {
    for (const Grid& g : grids()) {
        const BlockDistribution d = blocks_of(g);
        for (std::uint32_t view = 0; view < 3; ++view) {
            const ViewMix<float> alone{{view, 0, 0}, {1.0f, 0.0f, 0.0f}};
            const auto masses = masses_of_cells(d, g, alone);
            EXPECT_NEAR(std::accumulate(masses.begin(), masses.end(), 0.0), 1.0, 2e-6);
        }
    }
}

TEST(BlockDistribution, DrawsWithItsDensity) {
    for (const Grid& g : grids()) {
        const BlockDistribution d = blocks_of(g);
        for (const ViewMix<float>& views : {as_weighted, mixed}) {
            auto expected = masses_of_cells(d, g, views);
            std::vector<double> counts(expected.size());
            test::UniformTally within(16 * 16);
            Rng rng(40);
            for (int i = 0; i < samples; ++i) {
                float pdf;
                const Vec2f at = d.sample(views, rng.unit(), rng.unit(), rng.unit(), pdf);
                ASSERT_GT(pdf, 0.0f);
                const std::size_t cell = cell_of(g, at);
                if (expected[cell] == 0.0) {
                    // Only by rounding at the upper edge of the cell before: a half ulp
                    // each in the sum and the quotient of `sample` and in the product
                    // here.
                    const float x = at.x * static_cast<float>(g.width);
                    const float y = at.y * static_cast<float>(g.height);
                    const float ulps = 1.5f * 0x1p-23f;
                    ASSERT_TRUE(x - std::floor(x) <= x * ulps ||
                                y - std::floor(y) <= y * ulps)
                        << "drew a cell of weight 0";
                    continue;
                }
                counts[cell] += 1;
                if (g.width == 1) {
                    within.add_bin(static_cast<std::size_t>(at.y * 16) * 16 +
                                   static_cast<std::size_t>(at.x * 16));
                }
            }
            for (double& e : expected) {
                e *= samples;
            }
            const auto result = test::chi_squared_test(counts, expected);
            EXPECT_GT(result.p_value, test::sidak(2 * grids().size())) << result;
            if (g.width == 1) {
                EXPECT_GT(within.test().p_value, 0.01) << within.test();
            }
        }
    }
}

TEST(BlockDistribution, SampledDensityIsTheDensityThere) {
    // A grid of powers of two, where cells are told apart exactly.
    const Grid& g = grids()[1];
    const BlockDistribution d = blocks_of(g);
    Rng rng(41);
    for (int i = 0; i < 100000; ++i) {
        float pdf;
        const Vec2f at = d.sample(mixed, rng.unit(), rng.unit(), rng.unit(), pdf);
        ASSERT_EQ(pdf, d.pdf(mixed, at));
    }
}

TEST(BlockDistribution, StrataStayTogether) {
    // Where all cells and blocks are alike, points are where (u, v) is.
    const Grid even{64, 32, std::vector<float>(2048, 1.0f)};
    const BlockDistribution d = blocks_of(even);
    for (int i = 0; i < 256; ++i) {
        float pdf;
        const float u = static_cast<float>(i) / 256.0f,
                    v = static_cast<float>(i) / 512.0f;
        const Vec2f at = d.sample(as_weighted, u, v, 0.0f, pdf);
        EXPECT_NEAR(at.x, u, 1e-6f);
        EXPECT_NEAR(at.y, v, 1e-6f);
        EXPECT_NEAR(pdf, 1.0f, 1e-5f);
    }
}

TEST(BlockDistribution, EndsOfTheUnitSquareDrawNoEmptyCell) {
    // The first and last column, and the first and last row, are empty.
    Grid g{5, 5, std::vector<float>(25, 1.0f)};
    for (std::size_t i = 0; i < 5; ++i) {
        g.weights[i] = g.weights[20 + i] = 0.0f;
        g.weights[5 * i] = g.weights[5 * i + 4] = 0.0f;
    }
    const BlockDistribution d = blocks_of(g);
    for (const float u : {0.0f, 0x1p-24f, 0.5f, one_minus_epsilon}) {
        for (const float v : {0.0f, 0x1p-24f, 0.5f, one_minus_epsilon}) {
            float pdf;
            const Vec2f at = d.sample(as_weighted, u, v, u, pdf);
            EXPECT_GT(pdf, 0.0f) << u << ", " << v;
            EXPECT_TRUE(at.x >= 0.2f && at.x <= 0.8f && at.y >= 0.2f && at.y <= 0.8f);
        }
    }
}

}  // namespace
}  // namespace raykiln
