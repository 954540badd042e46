#include "bsdf/bsdf.h"

#include "texture/texture.h"

namespace raykiln {

namespace {

using Textures = std::vector<Texture>;

Microfacet<float> evaluate_surface(const MicrofacetSlots& s, const Textures& textures,
                                   Vec2f uv) {
    return {max(evaluate(s.alpha_u, textures, uv), min_alpha),
            max(evaluate(s.alpha_v, textures, uv), min_alpha), s.beckmann};
}

/// Colours that a texture pushes over 1 would make energy.
Vec3f bounded(const Vec3f& c) {
    return {clamp(c.x, 0.0f, 1.0f), clamp(c.y, 0.0f, 1.0f), clamp(c.z, 0.0f, 1.0f)};
}

struct Evaluate {
    const Textures& textures;
    Vec2f uv;

    Vec3f color(const ColorSlot& slot) const {
        return bounded(evaluate(slot, textures, uv));
    }
    float number(const FloatSlot& slot) const {
        return clamp(evaluate(slot, textures, uv), 0.0f, 1.0f);
    }

    Bsdf operator()(const DiffuseMaterial& m) const {
        return Diffuse<float>{color(m.reflectance)};
    }
    Bsdf operator()(const ConductorMaterial& m) const {
        return Conductor<float>{m.eta, m.k, color(m.reflectance),
                                evaluate_surface(m.surface, textures, uv),
                                m.surface.smooth()};
    }
    Bsdf operator()(const DielectricMaterial& m) const {
        // Refraction without a change of index has no half vector.
        const bool smooth = m.surface.smooth() || std::fabs(m.eta - 1.0f) < 1e-3f;
        return Dielectric<float>{m.eta,
                                 color(m.reflectance),
                                 color(m.transmittance),
                                 evaluate_surface(m.surface, textures, uv),
                                 smooth,
                                 m.thin};
    }
    Bsdf operator()(const PlasticMaterial& m) const {
        return Plastic<float>{m.eta,
                              color(m.diffuse),
                              color(m.specular),
                              evaluate_surface(m.surface, textures, uv),
                              &m.table,
                              m.surface.smooth(),
                              m.nonlinear};
    }
    Bsdf operator()(const PrincipledMaterial& m) const {
        const float f0 = sqr((m.ior - 1.0f) / (m.ior + 1.0f));
        const float specular = number(m.specular);
        // The tint may exceed 1; only the product is bounded (KHR_materials_specular).
        const Vec3f tint = evaluate(m.specular_color, textures, uv);
        const float alpha = max(sqr(number(m.roughness)), min_alpha);
        return Principled<float>{
            color(m.base_color), bounded(tint * f0) * specular, specular,
            number(m.metallic),  number(m.transmission),        {alpha, alpha, false}};
    }
};

}  // namespace

Bsdf make_bsdf(const Material& material, const Textures& textures, Vec2f uv) {
    return std::visit(Evaluate{textures, uv}, material.kind);
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
    if (const auto* p = std::get_if<Principled<float>>(&bsdf)) {
        return p->transmission > 0.0f;
    }
    return std::holds_alternative<Dielectric<float>>(bsdf);
}

Vec3f albedo(const Bsdf& bsdf) {
    struct Albedo {
        Vec3f operator()(const Diffuse<float>& b) const { return b.reflectance; }
        Vec3f operator()(const Conductor<float>& b) const {
            return fresnel_conductor(1.0f, b.eta, b.k) * b.reflectance;
        }
        Vec3f operator()(const Dielectric<float>& b) const {
            const float r = fresnel_dielectric(1.0f, b.eta).reflectance;
            return b.reflectance * r + b.transmittance * (1.0f - r);
        }
        Vec3f operator()(const Plastic<float>& b) const { return b.diffuse; }
        Vec3f operator()(const Principled<float>& b) const { return b.base_color; }
    };
    return std::visit(Albedo{}, bsdf);
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
