#include "bsdf/ggx_albedo.h"

#include <algorithm>
#include <cmath>

#include "bsdf/microfacet.h"
#include "bsdf/sample.h"
#include "sampling/midpoint_means.h"

namespace raykiln::detail {

namespace {

GgxAlbedo<float> integrate(float alpha, float cosine) {
    const Microfacet<Wide> facet{Wide(alpha), Wide(alpha), false};
    const Vec3<Wide> dir_out{Wide(safe_sqrt(1.0f - cosine * cosine)), Wide(0.0f),
                             Wide(cosine)};
    const auto shares = [&](Wide u, Wide v) -> std::array<Wide, 2> {
        const Vec3<Wide> m = sample_microfacet(facet, dir_out, u, v);
        const Vec3<Wide> dir_in = reflect(dir_out, m);
        const Wide c = dot(dir_out, m);
        // Value over density: the distribution of the normals cancels.
        const Wide g1 = microfacet_g1(facet, dir_out, m);
        const Wide value = ggx_visibility_correlated(facet, dir_out, dir_in) *
                           Wide(4.0f) * dir_out.z * dir_in.z / g1;
        const WideMask counts = (dir_in.z > Wide(0.0f)) & (c > Wide(0.0f));
        const Wide weight = select(counts, value, Wide(0.0f));
        const Wide m2 = sqr(Wide(1.0f) - c);
        const Wide grazing = m2 * m2 * (Wide(1.0f) - c);
        return {weight * (Wide(1.0f) - grazing), weight * grazing};
    };
    const auto means = midpoint_means<32>(shares);
    return {static_cast<float>(means[0]), static_cast<float>(means[1])};
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
