#include "bsdf/ggx_albedo.h"

#include <algorithm>
#include <cmath>

#include "bsdf/microfacet.h"
#include "bsdf/sample.h"

namespace raykiln::detail {

namespace {

GgxAlbedo<float> integrate(float alpha, float cosine) {
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

GgxTable make_table() {
    GgxTable table;
    for (std::uint32_t r = 0; r < ggx_roughnesses; ++r) {
        const float roughness = static_cast<float>(r) / (ggx_roughnesses - 1);
        const float alpha = std::max(roughness * roughness, min_alpha);
        double at_f0 = 0, at_f90 = 0, weights = 0;
        for (std::uint32_t c = 0; c < ggx_cosines; ++c) {
            const float root = static_cast<float>(c) / (ggx_cosines - 1);
            const float cosine = std::max(sqr(root), 1e-3f);
            const GgxAlbedo<float> a = integrate(alpha, cosine);
            table.towards[r * ggx_cosines + c] = a;
            // Trapezium rule over the root; the weight of the first node is 0 by it.
            const double weight = cosine * root * (c == ggx_cosines - 1 ? 0.5 : 1.0);
            at_f0 += a.at_f0 * weight;
            at_f90 += a.at_f90 * weight;
            weights += weight;
        }
        table.mean[r] = {static_cast<float>(at_f0 / weights),
                         static_cast<float>(at_f90 / weights)};
    }
    return table;
}

}  // namespace

const GgxTable& ggx_table() {
    static const GgxTable table = make_table();
    return table;
}

}  // namespace raykiln::detail
