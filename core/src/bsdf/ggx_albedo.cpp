#include "bsdf/ggx_albedo.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "bsdf/microfacet.h"
#include "bsdf/sample.h"

namespace raykiln {

namespace {

constexpr int cosines = 48;
constexpr int roughnesses = 24;

GgxAlbedo integrate(float alpha, float cosine) {
    constexpr int n = 32;
    const Microfacet<float> facet{alpha, alpha, false};
    const Vec3f dir_out{safe_sqrt(1.0f - cosine * cosine), 0.0f, cosine};
    double at_f0 = 0, at_f90 = 0;
    for (int i = 0; i < n * n; ++i) {
        const float u = (static_cast<float>(i / n) + 0.5f) / n;
        const float v = (static_cast<float>(i % n) + 0.5f) / n;
        const Vec3f m = sample_microfacet(facet, dir_out, u, v);
        const Vec3f dir_in = reflect(dir_out, m);
        const float c = dot(dir_out, m);
        if (dir_in.z <= 0.0f || c <= 0.0f) {
            continue;
        }
        // Value over density: the distribution of the normals cancels.
        const float g1 = microfacet_g1(facet, dir_out, m);
        const float weight = ggx_visibility_correlated(facet, dir_out, dir_in) * 4.0f *
                             dir_out.z * dir_in.z / g1;
        const float m2 = sqr(1.0f - c);
        const float grazing = m2 * m2 * (1.0f - c);
        at_f0 += weight * (1.0f - grazing) / (n * n);
        at_f90 += weight * grazing / (n * n);
    }
    return {static_cast<float>(at_f0), static_cast<float>(at_f90)};
}

/// Nodes are even in the root of the cosine: towards grazing angles Fresnel's reflectance
/// rises too steeply for even cosines.
struct Table {
    std::array<std::array<GgxAlbedo, cosines>, roughnesses> towards;
    std::array<GgxAlbedo, roughnesses> mean;

    Table() {
        for (int r = 0; r < roughnesses; ++r) {
            const float roughness = static_cast<float>(r) / (roughnesses - 1);
            const float alpha = std::max(roughness * roughness, min_alpha);
            double at_f0 = 0, at_f90 = 0, weights = 0;
            for (int c = 0; c < cosines; ++c) {
                const float root = static_cast<float>(c) / (cosines - 1);
                const float cosine = std::max(sqr(root), 1e-3f);
                const GgxAlbedo a = integrate(alpha, cosine);
                towards[static_cast<std::size_t>(r)][static_cast<std::size_t>(c)] = a;
                // Trapezium rule over the root; the weight of the first node is 0 by it.
                const double weight = cosine * root * (c == cosines - 1 ? 0.5 : 1.0);
                at_f0 += a.at_f0 * weight;
                at_f90 += a.at_f90 * weight;
                weights += weight;
            }
            mean[static_cast<std::size_t>(r)] = {static_cast<float>(at_f0 / weights),
                                                 static_cast<float>(at_f90 / weights)};
        }
    }
};

const Table& table() {
    static const Table t;
    return t;
}

/// A place between two of n nodes over [0, 1].
struct Place {
    std::size_t node;
    float rest;
};

Place place_of(float x, int n) {
    const float scaled = std::clamp(x, 0.0f, 1.0f) * static_cast<float>(n - 1);
    const int node = std::min(static_cast<int>(scaled), n - 2);
    return {static_cast<std::size_t>(node), scaled - static_cast<float>(node)};
}

GgxAlbedo mix(const GgxAlbedo& a, const GgxAlbedo& b, float t) {
    return {lerp(a.at_f0, b.at_f0, t), lerp(a.at_f90, b.at_f90, t)};
}

}  // namespace

GgxAlbedo ggx_albedo(float alpha, float cosine) {
    const Place r = place_of(std::sqrt(alpha), roughnesses);
    const Place c = place_of(safe_sqrt(cosine), cosines);
    const auto& low = table().towards[r.node];
    const auto& high = table().towards[r.node + 1];
    return mix(mix(low[c.node], low[c.node + 1], c.rest),
               mix(high[c.node], high[c.node + 1], c.rest), r.rest);
}

GgxAlbedo ggx_mean_albedo(float alpha) {
    const Place r = place_of(std::sqrt(alpha), roughnesses);
    return mix(table().mean[r.node], table().mean[r.node + 1], r.rest);
}

}  // namespace raykiln
