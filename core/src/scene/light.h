#pragma once

#include <variant>

#include "math/frame.h"
#include "math/transform.h"
#include "sampling/distribution.h"
#include "scene/texture.h"

namespace raykiln {

struct PointLight {
    Vec3f position;
    Vec3f intensity;
};

struct SpotLight {
    Vec3f position;
    Vec3f axis;  ///< the way the light travels, unit
    Vec3f intensity;
    float cos_inner, cos_outer;
};

struct DirectionalLight {
    Vec3f direction;  ///< the way the light travels, unit
    Vec3f irradiance;
};

/// Radiance from infinitely far away: a constant, or a latitude-longitude map if `map` is
/// valid.
struct EnvironmentLight {
    Vec3f scale{1, 1, 1};
    std::int32_t map = no_texture;
    Frame<float> world_from_light{{1, 0, 0}, {0, 1, 0}, {0, 0, 1}};  ///< columns x, y, z
    Distribution2D distribution;  ///< over (u, v) of the map
    float power = 0.0f;           ///< luminance integrated over all directions
};

/// How a surface emits.
struct Emission {
    ColorSlot radiance;
    bool two_sided = false;
};

/// One triangle of an emissive mesh, in world space.
struct TriangleLight {
    Vec3f p0, edge1, edge2;
    Vec3f normal;  ///< unit, the emitting side
    float area;
    Vec2f uv0, uv1, uv2;
    std::uint32_t emission;  ///< index into Scene::emissions
};

struct SphereLight {
    Vec3f center;
    float radius;
    bool inward;  ///< emits into the sphere
    std::uint32_t emission;
};

// To add a kind: a struct here, its sampling in light/, its case in light/light.cpp.
using Light = std::variant<PointLight, SpotLight, DirectionalLight, EnvironmentLight,
                           TriangleLight, SphereLight>;

}  // namespace raykiln
