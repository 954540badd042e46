#pragma once

#include <cmath>
#include <string>
#include <vector>

#include "math/vec.h"
#include "statistics.h"

// Directions binned over the sphere by equal steps of the polar angle (from +z) and the
// azimuth, and densities integrated over those bins.

namespace raykiln::test {

constexpr double tau = 6.283185307179586;

inline Vec3f direction_at(double theta, double phi) {
    return {static_cast<float>(std::sin(theta) * std::cos(phi)),
            static_cast<float>(std::sin(theta) * std::sin(phi)),
            static_cast<float>(std::cos(theta))};
}

constexpr int theta_bins = 64, phi_bins = 64;

inline std::size_t bin_of(const Vec3f& d) {
    const double theta = std::atan2(std::hypot(d.x, d.y), static_cast<double>(d.z));
    double phi = std::atan2(static_cast<double>(d.y), static_cast<double>(d.x));
    phi = phi < 0 ? phi + tau : phi;
    const int i =
        std::min(static_cast<int>(theta / (tau / 2) * theta_bins), theta_bins - 1);
    const int j = std::min(static_cast<int>(phi / tau * phi_bins), phi_bins - 1);
    return static_cast<std::size_t>(i * phi_bins + j);
}

/// Integrates a density over solid angle, halving cells until they add up.
template <class Pdf>
class SphereIntegrator {
  public:
    /// `max_depth` 8 puts an edge within 1/256 of a bin, for densities that have edges.
    SphereIntegrator(const Pdf& pdf, int max_depth) : pdf_(pdf), max_depth_(max_depth) {}

    std::vector<double> bins() const {
        std::vector<double> masses;
        const double dt = 0.5 * tau / theta_bins, dp = tau / phi_bins;
        for (int i = 0; i < theta_bins; ++i) {
            for (int j = 0; j < phi_bins; ++j) {
                const Cell cell{i * dt, (i + 1) * dt, j * dp, (j + 1) * dp};
                masses.push_back(refine(cell, simpson(cell), 0));
            }
        }
        return masses;
    }

  private:
    struct Cell {
        double t0, t1, p0, p1;
    };

    /// Simpson's rule along each side: its points on the edges see a density that begins
    /// just inside them. They are a little inside, as an edge may be where two pieces
    /// meet.
    double simpson(const Cell& c) const {
        static const double at[3] = {1e-4, 0.5, 1 - 1e-4};
        static const double weight[3] = {1.0 / 6, 4.0 / 6, 1.0 / 6};
        double sum = 0;
        for (int i = 0; i < 3; ++i) {
            const double theta = c.t0 + (c.t1 - c.t0) * at[i];
            for (int j = 0; j < 3; ++j) {
                const double phi = c.p0 + (c.p1 - c.p0) * at[j];
                sum += weight[i] * weight[j] * std::sin(theta) *
                       static_cast<double>(pdf_(direction_at(theta, phi)));
            }
        }
        return sum * (c.t1 - c.t0) * (c.p1 - c.p0);
    }

    /// With 10^6 samples, a systematic relative error of 3e-4 adds 10^6 * 9e-8 = 0.1 to
    /// chi-squared, whose own deviation is sqrt(2 dof), about 30.
    double refine(const Cell& c, double coarse, int depth) const {
        const double t = 0.5 * (c.t0 + c.t1), p = 0.5 * (c.p0 + c.p1);
        const Cell parts[4] = {{c.t0, t, c.p0, p},
                               {c.t0, t, p, c.p1},
                               {t, c.t1, c.p0, p},
                               {t, c.t1, p, c.p1}};
        double mass[4], fine = 0;
        for (int i = 0; i < 4; ++i) {
            fine += mass[i] = simpson(parts[i]);
        }
        if (depth >= max_depth_ || std::fabs(fine - coarse) <= 3e-4 * fine + 1e-10) {
            return fine;
        }
        fine = 0;
        for (int i = 0; i < 4; ++i) {
            fine += refine(parts[i], mass[i], depth + 1);
        }
        return fine;
    }

    const Pdf& pdf_;
    int max_depth_;
};

template <class Pdf>
std::vector<double> integrate_over_bins(const Pdf& pdf, int max_depth) {
    return SphereIntegrator<Pdf>(pdf, max_depth).bins();
}

/// Uniform in the cube from -range to range.
inline Vec3f random_point(Rng& rng, float range) {
    return {rng.between(-range, range), rng.between(-range, range),
            rng.between(-range, range)};
}

/// A direction uniform over the sphere.
inline Vec3f random_direction(Rng& rng) {
    const double z = 1 - 2.0 * rng.unit();
    return direction_at(std::acos(z), tau * rng.unit());
}

}  // namespace raykiln::test
