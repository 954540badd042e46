#pragma once

#include <memory>
#include <string>
#include <vector>

#include "bsdf/bsdf.h"
#include "directions.h"

// The materials that the proofs of bsdf/ go through.

namespace raykiln::test {

struct BsdfCase {
    std::string name;
    Bsdf bsdf;
    bool transmissive = false;  ///< defined for dir_out below the surface, too
};

inline Microfacet<float> ggx(float alpha_x, float alpha_y) {
    return {alpha_x, alpha_y, false};
}
inline Microfacet<float> beckmann(float alpha_x, float alpha_y) {
    return {alpha_x, alpha_y, true};
}

/// Copper-like: coloured, absorbing.
inline Conductor<float> metal(Microfacet<float> facet) {
    return {{0.2f, 0.9f, 1.2f}, {3.9f, 2.4f, 2.3f}, {0.9f, 0.8f, 0.7f}, facet, false};
}
/// eta = 0: reflects everything.
inline Conductor<float> mirror(Microfacet<float> facet) {
    return {Vec3f(0.0f), Vec3f(1.0f), Vec3f(1.0f), facet, false};
}
inline Dielectric<float> glass(float eta, Microfacet<float> facet) {
    return {eta, Vec3f(1.0f), Vec3f(1.0f), facet, false, false};
}
/// alpha 0 is the smooth one. Keeps its table for good.
inline Plastic<float> plastic(const Vec3f& diffuse, float alpha, bool is_beckmann,
                              bool nonlinear) {
    static std::vector<std::unique_ptr<InterfaceTable>> tables;
    tables.push_back(
        std::make_unique<InterfaceTable>(make_interface_table(1.5f, alpha, is_beckmann)));
    return {1.5f,
            diffuse,
            Vec3f(1.0f),
            {max(alpha, min_alpha), max(alpha, min_alpha), is_beckmann},
            tables.back().get(),
            alpha == 0.0f,
            nonlinear};
}
inline Principled<float> principled(const Vec3f& color, float metallic, float roughness,
                                    float transmission) {
    const float alpha = max(roughness * roughness, min_alpha);
    return {color, Vec3f(0.04f), 1.0f, metallic, transmission, {alpha, alpha, false}};
}

inline const std::vector<BsdfCase>& bsdf_cases() {
    const Vec3f color(0.8f, 0.5f, 0.2f);
    static const std::vector<BsdfCase> cases{
        {"diffuse", Diffuse<float>{color}},
        {"conductor_ggx_0_1", metal(ggx(0.1f, 0.1f))},
        {"conductor_ggx_0_6", metal(ggx(0.6f, 0.6f))},
        {"conductor_ggx_aniso", metal(ggx(0.15f, 0.5f))},
        {"conductor_beckmann_0_3", metal(beckmann(0.3f, 0.3f))},
        {"conductor_beckmann_aniso", metal(beckmann(0.5f, 0.2f))},
        {"dielectric_ggx_0_2", glass(1.5f, ggx(0.2f, 0.2f)), true},
        {"dielectric_ggx_aniso", glass(1.33f, ggx(0.3f, 0.7f)), true},
        {"dielectric_ggx_bubble", glass(1 / 1.4f, ggx(0.4f, 0.4f)), true},
        {"dielectric_beckmann_0_4", glass(1.5f, beckmann(0.4f, 0.4f)), true},
        {"plastic_smooth", plastic(color, 0.0f, false, false)},
        {"plastic_ggx", plastic(color, 0.3f, false, true)},
        {"plastic_beckmann", plastic(color, 0.2f, true, false)},
        {"principled_plastic", principled(color, 0.0f, 0.6f, 0.0f)},
        {"principled_metal", principled(color, 1.0f, 0.5f, 0.0f)},
        {"principled_pane", principled(color, 0.0f, 0.5f, 1.0f)},
        {"principled_between", principled(color, 0.4f, 0.7f, 0.5f)},
    };
    return cases;
}

/// Angles to the normal that dir_out is tried at, in degrees; beyond 90 from below.
inline std::vector<int> angles_of(const BsdfCase& c) {
    return c.transmissive ? std::vector<int>{0, 45, 80, 100, 135, 150}
                          : std::vector<int>{0, 30, 60, 80};
}

inline Vec3f direction_of_degrees(int degrees) {
    return direction_at(degrees * tau / 360, 0.7);
}

}  // namespace raykiln::test
