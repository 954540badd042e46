#pragma once

#include <vector>

#include "math/bounds.h"
#include "sampling/distribution.h"
#include "sampling/light_tree.h"
#include "scene/camera.h"
#include "scene/light.h"
#include "scene/material.h"
#include "scene/shape.h"

namespace raykiln {

/// All that is rendered, as plain data. Build the parts, then call `prepare_lights`.
struct Scene {
    std::vector<Texture> textures;
    std::vector<Material> materials;
    std::vector<Emission> emissions;
    std::vector<Group> groups{1};  ///< group 0 lies in world space
    std::vector<Instance> instances;
    std::vector<Light>
        lights;  ///< given ones first, then those of emissive triangles, spheres

    // Made by prepare_lights.
    LightTree
        near_lights;  ///< over `lights`; those beyond the scene never come out of it
    LightTable light_table;
    AliasTable far_choice;  ///< over `far_lights`
    std::vector<std::uint32_t>
        far_lights;          ///< beyond the scene: environments, directional
    float far_share = 0.0f;  ///< probability of choosing among those
    /// The light that each emissive triangle or sphere belongs to.
    std::vector<std::uint32_t> surface_lights;
    /// Where those of a geometry begin: in group 0 at `light_offset[geometry]`, in an
    /// instance at `instance_light_offset[instance][geometry]`; no_index where it does
    /// not emit.
    std::vector<std::uint32_t> light_offset;
    std::vector<std::vector<std::uint32_t>> instance_light_offset;
    /// Around each shape that emits; around all of them where they are many.
    std::vector<Bounds> emitter_bounds;
    Bounds bounds;
    bool has_opacity = false;  ///< some material lets rays through

    std::uint64_t triangle_count() const;
    std::uint64_t sphere_count() const;
};

}  // namespace raykiln
