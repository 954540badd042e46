#include "bsdf/make_bsdf.h"

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

/// By midpoint quadrature over the sampled normals.
InterfaceShares interface_shares(float cosine, float eta,
                                 const Microfacet<float>& facet) {
    constexpr int n = 64;
    const Vec3f dir_out{safe_sqrt(1.0f - cosine * cosine), 0.0f, cosine};
    double reflected = 0, transmitted = 0;
    for (int i = 0; i < n * n; ++i) {
        const float u = (static_cast<float>(i / n) + 0.5f) / n;
        const float v = (static_cast<float>(i % n) + 0.5f) / n;
        const Vec3f m = sample_microfacet(facet, dir_out, u, v);
        const float c = dot(dir_out, m);
        const float pdf = pdf_microfacet(facet, dir_out, m);
        if (c <= 0.0f || pdf <= 0.0f) {
            continue;
        }
        const DielectricFresnel<float> f = fresnel_dielectric(c, eta);
        const float weight = microfacet_d(facet, m) * c / (dir_out.z * pdf) / (n * n);
        const Vec3f up = reflect(dir_out, m);
        const Vec3f down = refract(dir_out, m, f.cos_transmitted, f.eta_ti);
        if (up.z > 0.0f) {
            reflected += weight * f.reflectance * microfacet_g(facet, dir_out, up, m);
        }
        if (down.z < 0.0f) {
            transmitted +=
                weight * (1.0f - f.reflectance) * microfacet_g(facet, dir_out, down, m);
        }
    }
    return {static_cast<float>(reflected), static_cast<float>(transmitted)};
}

}  // namespace

InterfaceTable make_interface_table(float eta, float alpha, bool beckmann) {
    InterfaceTable table;
    if (alpha == 0.0f) {
        table.internal_reflectance = fresnel_diffuse_reflectance(1.0f / eta);
        return table;  // the smooth coat's transmittance is evaluated directly
    }
    const float a = max(alpha, min_alpha);
    const Microfacet<float> facet{a, a, beckmann};
    double internal = 0;
    for (int i = 0; i < InterfaceTable::size; ++i) {
        const float cosine =
            max(static_cast<float>(i) / (InterfaceTable::size - 1), 1e-4f);
        table.transmittance[i] =
            clamp(interface_shares(cosine, eta, facet).transmitted, 0.0f, 1.0f);
        // A plain mean over the nodes, ends and all: about 0.01 below the integral, and
        // what Mitsuba 3 computes, whose rough plastics look the same for it.
        internal += 2.0 * cosine * interface_shares(cosine, 1.0f / eta, facet).reflected /
                    InterfaceTable::size;
    }
    table.internal_reflectance = static_cast<float>(internal);
    return table;
}

}  // namespace raykiln
