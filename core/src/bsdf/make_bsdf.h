#pragma once

#include "bsdf/bsdf.h"
#include "texture/texture.h"

// Materials evaluated at texture coordinates: one function a kind, over any number type.

namespace raykiln {

namespace detail {

/// Colours that a texture pushes over 1 would make energy.
template <class F>
inline Vec3<F> bounded(const Vec3<F>& c) {
    return {clamp(c.x, F(0.0f), F(1.0f)), clamp(c.y, F(0.0f), F(1.0f)),
            clamp(c.z, F(0.0f), F(1.0f))};
}
template <class F>
inline Vec3<F> in_lanes(const Vec3f& v) {
    return {F(v.x), F(v.y), F(v.z)};
}

/// The parameters of a material at a point.
template <class F>
struct Parameters {
    const std::vector<Texture>& textures;
    Vec2<F> uv;

    Vec3<F> color(const ColorSlot& slot) const {
        return bounded(evaluate(slot, textures, uv));
    }
    F number(const FloatSlot& slot) const {
        return clamp(evaluate(slot, textures, uv), F(0.0f), F(1.0f));
    }
    Microfacet<F> surface(const MicrofacetSlots& s) const {
        return {max(evaluate(s.alpha_u, textures, uv), F(min_alpha)),
                max(evaluate(s.alpha_v, textures, uv), F(min_alpha)), s.beckmann};
    }
};

}  // namespace detail

template <class F>
inline Diffuse<F> make_bsdf(const DiffuseMaterial& m, const detail::Parameters<F>& at) {
    return {at.color(m.reflectance)};
}
template <class F>
inline Conductor<F> make_bsdf(const ConductorMaterial& m,
                              const detail::Parameters<F>& at) {
    return {detail::in_lanes<F>(m.eta), detail::in_lanes<F>(m.k), at.color(m.reflectance),
            at.surface(m.surface), m.surface.smooth()};
}
template <class F>
inline Dielectric<F> make_bsdf(const DielectricMaterial& m,
                               const detail::Parameters<F>& at) {
    return {F(m.eta),
            at.color(m.reflectance),
            at.color(m.transmittance),
            at.surface(m.surface),
            m.is_smooth(),
            m.thin};
}
template <class F>
inline Plastic<F> make_bsdf(const PlasticMaterial& m, const detail::Parameters<F>& at) {
    return {F(m.eta), at.color(m.diffuse), at.color(m.specular), at.surface(m.surface),
            &m.table, m.surface.smooth(),  m.nonlinear};
}
template <class F>
inline Principled<F> make_bsdf(const PrincipledMaterial& m,
                               const detail::Parameters<F>& at) {
    const F f0(sqr((m.ior - 1.0f) / (m.ior + 1.0f)));
    const F specular = at.number(m.specular);
    // The tint may exceed 1; only the product is bounded (KHR_materials_specular).
    const Vec3<F> tint = evaluate(m.specular_color, at.textures, at.uv);
    const F alpha = max(sqr(at.number(m.roughness)), F(min_alpha));
    return {at.color(m.base_color),
            detail::bounded(tint * f0) * specular,
            specular,
            at.number(m.metallic),
            at.number(m.transmission),
            {alpha, alpha, false}};
}

/// Only mirror directions scatter: light sampling is of no use.
inline bool is_specular(const Material& material) {
    if (const auto* c = std::get_if<ConductorMaterial>(&material.kind)) {
        return c->surface.smooth();
    }
    if (const auto* d = std::get_if<DielectricMaterial>(&material.kind)) {
        return d->is_smooth() || d->thin;
    }
    return false;
}

// Light may come from below the surface.
template <class F, template <class> class B>
inline Mask<F> is_transmissive(const B<F>&) {
    return Mask<F>(false);
}
template <class F>
inline Mask<F> is_transmissive(const Dielectric<F>&) {
    return Mask<F>(true);
}
template <class F>
inline Mask<F> is_transmissive(const Principled<F>& b) {
    return b.transmission > F(0.0f);
}

// Share of light scattered back or through, for denoising and inspection.
template <class F>
inline Vec3<F> albedo(const Diffuse<F>& b) {
    return b.reflectance;
}
template <class F>
inline Vec3<F> albedo(const Conductor<F>& b) {
    return fresnel_conductor(F(1.0f), b.eta, b.k) * b.reflectance;
}
template <class F>
inline Vec3<F> albedo(const Dielectric<F>& b) {
    const F r = fresnel_dielectric(F(1.0f), b.eta).reflectance;
    return b.reflectance * r + b.transmittance * (F(1.0f) - r);
}
template <class F>
inline Vec3<F> albedo(const Plastic<F>& b) {
    return b.diffuse;
}
template <class F>
inline Vec3<F> albedo(const Principled<F>& b) {
    return b.base_color;
}

}  // namespace raykiln
