#include "bsdf/make_bsdf.h"
#include "sampling/midpoint_means.h"

namespace raykiln {

Bsdf make_bsdf(const Material& material, const std::vector<Texture>& textures, Vec2f uv) {
    const detail::Parameters<float> at{textures, uv};
    return std::visit([&](const auto& kind) -> Bsdf { return make_bsdf(kind, at); },
                      material.kind);
}

bool is_specular(const Bsdf& bsdf) {
    if (const auto* c = std::get_if<Conductor<float>>(&bsdf)) {
        return c->smooth;
    }
    if (const auto* d = std::get_if<Dielectric<float>>(&bsdf)) {
        return d->smooth || d->thin;
    }
    return false;
}

bool is_transmissive(const Bsdf& bsdf) {
    return std::visit([](const auto& b) -> bool { return is_transmissive(b); }, bsdf);
}

Vec3f albedo(const Bsdf& bsdf) {
    return std::visit([](const auto& b) { return albedo(b); }, bsdf);
}

namespace {

/// Shares of the light from one angle that a rough dielectric interface reflects and lets
/// through; what is missing is lost between the facets.
struct InterfaceShares {
    float reflected, transmitted;
};

InterfaceShares interface_shares(float cosine, float eta, float alpha, bool beckmann) {
    const Microfacet<Wide> facet{Wide(alpha), Wide(alpha), beckmann};
    const Vec3<Wide> dir_out{Wide(safe_sqrt(1.0f - cosine * cosine)), Wide(0.0f),
                             Wide(cosine)};
    const auto shares = [&](Wide u, Wide v) -> std::array<Wide, 2> {
        const Vec3<Wide> m = sample_microfacet(facet, dir_out, u, v);
        const Wide c = dot(dir_out, m);
        const Wide pdf = pdf_microfacet(facet, dir_out, m);
        const WideMask counts = (c > Wide(0.0f)) & (pdf > Wide(0.0f));
        const DielectricFresnel<Wide> f = fresnel_dielectric(c, Wide(eta));
        const Wide weight = microfacet_d(facet, m) * c / (dir_out.z * pdf);
        const Vec3<Wide> up = reflect(dir_out, m);
        const Vec3<Wide> down = refract(dir_out, m, f.cos_transmitted, f.eta_ti);
        const Wide reflected =
            weight * f.reflectance * microfacet_g(facet, dir_out, up, m);
        const Wide transmitted =
            weight * (Wide(1.0f) - f.reflectance) * microfacet_g(facet, dir_out, down, m);
        return {select(counts & (up.z > Wide(0.0f)), reflected, Wide(0.0f)),
                select(counts & (down.z < Wide(0.0f)), transmitted, Wide(0.0f))};
    };
    const auto means = midpoint_means<64>(shares);
    return {static_cast<float>(means[0]), static_cast<float>(means[1])};
}

}  // namespace

InterfaceTable make_interface_table(float eta, float alpha, bool beckmann) {
    InterfaceTable table;
    if (alpha == 0.0f) {
        table.internal_reflectance = fresnel_diffuse_reflectance(1.0f / eta);
        return table;  // the smooth coat's transmittance is evaluated directly
    }
    const float a = max(alpha, min_alpha);
    double internal = 0;
    for (int i = 0; i < InterfaceTable::size; ++i) {
        const float cosine =
            max(static_cast<float>(i) / (InterfaceTable::size - 1), 1e-4f);
        table.transmittance[i] =
            clamp(interface_shares(cosine, eta, a, beckmann).transmitted, 0.0f, 1.0f);
        // A plain mean over the nodes, ends and all: about 0.01 below the integral, and
        // what Mitsuba 3 computes, whose rough plastics look the same for it.
        internal += 2.0 * cosine *
                    interface_shares(cosine, 1.0f / eta, a, beckmann).reflected /
                    InterfaceTable::size;
    }
    table.internal_reflectance = static_cast<float>(internal);
    return table;
}

}  // namespace raykiln
