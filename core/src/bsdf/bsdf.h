#pragma once

#include <variant>

#include "bsdf/conductor.h"
#include "bsdf/dielectric.h"
#include "bsdf/diffuse.h"
#include "bsdf/plastic.h"
#include "bsdf/principled.h"
#include "scene/scene.h"

namespace raykiln {

/// A material evaluated at a point.
using Bsdf = std::variant<Diffuse<float>, Conductor<float>, Dielectric<float>,
                          Plastic<float>, Principled<float>>;

Bsdf make_bsdf(const Material& material, const std::vector<Texture>& textures, Vec2f uv);

inline BsdfValue<float> evaluate(const Bsdf& bsdf, const Vec3f& dir_out,
                                 const Vec3f& dir_in) {
    return std::visit([&](const auto& b) { return evaluate(b, dir_out, dir_in); }, bsdf);
}
inline BsdfSample<float> sample(const Bsdf& bsdf, const Vec3f& dir_out,
                                const BsdfRandom<float>& u) {
    return std::visit([&](const auto& b) { return sample(b, dir_out, u); }, bsdf);
}

/// Only mirror directions scatter: light sampling is of no use.
bool is_specular(const Bsdf& bsdf);
/// Light may come from below the surface.
bool is_transmissive(const Bsdf& bsdf);
/// Share of light scattered back or through, for denoising and inspection.
Vec3f albedo(const Bsdf& bsdf);

/// The transmittance of a plastic's coat for its alpha, by quadrature over the visible
/// normals.
InterfaceTable make_interface_table(float eta, float alpha, bool beckmann);

}  // namespace raykiln
