#pragma once

#include <variant>
#include <vector>

#include "scene/texture.h"

// Materials as the scene describes them: numbers or textures. `bsdf/` evaluates one at a
// point into the BSDF that light is scattered by.

namespace raykiln {

/// Microfacet surface; alpha is the width of the slope distribution along s and t.
struct MicrofacetSlots {
    FloatSlot alpha_u{0.0f}, alpha_v{0.0f};
    bool beckmann = false;

    /// A perfectly smooth surface: scattering is by mirror directions only.
    bool smooth() const {
        return alpha_u.texture == no_texture && alpha_v.texture == no_texture &&
               alpha_u.factor == 0.0f && alpha_v.factor == 0.0f;
    }
};

struct DiffuseMaterial {
    ColorSlot reflectance;
};

struct ConductorMaterial {
    Vec3f eta{0, 0, 0}, k{1, 1, 1};  ///< relative to the outside
    ColorSlot reflectance;
    MicrofacetSlots surface;
};

struct DielectricMaterial {
    float eta = 1.5f;  ///< index inside / index outside
    ColorSlot reflectance, transmittance;
    MicrofacetSlots surface;
    bool thin = false;

    /// Refraction without a change of index has no half vector.
    bool is_smooth() const {
        return surface.smooth() || (eta > 1.0f - 1e-3f && eta < 1.0f + 1e-3f);
    }
};

/// Transmittance of a dielectric interface, tabulated over the cosine of the angle of
/// incidence.
struct InterfaceTable {
    static constexpr int size = 64;
    float transmittance[size] = {};
    float internal_reflectance = 0.0f;  ///< diffuse, from inside
};

struct PlasticMaterial {
    float eta = 1.5f;
    ColorSlot diffuse, specular;
    MicrofacetSlots surface;
    bool nonlinear = false;
    InterfaceTable table;  ///< for the constant alpha of this material
};

struct PrincipledMaterial {
    ColorSlot base_color, specular_color;
    FloatSlot metallic, roughness, specular, transmission;
    float ior = 1.5f;
};

// To add a kind: a struct here, its BSDF in bsdf/, its binding in bind_scene.cpp, its
// model in raykiln/scene.py, its case in raykiln/compile.py.
using MaterialKind = std::variant<DiffuseMaterial, ConductorMaterial, DielectricMaterial,
                                  PlasticMaterial, PrincipledMaterial>;

struct Material {
    MaterialKind kind;
    bool two_sided = true;
    std::int32_t normal_map = no_texture;
    float normal_scale = 1.0f;
    FloatSlot opacity;
    float alpha_cutoff = -1.0f;  ///< negative: opacity is a share, not a threshold

    bool has_opacity() const {
        return opacity.texture != no_texture || opacity.factor < 1.0f;
    }
};

}  // namespace raykiln
