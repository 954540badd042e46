#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <numeric>
#include <ostream>
#include <vector>

// What the statistical proofs share: a random generator that is not the one under test,
// and hypothesis tests. All proofs use fixed seeds, so that a p-value is the same in
// every run.

namespace raykiln::test {

/// SplitMix64 (Steele et al. 2014), independent of the core's hashes.
class Rng {
  public:
    explicit Rng(std::uint64_t seed) : state_(seed) {}
    std::uint64_t bits() {
        state_ += 0x9e3779b97f4a7c15u;
        std::uint64_t z = state_;
        z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9u;
        z = (z ^ (z >> 27)) * 0x94d049bb133111ebu;
        return z ^ (z >> 31);
    }
    /// In [0, 1), all of its 24 bits random.
    float unit() { return static_cast<float>(bits() >> 40) * 0x1p-24f; }
    float between(float low, float high) { return low + (high - low) * unit(); }
    /// Below n.
    std::uint32_t below(std::uint32_t n) {
        return static_cast<std::uint32_t>(bits() % n);
    }

  private:
    std::uint64_t state_;
};

/// Upper tail of the chi-squared distribution: the regularised incomplete gamma function
/// Q(dof / 2, statistic / 2), by its series or its continued fraction (Lentz).
inline double chi_squared_tail(double statistic, double dof) {
    const double a = 0.5 * dof, x = 0.5 * statistic;
    if (x <= 0) {
        return 1.0;
    }
    const double scale = std::exp(a * std::log(x) - x - std::lgamma(a));
    if (x < a + 1) {
        double term = 1 / a, sum = term;
        for (double k = a + 1; term > sum * 1e-15; ++k) {
            term *= x / k;
            sum += term;
        }
        return 1 - scale * sum;
    }
    double b = x + 1 - a, c = 1e300, d = 1 / b, value = d;
    for (int i = 1; i < 100000; ++i) {
        const double numerator = -i * (i - a);
        b += 2;
        d = 1 / (b + numerator * d);
        c = b + numerator / c;
        value *= c * d;
        if (std::fabs(c * d - 1) < 1e-14) {
            break;
        }
    }
    return scale * value;
}

/// Probability that a standard normal number is further from 0 than z.
inline double normal_two_sided(double z) {
    return std::erfc(std::fabs(z) / std::sqrt(2.0));
}

/// Level of one of n independent tests such that all of them together have level 0.01
/// (Šidák).
inline double sidak(std::size_t n) {
    return -std::expm1(std::log1p(-0.01) / static_cast<double>(n));
}

struct ChiSquared {
    double statistic = 0, p_value = 1;
    int dof = 0;
    double impossible = 0;  ///< observations where none can be
};

inline std::ostream& operator<<(std::ostream& out, const ChiSquared& c) {
    return out << "chi2 " << c.statistic << " with " << c.dof << " degrees of freedom, p "
               << c.p_value << ", " << c.impossible << " impossible";
}

/// Pearson's test of counts against their expectations, which must have the same sum.
/// Bins with an expectation below 5 are pooled, the smallest first.
inline ChiSquared chi_squared_test(const std::vector<double>& observed,
                                   const std::vector<double>& expected) {
    std::vector<std::size_t> order(expected.size());
    std::iota(order.begin(), order.end(), std::size_t{0});
    std::stable_sort(order.begin(), order.end(), [&](std::size_t a, std::size_t b) {
        return expected[a] < expected[b];
    });
    ChiSquared result;
    double pooled_observed = 0, pooled_expected = 0;
    for (const std::size_t i : order) {
        // Less than a thousandth of a sample is nothing, but for rounding.
        if (expected[i] < 1e-3 && observed[i] > 5) {
            result.impossible += observed[i];
        }
        pooled_observed += observed[i];
        pooled_expected += expected[i];
        if (pooled_expected >= 5) {
            const double gap = pooled_observed - pooled_expected;
            result.statistic += gap * gap / pooled_expected;
            ++result.dof;
            pooled_observed = pooled_expected = 0;
        }
    }
    // What is left is part of no bin (under 5 samples); observations there would show up
    // as missing from the others.
    --result.dof;
    result.p_value =
        result.dof > 0 ? chi_squared_tail(result.statistic, result.dof) : 1.0;
    return result;
}

/// Counts over [0, 1) in equal bins against the uniform distribution.
class UniformTally {
  public:
    explicit UniformTally(std::size_t bins) : counts_(bins) {}
    void add(double x) {
        const auto n = static_cast<double>(counts_.size());
        counts_[std::min(static_cast<std::size_t>(x * n), counts_.size() - 1)] += 1;
    }
    void add_bin(std::size_t bin) { counts_[bin] += 1; }
    ChiSquared test() const {
        const double sum = std::accumulate(counts_.begin(), counts_.end(), 0.0);
        const auto n = static_cast<double>(counts_.size());
        return chi_squared_test(counts_, std::vector<double>(counts_.size(), sum / n));
    }

  private:
    std::vector<double> counts_;
};

/// Mean and the variance of it, of numbers given one by one (Welford).
class Moments {
  public:
    void add(double x) {
        ++n_;
        const double gap = x - mean_;
        mean_ += gap / n_;
        sum2_ += gap * (x - mean_);
    }
    double mean() const { return mean_; }
    double standard_error() const { return std::sqrt(sum2_ / (n_ - 1) / n_); }
    /// Two-sided p-value of the mean being `value`.
    double p_value_of_mean(double value) const {
        return normal_two_sided((mean_ - value) / standard_error());
    }

  private:
    double n_ = 0, mean_ = 0, sum2_ = 0;
};

}  // namespace raykiln::test
