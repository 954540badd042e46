#pragma once

#include <vector>

#include "sampling/distribution.h"
#include "scene/camera.h"
#include "scene/light.h"
#include "scene/material.h"
#include "scene/shape.h"

namespace raykiln {

/// Axis-aligned bounds.
struct Bounds {
    Vec3f low{infinity, infinity, infinity};
    Vec3f high{-infinity, -infinity, -infinity};

    void add(const Vec3f& p) {
        low = {min(low.x, p.x), min(low.y, p.y), min(low.z, p.z)};
        high = {max(high.x, p.x), max(high.y, p.y), max(high.z, p.z)};
    }
    bool empty() const { return !(low.x <= high.x); }
};

/// All that is rendered, as plain data. Build the parts, then call `prepare_lights`.
struct Scene {
    std::vector<Texture> textures;
    std::vector<Material> materials;
    std::vector<Emission> emissions;
    std::vector<Group> groups{1};  ///< group 0 lies in world space
    std::vector<Instance> instances;
    std::vector<Light>
        lights;  ///< given ones first, then one for each emissive triangle, sphere

    // Made by prepare_lights.
    AliasTable light_choice;
    std::vector<std::uint32_t> infinite_lights;
    /// First light of a geometry of group 0: `light_offset[geometry]`; of one in an
    /// instance: `instance_light_offset[instance][geometry]`; no_index where it does not
    /// emit.
    std::vector<std::uint32_t> light_offset;
    std::vector<std::vector<std::uint32_t>> instance_light_offset;
    Bounds bounds;
    bool has_opacity = false;  ///< some material lets rays through

    std::uint64_t triangle_count() const;
    std::uint64_t sphere_count() const;
};

}  // namespace raykiln
