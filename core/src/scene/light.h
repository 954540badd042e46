#pragma once

#include <variant>
#include <vector>

#include "math/frame.h"
#include "math/transform.h"
#include "memory/pages.h"
#include "sampling/block_distribution.h"
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
    BlockDistribution distribution;  ///< over (u, v) of the map, a view a kind of normal
    float power = 0.0f;              ///< luminance integrated over all directions
};

/// How a surface emits.
struct Emission {
    ColorSlot radiance;
    std::uint32_t two_sided = 0;  ///< 0 or 1
};

/// One triangle of an emissive mesh, in world space. The members are read as rows of
/// words (light/sample_light.h).
template <class F>
struct TriangleLightOf {
    Vec3<F> p0, edge1, edge2;
    Vec3<F> normal;  ///< unit, the emitting side
    F area;
    Uint<F> emission;  ///< index into Scene::emissions
    Vec2<F> uv0, uv1, uv2;
};
using TriangleLight = TriangleLightOf<float>;

/// Two triangles of an emissive mesh that make a parallelogram: `half`, whose area is
/// half of it, and its reflection at the middle of the edge that they share.
struct ParallelogramLight {
    TriangleLight half;
};

template <class F>
struct SphereLightOf {
    Vec3<F> center;
    F radius;
    Uint<F> inward;  ///< 1: emits into the sphere
    Uint<F> emission;
    Uint<F> unused[2] = {};  // a row of words
};
using SphereLight = SphereLightOf<float>;

// To add a kind: a struct here, its sampling in light/, its cases in light/light.cpp and
// light/sample_light.h.
using Light = std::variant<PointLight, SpotLight, DirectionalLight, EnvironmentLight,
                           TriangleLight, SphereLight, ParallelogramLight>;

/// The lights again, kind by kind, for code that looks at many at once. `kind` is the
/// place in the variant, `slot` the one among those of the kind.
struct LightTable {
    template <class T>
    using Rows = std::vector<T, PageAllocator<T>>;

    Rows<std::uint32_t> kind, slot;
    std::vector<PointLight> points;
    std::vector<SpotLight> spots;
    std::vector<DirectionalLight> directionals;
    std::vector<std::uint32_t> environments;  ///< index into Scene::lights
    Rows<TriangleLight> triangles;
    Rows<SphereLight> spheres;
    Rows<ParallelogramLight> parallelograms;
};

}  // namespace raykiln
